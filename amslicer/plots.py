"""Plots of what `amslicer.analysis` measures, and of the Gabor paper's equations; needs the extra: amslicer[plots].

Each function draws on matplotlib axes, given or of a new figure, and returns them: `plot_field(…).figure.savefig(…)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer import analysis
from amslicer.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from amslicer.noise import GaborKernel

    Floats = NDArray[np.float64]
    Pitch = tuple[float, float]

ERRORS = np.geomspace(0.005, 0.5, 60)  # of truncation


def plot_field(field: NDArray[np.floating], pitch_mm: Pitch, ax: Axes | None = None) -> Axes:
    """A real field, row 0 at the top, in mm.

    Args:
        field: (rows, columns).
        pitch_mm: pixel size along x and y.
        ax: where to draw; default: a new figure.
    """
    axes = ax or _axes()
    rows, columns = field.shape
    axes.imshow(field, cmap="gray", extent=(0, columns * pitch_mm[0], 0, rows * pitch_mm[1]))
    axes.set(xlabel="x, mm", ylabel="y, mm")
    return axes


def plot_spectrum(
    field: NDArray[np.floating], pitch_mm: Pitch, ax: Axes | None = None, *, of_variance: bool = False
) -> Axes:
    """Power spectrum on a logarithmic scale, or the spectrum of variance: that of the squared field.

    Args: as of plot_field.
    """
    axes = ax or _axes()
    values = np.asarray(field, np.float64) ** 2 if of_variance else np.asarray(field, np.float64)
    decibels = 10 * analysis.decades(analysis.power_map(values))
    x, y = 0.5 / pitch_mm[0], 0.5 / pitch_mm[1]
    shown = axes.imshow(decibels, cmap="gray", vmin=-10 * analysis.DECADES, vmax=0, extent=(-x, x, -y, y))
    axes.figure.colorbar(shown, ax=axes, label="dB")
    axes.set(xlabel="cycles per mm along x", ylabel="along y", title="spectrum of variance" if of_variance else "power")
    return axes


def plot_radial_power(
    field: NDArray[np.floating], pitch_mm: Pitch, ax: Axes | None = None, *,
    expected: Callable[[Floats], Floats] | None = None, bins: int = 64,
) -> Axes:  # fmt: skip
    """Power spectral density over the frequency, and what theory expects (Lagae et al. 2011, Figs 3 to 5).

    Args:
        expected: of frequencies in cycles per mm: density in the field's unit² mm²; for Gabor noise λ E[w²] times
            `GaborKernel.radial_power`.
        bins: rings.
    """
    axes = ax or _axes()
    frequency, density = analysis.radial_power(field, pitch_mm, bins)
    axes.plot(frequency, density, label="estimated")
    if expected is not None:
        axes.plot(frequency, expected(frequency), "--", label="expected")
        axes.legend()
    axes.set(xlabel="cycles per mm", ylabel="power density")
    return axes


def plot_angular_power(field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float, ax: Axes | None = None) -> Axes:
    """Share of the power near the carrier over the direction, degrees."""
    axes = ax or _axes()
    angle, share = analysis.angular_power(field, pitch_mm, period_mm)
    axes.bar(angle, 100 * share, width=180 / len(angle))
    axes.set(xlabel="direction, degrees", ylabel="% of the power", xlim=(0, 180))
    return axes


def plot_autocovariance(field: NDArray[np.floating], pitch_mm: Pitch, ax: Axes | None = None) -> Axes:
    """Mean product of the field with itself shifted by up to a quarter of its size."""
    axes = ax or _axes()
    found = analysis.autocovariance(field)
    rows, columns = (n // 8 for n in found.shape)
    middle = found[3 * rows : -3 * rows, 3 * columns : -3 * columns]
    x, y = (n * pitch / 2 for n, pitch in zip(middle.shape[::-1], pitch_mm, strict=True))
    shown = axes.imshow(middle, cmap="gray", extent=(-x, x, -y, y))
    axes.figure.colorbar(shown, ax=axes)
    axes.set(xlabel="shift along x, mm", ylabel="along y, mm", title="autocovariance")
    return axes


def plot_local_ratio(
    labels: NDArray[np.uint8], pitch_mm: Pitch, window_mm: float, ax: Axes | None = None, *, material: int = 1
) -> Axes:
    """Share of a material in a window around each pixel.

    Args:
        labels: (rows, columns) materials, 0 where nothing is solid.
        window_mm: side of the window.
        material: 1-based.
    """
    axes = ax or _axes()
    share = analysis.local_ratio(labels, pitch_mm, window_mm, material)
    rows, columns = labels.shape
    extent = (0, columns * pitch_mm[0], 0, rows * pitch_mm[1])
    shown = axes.imshow(100 * share, cmap="viridis", vmin=0, vmax=100, extent=extent)
    axes.figure.colorbar(shown, ax=axes, label=f"% of material {material}")
    axes.set(xlabel="x, mm", ylabel="y, mm", title=f"in windows of {window_mm:g} mm")
    return axes


def plot_phase(g: NDArray[np.complexfloating], pitch_mm: Pitch, ax: Axes | None = None) -> Axes:
    """Phase as hue and intensity |G| as brightness (Tricard et al. 2019, Fig. 3)."""
    from matplotlib.colors import hsv_to_rgb

    axes = ax or _axes()
    intensity = np.abs(g)
    bright = np.clip(intensity / np.quantile(intensity, 0.99), 0, 1)
    colors = hsv_to_rgb(np.stack([np.angle(g) / (2 * np.pi) % 1, np.ones(g.shape), bright], axis=-1))
    rows, columns = g.shape
    axes.imshow(colors, extent=(0, columns * pitch_mm[0], 0, rows * pitch_mm[1]))
    axes.set(xlabel="x, mm", ylabel="y, mm", title="arg G, |G|")
    return axes


def plot_truncation_errors(kernels: Mapping[str, GaborKernel], ax: Axes | None = None) -> Axes:
    """Relative error over the radius where kernels are cut (Lagae et al. 2011, Figs 11 and 12).

    Args:
        kernels: by what the legend calls them.
    """
    axes = ax or _axes()
    for name, kernel in kernels.items():
        axes.plot([kernel.radius_of_error(float(e)) for e in ERRORS], 100 * ERRORS, label=name)
    axes.legend()
    axes.set(xlabel="radius", ylabel="relative error, %", ylim=(0, None))
    return axes


def _axes() -> Axes:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        hint = 'pip install "amslicer[plots]"'
        raise UsageError("plots need matplotlib, which is not installed", hint=hint) from None
    return Figure(layout="constrained").subplots()
