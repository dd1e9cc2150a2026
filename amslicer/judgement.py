"""From what was measured of a stack to what is wrong with it, in sentences.

The limits leave room for what honest stacks of unaligned phasor noise showed at bandwidths 0.25 to 1 and isotropies 0
to 1: a bias that all blocks share, and some standard errors of a mean over blocks that are not quite independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.texture import Shown
    from amslicer.windows import Level

    Floats = NDArray[np.float64]

MIN_BLOCKS = 4  # fewer say nothing about a mean
HALVED_BLOCKS = 16  # from these on, halves of the part are looked at too
STANDARD_ERRORS = 4.0
ROUNDING = 1e-6  # of shares that are sums of float32
# Direction, where isotropy is low: blocks of 7 periods are 2.4 to 3.4° off on average, and turn along by nothing.
LOW_ISOTROPY = 0.2
TURN_DEG, ANGLE_DEG, ANGLE_PER_ISOTROPY_DEG = 2.0, 7.0, 50.0
# Period: the centroid of the power is 0 to 1 % above the model's.
FREQUENCY, FREQUENCY_BIAS = 0.02, 0.005
# A handful of blocks can agree by chance, so their scatter counts as at least what full blocks of honest stacks
# have at bandwidths 0.25 to 1: 2.4 to 4.8° of direction; 0.037 to 0.060 of frequency in 2D, 0.019 to 0.039 in space.
TURN_SCATTER_DEG, FREQUENCY_SCATTER = 3.0, {2: 0.05, 3: 0.03}
# Isotropy: the share of power along the normal is 0.06 below to 0.04 above the model's.
ALONG, ALONG_BIAS = 0.07, -0.015


def ratio_problems(levels: Sequence[Level], materials: Sequence[str], corner_mm: Floats) -> Iterator[str]:
    """Windows whose ratio is further off than chance explains, the largest windows first."""
    for level in reversed(levels):
        error = level.got - level.asked
        for window, m in np.argwhere(np.abs(error) > level.limit + ROUNDING):
            low, high = level.low_mm[window] + corner_mm, level.high_mm[window] + corner_mm
            where = ", ".join(f"{axis} {a:.1f} to {b:.1f}" for axis, a, b in zip("xyz", low, high, strict=True))
            yield (
                f"{materials[m]}: {level.got[window, m]:.4f} instead of {level.asked[window, m]:.4f} (error "
                f"{error[window, m]:+.4f}, allowed ± {level.limit[window, m]:.4f}) in {where} mm"
            )


def direction_problems(shown: Sequence[Shown]) -> Iterator[str]:
    """Whether the sheets turn as painted, where isotropy is low."""
    for where, blocks in _regions(of_low_isotropy(shown)):
        turns = np.array([block.turn_deg for block in blocks])
        angles = np.array([block.angle_deg for block in blocks])
        mean = turns.mean(axis=0)
        scatter = max(float(np.linalg.norm(turns.std(axis=0, ddof=1))), TURN_SCATTER_DEG)
        allowed = TURN_DEG + STANDARD_ERRORS * scatter / np.sqrt(len(blocks))
        turned = float(np.linalg.norm(mean))
        if turned > allowed:
            axis = "xyz"[int(np.argmax(np.abs(mean)))]
            yield (
                f"{where}: sheets are turned by {turned:.1f}° on average, mostly about {axis} (allowed {allowed:.1f}°)"
            )
        limit = ANGLE_DEG + ANGLE_PER_ISOTROPY_DEG * float(np.mean([block.isotropy for block in blocks]))
        if np.median(angles) > limit:
            yield (
                f"{where}: sheets are {np.median(angles):.1f}° from the painted direction in the middle of "
                f"{len(blocks)} blocks (allowed {limit:.1f}°)"
            )


def of_low_isotropy(shown: Sequence[Shown]) -> list[Shown]:
    """The blocks that have one direction."""
    return [block for block in shown if block.isotropy <= LOW_ISOTROPY]


def period_problems(shown: Sequence[Shown], dimensions: int) -> Iterator[str]:
    """Whether sheets are as far apart as painted.

    Args:
        dimensions: of the pattern, 2 or 3.
    """
    for where, blocks in _regions(shown):
        frequency = np.array([block.frequency for block in blocks])
        mean = float(frequency.mean()) - FREQUENCY_BIAS
        scatter = max(float(frequency.std(ddof=1)), FREQUENCY_SCATTER[dimensions])
        allowed = FREQUENCY + STANDARD_ERRORS * scatter / np.sqrt(len(blocks))
        if abs(mean - 1) > allowed:
            yield f"{where}: the period is {1 / mean:.3f} times the painted one (allowed ± {allowed:.3f})"


def isotropy_problems(shown: Sequence[Shown]) -> Iterator[str]:
    """Whether directions spread as painted."""
    for where, blocks in _regions(shown):
        more = np.array([block.along - block.expected_along for block in blocks]) - ALONG_BIAS
        allowed = ALONG + STANDARD_ERRORS * float(more.std(ddof=1)) / np.sqrt(len(blocks))
        if abs(more.mean()) > allowed:
            got, asked = (float(np.mean([getattr(b, name) for b in blocks])) for name in ("along", "expected_along"))
            isotropy = float(np.mean([block.isotropy for block in blocks]))
            yield (
                f"{where}: {100 * got:.0f} % of the spectrum's power lies along the painted normal instead of "
                f"{100 * asked:.0f} % (allowed ± {100 * allowed:.0f} %): sheets are "
                f"{'less' if got > asked else 'more'} isotropic than the painted {isotropy:.2f}"
            )


def _regions(shown: Sequence[Shown]) -> Iterator[tuple[str, Sequence[Shown]]]:
    """The part, and its halves along each axis where it has enough blocks."""
    if len(shown) < MIN_BLOCKS:
        return
    yield "the part", shown
    if len(shown) < HALVED_BLOCKS:
        return
    centres = np.array([block.centre_mm for block in shown])
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    for axis, name in enumerate("xyz"):
        for upper in (False, True):
            inside = (centres[:, axis] > middle[axis]) == upper
            if MIN_BLOCKS <= np.count_nonzero(inside) < len(shown):
                side = "upper" if upper else "lower"
                yield f"the {side} half along {name}", [b for b, i in zip(shown, inside, strict=True) if i]
