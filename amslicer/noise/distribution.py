"""The law of a sum of independent values from its characteristic function (Gil-Pelaez 1951)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

VALUES = 4096  # that stand for all of a table
STEPS, WAVES, REACH = 1601, 12.0, 8.0  # frequencies up to WAVES/σ, values up to ± REACH σ


def above(
    characteristic: Callable[[Floats], NDArray[np.complex128] | Floats], deviation: float
) -> tuple[Floats, Floats]:
    """Values, rising, and the shares of all values that lie above them.

    P(Y > y) = ½ + (1/π) ∫ Im(exp(-iuy) φ(u))/u du over u > 0.

    Args:
        characteristic: φ of values of mean 0, at (STEPS - 1,) frequencies.
        deviation: σ of the values.
    """
    u = np.linspace(0.0, WAVES / deviation, STEPS)[1:]
    phi = np.asarray(characteristic(u))
    values = np.linspace(-REACH, REACH, STEPS) * deviation
    turned = (phi * np.exp(-1j * u * values[:, None])).imag / u
    # At u = 0, which is the trapezoid's missing end, the integrand is -y.
    integral = np.trapezoid(turned, u, axis=1) + 0.5 * u[0] * (turned[:, 0] - values)
    return values, np.clip(0.5 + integral / np.pi, 0.0, 1.0)


def above_of_sum(samples: Floats, count: int) -> tuple[Floats, Floats]:
    """The same of the sum of some independent values, each equally likely to be any of the (N,) samples."""
    ordered = np.sort(samples - np.mean(samples))
    values = ordered[(np.arange(VALUES) * len(ordered) + len(ordered) // 2) // VALUES]  # equally likely ones
    values = values - values.mean()

    def characteristic(u: Floats) -> NDArray[np.complex128]:
        return np.array([np.mean(np.exp(1j * w * values)) for w in u]) ** count

    return above(characteristic, float(np.std(samples)) * np.sqrt(count))
