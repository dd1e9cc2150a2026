"""The ratio of each material in windows of a stack, against the painted ratio and the spread that theory predicts.

Windows are the part's bounding box, its halves along each axis, their halves …, down to LEAF_PERIODS. A fault of a
whole part of the stack is seen in the large windows, where honest ratios scatter little; a local one in the small ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.levelspread import level_deviation, level_limit
from amslicer.likeness import PIXEL_SHARE, SIGMAS, Likeness
from amslicer.likeness import share_deviation as deviation_of_likeness
from amslicer.lobespread import resonance_deviation
from amslicer.locking import locked_deviation
from amslicer.spread import ALIGNED_SHARE, pixel_deviation, share_deviation, share_limit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.noise.lobes import Lobes
    from amslicer.painted import Painted
    from amslicer.profiles import Profile

    Floats = NDArray[np.float64]

LEAF_PERIODS = 4.0  # no window is narrower (but for a part that is)
MAX_LEAVES = 64  # along an axis: 32 × 32 × 8 windows of a large part are enough to look at
PLACES = 2  # per axis of a window where the painted direction is read
FULL = 0.95  # windows that lack less, at a side, are smaller boxes rather than partly filled ones
FILLED = 0.25  # windows with less of the part in them say too little


@dataclass(frozen=True)
class Level:
    """All windows of one size.

    Attributes:
        low_mm, high_mm: (W, 3) corners, pattern frame.
        got, asked: (W, materials) shares.
        sigma: (W, materials) predicted standard deviation of got - asked.
        limit: (W, materials) how far an honest window may be off.
        place: (W, 3) number of each window along x, y, z.
        counts: windows along x, y, z.
    """

    low_mm: Floats
    high_mm: Floats
    got: Floats
    asked: Floats
    sigma: Floats
    limit: Floats
    place: NDArray[np.int64]
    counts: tuple[int, int, int]

    @property
    def z(self) -> Floats:
        """(W, materials) errors in standard deviations; 0 where nothing may scatter."""
        error = self.got - self.asked
        return np.divide(error, self.sigma, out=np.zeros_like(error), where=self.sigma > 0)


class RatioWindows:
    """Counts pixels per window, layer by layer."""

    def __init__(self, painted: Painted, grid: Grid) -> None:
        self._painted, self._grid = painted, grid
        self.planar = painted.dimensions == 2
        pixels = np.array([grid.columns, grid.rows, 1 if self.planar else grid.layers])
        sizes = np.array([grid.columns * grid.pitch_mm[0], grid.rows * grid.pitch_mm[1], grid.layers * grid.layer_mm])
        leaves = sizes / (LEAF_PERIODS * painted.period_bounds_mm[1])
        if self.planar:
            leaves[2] = 1
        halvings = np.floor(np.log2(np.clip(leaves, 1, MAX_LEAVES))).astype(int)
        self.leaves = np.minimum(2**halvings, 2 ** np.floor(np.log2(pixels)).astype(int))
        self._edges = [np.rint(np.arange(n + 1) / n * p).astype(int) for n, p in zip(self.leaves, pixels, strict=True)]
        materials = len(painted.materials)
        nx, ny, nz = (int(n) for n in self.leaves)
        self._got = np.zeros((materials, nz, ny, nx))
        self._asked = np.zeros((materials, nz, ny, nx))
        self._layers = np.zeros(nz)  # that are not empty

    def count(self, labels: NDArray[np.uint8], cumulative: NDArray[np.float32]) -> tuple[Floats, Floats]:
        """Per material and leaf of a layer, its pixels and the sum of its painted share over the solid.

        Args:
            labels: (rows, columns), row 0 = lowest y, without margin.
            cumulative: (materials - 1, rows, columns) painted.
        """
        solid = labels > 0
        materials = len(self._painted.materials)
        whole = self._sums(solid)[None]
        got = np.stack([self._sums(labels == m) for m in range(1, materials)])
        got = np.concatenate([got, whole - got.sum(axis=0)])
        until = np.stack([self._sums(plane * solid) for plane in cumulative])
        zero = np.zeros_like(whole)
        return got, np.diff(np.concatenate([zero, until, whole]), axis=0)

    def add(self, layer: int, got: Floats, asked: Floats) -> None:
        """Takes a layer's counts."""
        z = 0 if self.planar else int(np.searchsorted(self._edges[2], layer, side="right")) - 1
        self._got[:, z] += got
        self._asked[:, z] += asked
        self._layers[z] += bool(np.any(got))

    def levels(
        self,
        bandwidth: float,
        profile: Profile,
        *,
        values: bool = False,
        aligned: bool = False,
        lobes: Lobes | None = None,
        likeness: Likeness | None = None,
    ) -> Iterator[Level]:
        """The windows of each size, from the leaves to the whole part.

        Args:
            values: materials follow from Gaussian values, not from phases.
            likeness: how alike places are, of noises of which no more is known; then nothing else counts.
            lobes: of the pattern's kernels; the worst of them is expected, and their resonances.
            aligned: phases are: oblique laminates then scatter less, sheets that run along a window's side more, as
                those of a grating do. The larger is expected.
        """
        got, asked = self._got, self._asked
        bandwidths = (bandwidth, ALIGNED_SHARE * bandwidth) if aligned else (bandwidth,)
        edges = [e.astype(float) for e in self._edges]
        while True:
            level = self._level(got, asked, edges, bandwidths, profile, values, lobes, likeness)
            if level is not None:
                yield level
            if all(len(e) == 2 for e in edges):
                return
            for axis in range(3):
                if len(edges[axis]) > 2:
                    along = got.ndim - 1 - axis
                    starts = np.arange(0, got.shape[along], 2)
                    got, asked = np.add.reduceat(got, starts, along), np.add.reduceat(asked, starts, along)
                    edges[axis] = edges[axis][::2]

    def _sums(self, values: NDArray[np.generic]) -> Floats:
        rows = np.add.reduceat(values, self._edges[0][:-1], axis=1, dtype=np.float64)
        return np.asarray(np.add.reduceat(rows, self._edges[1][:-1], axis=0))

    def _level(
        self,
        got: Floats,
        asked: Floats,
        edges: list[Floats],
        bandwidths: tuple[float, ...],
        profile: Profile,
        values: bool,
        lobes: Lobes | None,
        likeness: Likeness | None,
    ) -> Level | None:
        pitch = np.array([*self._grid.pitch_mm, self._grid.layer_mm])
        pixels = np.einsum("i,j,k->kji", *(np.diff(e) for e in edges))
        if self.planar:
            pixels = pixels * self._layers[0]  # of one pattern
        solid = got.sum(axis=0)
        filled = solid / np.maximum(pixels, 1)
        filled[filled >= FULL] = 1.0
        z, y, x = np.nonzero(filled >= FILLED)
        if not len(x):
            return None
        place = np.stack([x, y, z], axis=-1)
        low, high = (
            np.stack([e[place[:, a] + step] * pitch[a] for a, e in enumerate(edges)], axis=-1) for step in (0, 1)
        )
        if self.planar:
            low[:, 2], high[:, 2] = 0.0, self._grid.layers * self._grid.layer_mm
        of_window = solid[z, y, x][:, None]
        got_share, asked_share = (np.moveaxis(c[:, z, y, x], 0, -1) / of_window for c in (got, asked))
        if likeness is not None:
            return self._of_likeness(likeness, low, high, got_share, asked_share, filled[z, y, x], place, edges)
        laws = [self._spread(low, high, asked_share, filled[z, y, x], b, profile, values, lobes) for b in bandwidths]
        sigma, limit = (np.max(found, axis=0) for found in zip(*laws, strict=True))
        counts = tuple(len(e) - 1 for e in edges)
        return Level(low, high, got_share, asked_share, sigma, limit, place, (counts[0], counts[1], counts[2]))

    def _of_likeness(
        self, likeness: Likeness, low_mm: Floats, high_mm: Floats, got: Floats, asked: Floats, filled: Floats,
        place: NDArray[np.int64], edges: list[Floats],
    ) -> Level:  # fmt: skip
        """Windows of a pattern of which only is known how alike places are."""
        axes = 2 if self.planar else 3
        sides = (high_mm - low_mm)[:, :axes]
        pixels = np.prod(sides / np.array([*self._grid.pitch_mm, self._grid.layer_mm])[:axes], axis=1)
        until = np.cumsum(asked, axis=1)
        sigma = deviation_of_likeness(until - asked, until, sides, likeness) / np.sqrt(filled)[:, None]
        sigma = np.hypot(sigma, np.where((asked > 0) & (asked < 1), PIXEL_SHARE / np.sqrt(pixels)[:, None], 0.0))
        limit = np.minimum(SIGMAS * sigma, np.maximum(asked, 1 - asked))
        counts = tuple(len(e) - 1 for e in edges)
        return Level(low_mm, high_mm, got, asked, sigma, limit, place, (counts[0], counts[1], counts[2]))

    def _spread(
        self,
        low_mm: Floats,
        high_mm: Floats,
        asked: Floats,
        filled: Floats,
        bandwidth: float,
        profile: Profile,
        values: bool,
        lobes: Lobes | None,
    ) -> tuple[Floats, Floats]:
        """(W, materials) standard deviations and limits."""
        axes = 2 if self.planar else 3
        middle = (low_mm + high_mm) / 2
        period = self._painted.periods(middle)[:, None]
        isotropy = self._painted.isotropies(middle)
        until = np.minimum(np.cumsum(asked, axis=1), 1.0)
        below = np.concatenate([np.zeros((len(until), 1)), until[:, :-1]], axis=1)
        pitch = np.array([*self._grid.pitch_mm, self._grid.layer_mm])[:axes]
        sides_mm = (high_mm - low_mm)[:, :axes]
        law: dict[str, Any] = {
            "profile": profile, "bandwidth": bandwidth, "dimensions": axes,
            "window_periods": (sides_mm / period)[:, None], "filled": filled[:, None], "isotropy": isotropy[:, None],
        }  # fmt: skip
        # What a wider period does just beside a window reaches into it: the widest in or at it makes the limit.
        widest = {**law, "window_periods": (sides_mm / self._widest(low_mm, high_mm)[:, None])[:, None]}

        def of_direction(normal: Floats, resonance: Floats | float) -> tuple[Floats, Floats]:
            if values:
                pixel = pixel_deviation(
                    below, until, dimensions=axes,
                    pixels_per_period=period / pitch.max(), pixels=np.prod(sides_mm / pitch, axis=1)[:, None],
                )  # fmt: skip
                deviation, limit = level_deviation, level_limit
            else:
                pixel = locked_deviation(
                    below, until, profile=profile, cycles_per_pixel=(normal[:, :axes] * pitch / period)[:, None],
                    extents_px=(sides_mm / pitch)[:, None], width_per_pixel=bandwidth * pitch / period.mean(),
                )  # fmt: skip
                deviation, limit = share_deviation, share_limit
            beside = np.hypot(pixel, resonance)
            sigma = np.hypot(deviation(below, until, **law, normal=normal[:, None]), beside)
            return sigma, limit(below, until, **widest, normal=normal[:, None], pixels=beside)

        found = []
        for share in self._places():
            # Sheets along a window's side are cut in phase only where they run along all of it.
            normal = self._painted.normals(low_mm + share * (high_mm - low_mm))
            if lobes is None:
                found.append(of_direction(normal, 0.0))
                continue
            directions = lobes.all_directions(normal)
            resonance = resonance_deviation(
                below, until, lobes=directions, shares=lobes.shares, bandwidth=bandwidth,
                window_periods=sides_mm / period,
            )  # fmt: skip
            each = [of_direction(directions[:, i], resonance) for i in range(directions.shape[1])]
            sigmas, limits = zip(*each, strict=True)
            found.append((np.max(sigmas, axis=0), np.max(limits, axis=0)))
        sigma, limit = (np.sqrt(np.mean(np.square(some), axis=0)) for some in zip(*found, strict=True))
        return sigma, limit

    def _widest(self, low_mm: Floats, high_mm: Floats) -> Floats:
        """(W,) the longest period at the middles, sides and corners of windows."""
        if not any(self._painted.period.varies):
            return self._painted.periods(low_mm)
        shares = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3), axis=-1).reshape(-1, 3)
        found = [self._painted.periods(low_mm + share * (high_mm - low_mm)) for share in shares]
        return np.asarray(np.max(found, axis=0))

    def _places(self) -> Floats:
        """(N, 3) places of a window, as shares of its sides, where the painted direction is read."""
        turns = any(self._painted.orientation.varies)
        share = (np.arange(PLACES) + 0.5) / PLACES if turns else np.array([0.5])
        return np.stack(np.meshgrid(share, share, [0.5] if self.planar else share), axis=-1).reshape(-1, 3)
