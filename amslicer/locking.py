"""Pixel locking: what sampling does to the ratio of a laminate that is in step with the pixel rows.

The indicator of a material is its ratio plus Σ_h a_h cos(hϕ) (`spread`). Sampled, harmonic h of a laminate with
(a, b, c) = n_i·pitch_i/p cycles per pixel along x, y and layers cannot be told from one with the fractional parts of
h·(a, b, c). Where these are all near zero, it is an error of the ratio: at 10 pixels per period along a row,
harmonics 10, 20 … – a stripe of 2.5 pixels has 2 or 3 pixels everywhere, whichever the phase says. The error is what
spread's theory says of a harmonic with that frequency: V_h counts how far its phase drifts across the part, and how far
the noise wanders by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.spread import ALIGNED_SHARE, FEW_KERNELS, harmonic_variance

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from amslicer.profiles import Profile

    Floats = NDArray[np.float64]

# |a_h| <= 2/(πh): one harmonic beyond these is below 0.3 %, but oblique gratings lock many at once: with 100, errors of
# 1.0 to 1.3 % were foretold as 0.5 to 0.97 %, with 200 as 0.84 % or more.
LOCKING_HARMONICS = 200
WINDOW_HARMONICS = 100  # of a standard deviation among many windows, which is what costs time
# Standard deviations. The sum of all |a_h| √V_h is no bound: it is of the harmonics kept alone.
PLAUSIBLE = 3.0
# A part smaller than an envelope shows one laminate, whose own wave is off the painted one: by b/(2√π) per axis, the
# standard deviation of the noise's spectrum, or as much as one half cycle across the part does where that is less. The
# worst part is one whose wave is off by two of these, towards being locked.
WAVE_OFF, CYCLES_OFF = 0.56, 0.5


def locking_error(
    cumulative: ArrayLike, *, profile: Profile, cycles_per_pixel: ArrayLike, extents_px: ArrayLike,
    width_per_pixel: ArrayLike, aligned: bool = False,
) -> Floats:  # fmt: skip
    """The worst plausible error of each material's ratio over a part from pixel locking.

    Args:
        cumulative: (M - 1,) cumulative ratios c1 … c(M-1) of M materials, each 0…1.
        cycles_per_pixel: (2,) for a pattern that is the same in every layer, else (3,): n_i·pitch_i/p.
        extents_px: (2,) or (3,) pixels (and layers) across the part's bounding box; a part that fills it badly locks
            more.
        width_per_pixel: B·pitch_i/p, the envelope's width b in pixels: one number, or one per axis.
        aligned: phases are, so that the laminate does not wander: it is a grating of the painted wave.

    Returns:
        (M,) errors, all positive.
    """
    ends = np.concatenate([[0.0], np.asarray(cumulative, np.float64).reshape(-1), [1.0]])
    extents = np.asarray(extents_px, np.float64)
    width = np.asarray(width_per_pixel, np.float64) * (ALIGNED_SHARE if aligned else 1.0)
    off: Floats | float = 0.0 if aligned else np.minimum(WAVE_OFF * width, CYCLES_OFF / extents)
    cycles = np.asarray(cycles_per_pixel, np.float64)
    amplitude, variance = _locked(ends[:-1], ends[1:], profile, cycles, extents, width, off, LOCKING_HARMONICS)
    return np.asarray(PLAUSIBLE * np.sqrt(np.sum(amplitude**2 / 2 * variance, axis=-1)))


def locked_deviation(
    low: ArrayLike, high: ArrayLike, *, profile: Profile, cycles_per_pixel: ArrayLike, extents_px: ArrayLike,
    width_per_pixel: ArrayLike,
) -> Floats:  # fmt: skip
    """Standard deviation that point-sampling by pixels adds to a material's share of box windows, in step or not.

    With share_deviation, σ = √(share² + locked²), it is within 0.86 to 1.12 of what was measured for ratios of 0.05
    to 0.5 in windows of 2 to 10 periods at 0°, 10°, 27° and 45°, where it alone is up to three times share_deviation.

    Args:
        low, high: the material's cumulative ratios c(m-1) and c(m); all arrays broadcast.
        cycles_per_pixel, extents_px: (..., 2) or (..., 3), as in locking_error, of the windows.
        width_per_pixel: as in locking_error.
    """
    cycles = np.asarray(cycles_per_pixel, np.float64)
    amplitude, variance = _locked(low, high, profile, cycles, extents_px, width_per_pixel, 0.0, WINDOW_HARMONICS)
    return np.asarray(np.sqrt(np.sum(amplitude**2 / 2 * variance, axis=-1)))


def _locked(
    low: ArrayLike, high: ArrayLike, profile: Profile, cycles: Floats, extents_px: ArrayLike, width: ArrayLike,
    off: Floats | float, harmonics: int,
) -> tuple[Floats, Floats]:  # fmt: skip
    """(..., harmonics) a_h and V_h of the harmonics that sampling moves; V_h = 0 for the others.

    Args:
        off: how much nearer to zero the moved frequency may be, per harmonic, in cycles per pixel.
    """
    variance = []
    for h in range(1, harmonics + 1):
        moved = np.rint(h * cycles)
        aliased = np.any(moved != 0, axis=-1)
        seen = np.maximum(np.abs(h * cycles - moved) - h * np.asarray(off), 0.0)
        v = harmonic_variance(h, extents_px, seen, width) if np.any(aliased) else 0.0
        variance.append(np.where(aliased, FEW_KERNELS**2 * np.asarray(v), 0.0))
    amplitude = profile.amplitudes(low, high, harmonics)
    return amplitude, np.minimum(np.stack(variance, axis=-1), 1.0)
