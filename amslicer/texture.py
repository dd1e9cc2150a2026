"""The laminate that a stack shows – direction, period, isotropy – against the painted one, block by block.

A block of some periods has a power spectrum with lines at ±n/p, as wide as the noise's bandwidth makes them
(σ² = b²/4π per axis) and as the block's own window does. Its moments are compared with those of that model, made of the
painted fields on the same frequencies: what is biased in one is biased in the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.noise.lobes import Lobes
    from amslicer.painted import Painted
    from amslicer.profiles import Profile

    Floats = NDArray[np.float64]

BLOCK_PERIODS = 7.0  # side of a block: enough for a direction and a period, few enough to follow what is painted
SAMPLES_PER_PERIOD = 6.0  # of the thinned stack; its lines lie below 1.4/p
BAND = (0.6, 1.4)  # of 1/p: where the lines' power is looked for
FILLED = 0.4  # blocks with less of the part in them say too little
MIN_SHEET_PX = 2.0  # thinner sheets are seen as dots
MIN_CONTRAST = 0.03  # variance of the levels: a fifteenth of that of two equal materials
# Blocks in which the painted direction turns or jumps by more (share of n nᵀ along its mean) show no one direction.
ONE_DIRECTION, LOOKS = 0.9, 5
PLACES = 2  # per axis of a block where the painted fields are read
TURNS_FLAT, TURNS_ROUND, TURNS_TILT = 9, 8, 4  # directions that stand for a spread of them


@dataclass(frozen=True)
class Shown:
    """One block's texture.

    Attributes:
        centre_mm: (3,) pattern frame.
        normal: (3,) the strongest direction.
        expected_normal: (3,) of the painted model.
        turn_deg: (3,) the rotation from the painted to the shown normal, about x, y, z.
        frequency: centroid of the power, as a multiple of the model's: 1/1.1 where the period is 1.1 times the painted.
        along: share of the power's direction along the painted normal, ⟨(f·n)²/f²⟩.
        expected_along: of the model.
        isotropy: painted, mean.
    """

    centre_mm: Floats
    normal: Floats
    expected_normal: Floats
    turn_deg: Floats
    frequency: float
    along: float
    expected_along: float
    isotropy: float

    @property
    def angle_deg(self) -> float:
        """Between the shown and the painted normal, as lines."""
        return float(np.linalg.norm(self.turn_deg))


class Texture:
    """Gathers a stack layer by layer, thinned, and measures its blocks.

    Args:
        bandwidth, profile, lobes: of the pattern.
    """

    def __init__(
        self, painted: Painted, grid: Grid, bandwidth: float, profile: Profile, lobes: Lobes | None = None
    ) -> None:
        self._painted, self._grid, self._bandwidth, self._profile = painted, grid, bandwidth, profile
        self._lobes = lobes
        self.planar = painted.dimensions == 2
        shortest, longest = painted.period_bounds_mm
        pitch = np.array([*grid.pitch_mm, grid.layer_mm])
        self.thinning = np.maximum(1, np.floor(shortest / SAMPLES_PER_PERIOD / pitch)).astype(int)
        counts = np.array([grid.columns, grid.rows, grid.layers]) // self.thinning
        blocks = np.maximum(1, np.rint(counts * self.thinning * pitch / (BLOCK_PERIODS * longest))).astype(int)
        if self.planar:
            self.thinning[2], counts[2], blocks[2] = grid.layers, 1, 1
        self.step_mm = self.thinning * pitch
        self.counts = counts
        # Edges of the blocks, in thinned samples, along x, y, z.
        self.edges = [np.rint(np.linspace(0, n, b + 1)).astype(int) for n, b in zip(counts, blocks, strict=True)]
        self._planes: dict[int, NDArray[np.float32]] = {}
        self._added = 0
        share = (np.arange(LOOKS) + 0.5) / LOOKS
        self._look = np.stack(np.meshgrid(share, share, [0.5] if self.planar else share), axis=-1).reshape(-1, 3)

    @property
    def usable(self) -> bool:
        """Whether pixels show the laminate at all."""
        period = self._painted.period_bounds_mm[0]
        return bool(np.all(self.counts > 0) and np.all(self.step_mm[: 2 if self.planar else 3] * 3 <= period))

    def thin(self, labels: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(materials, y, x) pixels of each material in each thinned sample of a layer.

        Args:
            labels: (rows, columns), row 0 = lowest y, without margin.
        """
        tx, ty = (int(n) for n in self.thinning[:2])
        nx, ny = (int(n) for n in self.counts[:2])
        out = np.zeros((len(self._painted.materials), ny, nx), np.float32)
        for m, counts in enumerate(out, 1):
            here = labels[: ny * ty, : nx * tx] == m
            rows = np.zeros((ny, nx * tx), np.uint16)
            for first in range(ty):  # whole strided planes: twenty times as fast as a sum over short axes
                rows += here[first::ty]
            for first in range(tx):
                counts += rows[:, first::tx]
        return out

    def add(self, layer: int, counts: NDArray[np.float32]) -> Iterator[Shown]:
        """Takes the next layer's counts; yields the blocks that are complete with it."""
        plane = layer // self.thinning[2]
        if plane >= self.counts[2]:
            return
        gathered = self._planes.get(plane)
        self._planes[plane] = counts if gathered is None else gathered + counts
        if self.planar:
            self._added += 1
            return
        last_of_plane = layer == (plane + 1) * self.thinning[2] - 1
        edge = int(np.searchsorted(self.edges[2], plane + 1))
        if last_of_plane and self.edges[2][min(edge, len(self.edges[2]) - 1)] == plane + 1:
            low = int(self.edges[2][edge - 1])
            planes = [self._planes.pop(number) for number in range(low, plane + 1) if number in self._planes]
            if len(planes) == plane + 1 - low:  # else layers of the stack are missing
                yield from self._blocks(np.stack(planes, axis=1), low)

    def finish(self) -> Iterator[Shown]:
        """Yields the blocks of a planar pattern, whose layers all show the same."""
        if self.planar and self._planes:
            self.thinning[2] = self._added
            yield from self._blocks(self._planes.pop(0)[:, None], 0)

    def _blocks(self, counts: NDArray[np.float32], low: int) -> Iterator[Shown]:
        """Measures the blocks of (materials, z, y, x) counts, z from the thinned plane `low` on."""
        for y0, y1 in zip(self.edges[1][:-1], self.edges[1][1:], strict=True):
            for x0, x1 in zip(self.edges[0][:-1], self.edges[0][1:], strict=True):
                block = counts[:, :, y0:y1, x0:x1]
                corner = np.array([x0, y0, low]) * self.step_mm
                shown = self._measure(block, corner)
                if shown is not None:
                    yield shown

    def _measure(self, counts: NDArray[np.float32], corner_mm: Floats) -> Shown | None:
        solid = counts.sum(axis=0)
        if solid.mean() < FILLED * np.prod(self.thinning):
            return None
        size_mm = np.array(counts.shape[:0:-1]) * self.step_mm
        places = _places(corner_mm, size_mm, self.planar)
        normals = self._painted.normals(corner_mm + self._look * size_mm)
        if np.linalg.eigvalsh(normals.T @ normals / len(normals))[-1] < ONE_DIRECTION:
            return None
        period = float(self._painted.periods(places).mean())
        shares = counts.sum(axis=(1, 2, 3)) / solid.sum()
        thinnest = min((s for s in shares if s > 0), default=0.0) * period
        levels = self._profile.levels(shares, float(self._painted.blends(places).mean()))
        contrast = float(shares @ levels**2 - (shares @ levels) ** 2)
        if contrast < MIN_CONTRAST or thinnest < MIN_SHEET_PX * max(self._grid.pitch_mm):
            return None
        taper = _taper(solid.shape)
        # Local shares of the block as a plane: a graded ratio is no line of the spectrum.
        signal = np.tensordot(levels - shares @ levels, counts, axes=1)
        window = solid * taper
        values = signal * taper - window * ((signal * taper).sum() / window.sum())
        frequencies, power = _power(values, self.step_mm, self.planar)
        length = np.linalg.norm(frequencies, axis=1)
        band = (length > BAND[0] / period) & (length < BAND[1] / period)
        f, p, length = frequencies[band], power[band], length[band]
        model = self._model(f, places, window)
        return _compare(f, length, p, model, places, self._painted, corner_mm + size_mm / 2)

    def _model(self, f: Floats, places: Floats, window: Floats) -> Floats:
        """(F,) expected power at the frequencies: lines of the painted directions and periods."""
        periods = self._painted.periods(places)
        normals = self._painted.normals(places)
        isotropies = self._painted.isotropies(places)
        steps = self.step_mm[::-1]
        spread = []
        for axis in range(3):
            slope = np.diff(window, axis=axis, prepend=0, append=0) / steps[axis]
            spread.append((slope**2).sum() / (4 * np.pi**2 * (window**2).sum()) if window.shape[axis] > 1 else 0.0)
        power = np.zeros(len(f))
        directions, shares = normals[:, None], np.ones(1)
        if self._lobes is not None:
            directions, shares = self._lobes.all_directions(normals), self._lobes.shares
        for lobes, s, p in zip(directions, isotropies, periods, strict=True):
            variance = (self._bandwidth / p) ** 2 / (4 * np.pi) + np.array(spread[::-1])
            for n, share in zip(lobes, shares, strict=True):
                for direction, weight in _spread_normals(n, float(s), self.planar):
                    for sign in (1, -1):
                        d2 = ((f - sign * direction / p) ** 2 / variance).sum(axis=1)
                        power += share * weight * np.exp(-d2 / 2)
        return power


def _places(corner_mm: Floats, size_mm: Floats, planar: bool) -> Floats:
    """(N, 3) evenly spread places of a block."""
    share = (np.arange(PLACES) + 0.5) / PLACES
    grid = np.meshgrid(share, share, [0.5] if planar else share, indexing="ij")
    return corner_mm + np.stack(grid, axis=-1).reshape(-1, 3) * size_mm


def _taper(shape: tuple[int, ...]) -> Floats:
    """A Hann window along every axis that is longer than a sample."""
    out: Floats = np.ones(shape)
    for axis, count in enumerate(shape):
        if count > 1:
            hann = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
            out = out * hann.reshape([-1 if a == axis else 1 for a in range(len(shape))])
    return out


def _power(values: Floats, step_mm: Floats, planar: bool) -> tuple[Floats, Floats]:
    """(F, 3) frequencies x, y, z in 1/mm and (F,) power of (z, y, x) values; one of f and -f, which are equal."""
    from scipy.fft import next_fast_len, rfftn

    shape = [1 if planar else next_fast_len(values.shape[0]), *(next_fast_len(n, real=True) for n in values.shape[1:])]
    power = np.abs(rfftn(values, shape)) ** 2
    nz, ny, nx = shape
    along = [np.zeros(1) if planar else np.fft.fftfreq(nz, step_mm[2]), np.fft.fftfreq(ny, step_mm[1])]
    z, y, x = np.meshgrid(*along, np.fft.rfftfreq(nx, step_mm[0]), indexing="ij")
    # A sample is the mean over its own size, which lowers what is fast.
    power /= np.square(np.sinc(x * step_mm[0]) * np.sinc(y * step_mm[1]) * (1.0 if planar else np.sinc(z * step_mm[2])))
    # Where f_x = 0 the transform has both f and -f: sheets along x would count twice.
    one = (x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z > 0))))
    return np.stack([x[one], y[one], z[one]], axis=-1), power[one]


def _spread_normals(normal: Floats, isotropy: float, planar: bool) -> Iterator[tuple[Floats, float]]:
    """Directions evenly spread as isotropy says, and their weights."""
    if isotropy == 0:
        yield normal, 1.0
        return
    widest = isotropy * np.pi / 2
    if planar:
        for share in (np.arange(TURNS_FLAT) + 0.5) / TURNS_FLAT:
            angle = np.arctan2(normal[1], normal[0]) + widest * (2 * share - 1)
            yield np.array([np.cos(angle), np.sin(angle), 0.0]), 1 / TURNS_FLAT
        return
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    aside /= np.linalg.norm(aside)
    other = np.cross(normal, aside)
    for tilt in (np.arange(TURNS_TILT) + 0.5) / TURNS_TILT:
        cosine = 1 - tilt * (1 - np.cos(widest))
        sine = np.sqrt(1 - cosine**2)
        for around in (np.arange(TURNS_ROUND) + tilt) / TURNS_ROUND * 2 * np.pi:
            across = np.cos(around) * aside + np.sin(around) * other
            yield cosine * normal + sine * across, 1 / (TURNS_TILT * TURNS_ROUND)


def _compare(
    f: Floats, length: Floats, power: Floats, model: Floats, places: Floats, painted: Painted, centre_mm: Floats
) -> Shown | None:
    if not power.sum() > 0 or not model.sum() > 0:
        return None
    unit = f / length[:, None]
    shown, expected = (_strongest(unit, p) for p in (power, model))
    turn = np.cross(expected, shown * (1 if shown @ expected >= 0 else -1))
    sine = float(np.linalg.norm(turn))
    angle = np.rad2deg(np.arcsin(min(sine, 1.0)))
    normals = painted.normals(places)
    painted_normal = np.linalg.eigh(normals.T @ normals)[1][:, -1]
    squared = (unit @ painted_normal) ** 2
    return Shown(
        centre_mm=centre_mm,
        normal=shown,
        expected_normal=expected,
        turn_deg=turn / sine * angle if sine > 0 else turn,
        frequency=float((power @ length) / power.sum() / ((model @ length) / model.sum())),
        along=float(power @ squared / power.sum()),
        expected_along=float(model @ squared / model.sum()),
        isotropy=float(painted.isotropies(places).mean()),
    )


def _strongest(unit: Floats, power: Floats) -> Floats:
    """(3,) the direction with most power: the largest eigenvector of Σ P u uᵀ."""
    return np.asarray(np.linalg.eigh((unit * power[:, None]).T @ unit)[1][:, -1])
