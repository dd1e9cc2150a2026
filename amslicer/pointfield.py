"""G of a job at any points of its part, on the host in float64: the field that its materials are made of.

Kernels are those that devices evaluate, drawn without one (amslicer/hostgenerator.py). In each cell of points all that
reach it are summed: at the points, or, where those are many and the kernels Gaussian, at Chebyshev nodes of their box,
which the points are interpolated from (kernels are then not cut within a cell: 1e-3 of G at most). Waves, walls and
textures are their references' definitions. So what depends on G before a device is open, the shape of a part with
relief, is the same for all devices.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING, cast

import numpy as np

from amslicer import planereference
from amslicer.hostgenerator import HostGenerator
from amslicer.noise.alignment import Alignment
from amslicer.noise.hyperplanes import Hyperplanes
from amslicer.noise.kernels import Kernels, join_kernels
from amslicer.noise.sampling import Asked, sampled_wave
from amslicer.noise.textures import RandomPhase
from amslicer.noise.waves import Wave
from amslicer.randomphase import sample_bilinear

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from amslicer.job import Job
    from amslicer.noise import KernelNoise, Noise
    from amslicer.noise.kernels import CellLayer
    from amslicer.painted import Painted

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

PAIRS_AT_ONCE = 1 << 19  # of points and kernels: temporaries of some 30 MB
# Side of a cell of points: the shortest wave there is, 1/p + 1.3 B/p, makes no more than 0.8 turns along it. Over a box
# a turns long, 6 + 5 a Chebyshev nodes interpolate within 1e-5: 2 J_m(π a).
CELL_TURNS, FASTEST, LEAST_NODES, NODES_PER_TURN = 0.8, 1.3, 6, 5.0
FEW_POINTS = 24  # of a cell, that are summed at faster than at nodes
SLAB_RADII = 4.0  # height of the layers of points whose kernels are in memory at a time
INTERPOLATED_AT_ONCE = 1 << 11  # points: temporaries of some 8 MB
POINTS_AT_ONCE = 1 << 17  # of noises that are no kernels
SHARES = 1 << 14  # of all values, between which the share above one is interpolated
EDGE = 1e-9  # kernels are asked for a rectangle that is this much larger than the part, mm


def field_at(job: Job, painted: Painted, noise: Noise, points_mm: Floats) -> Complexes:
    """(N,) G at (N, 3) points in the pattern frame, mm.

    Raises:
        JobError: a painted field is not usable somewhere.
    """
    if noise.made_of == "textures":
        return _of_textures(noise, points_mm)
    if noise.made_of == "kernels":
        return _Sum(job, painted, cast("KernelNoise", noise)).at(points_mm)
    make = {"waves": _of_waves, "planes": _of_planes}[noise.made_of]
    out = np.empty(len(points_mm), np.complex128)
    for first in range(0, len(points_mm), POINTS_AT_ONCE):
        some = slice(first, first + POINTS_AT_ONCE)
        out[some] = make(job, painted, noise, points_mm[some])
    return out


class _Sum:
    """A noise's kernels, and their sum."""

    def __init__(self, job: Job, painted: Painted, noise: KernelNoise) -> None:
        self._painted, self._noise, self._draw = painted, noise, HostGenerator()
        size = painted.placement.size_mm
        self._bandwidth = job.spec.pattern.bandwidth
        self._rectangle = np.full(2, -EDGE), size[:2] + EDGE
        self._layers: dict[CellLayer, Kernels] = {}
        sweeps = job.spec.pattern.alignment
        aligned = Alignment(noise, sweeps, size, self._draw, self._kernels_of)
        self._made: Callable[[CellLayer], Kernels] = aligned.kernels if sweeps else self._kernels_of

    def _kernels_of(self, number: CellLayer) -> Kernels:
        return self._noise.kernels(self._draw, number, *self._rectangle, self._painted)

    def at(self, points_mm: Floats) -> Complexes:
        """(N,) G."""
        points = points_mm * (1.0, 1.0, 0.0) if self._noise.dimensions == 2 else points_mm
        out = np.zeros(len(points), np.complex128)
        height = SLAB_RADII * self._noise.radius_mm
        slab = np.floor(points[:, 2] / height).astype(np.int64)
        for number in np.unique(slab):
            here = np.flatnonzero(slab == number)
            kernels = self._kernels(float(points[here, 2].min()), float(points[here, 2].max()))
            if len(kernels):
                out[here] = self._of_slab(points[here], points_mm[here], kernels)
        return out

    def _kernels(self, low_z_mm: float, high_z_mm: float) -> Kernels:
        numbers = self._noise.cell_layers(low_z_mm, high_z_mm)
        self._layers = {n: self._layers[n] if n in self._layers else self._made(n) for n in numbers}
        return join_kernels([self._layers[n] for n in numbers])

    def _of_slab(self, points: Floats, places: Floats, kernels: Kernels) -> Complexes:
        """G at points, whose places also count where fields are read."""
        side = CELL_TURNS / self._frequency
        cell = np.floor(points / side).astype(np.int64)
        order = np.lexsort(cell.T)
        starts = np.flatnonzero(np.append(True, np.any(np.diff(cell[order], axis=0), axis=1)))
        out = np.empty(len(points), np.complex128)
        cells = np.asarray((cell[order[starts]] + 0.5) * side, np.float64)
        for near, here in zip(_near(kernels, cells, side / 2), np.split(order, starts[1:]), strict=True):
            close = Kernels(*(getattr(kernels, f.name)[near] for f in fields(Kernels)))
            if self._smooth and len(here) > FEW_POINTS:
                out[here] = self._interpolated(points[here], places[here], close)
                continue
            step = max(1, PAIRS_AT_ONCE // max(1, len(near)))
            for first in range(0, len(here), step):
                some = here[first : first + step]
                out[some] = self._of_points(points[some], places[some], close)
        return out

    @property
    def _frequency(self) -> float:
        """About the highest of G, 1/mm."""
        return (1 + FASTEST * self._bandwidth) / self._painted.period_bounds_mm[0]

    @property
    def _smooth(self) -> bool:
        """Whether kernels are products along the axes."""
        return self._noise.envelope is None and not self._noise.at_nodes

    def _interpolated(self, points: Floats, places: Floats, kernels: Kernels) -> Complexes:
        """G at the points of a cell, from Chebyshev nodes of their box; one normal says how all kernels are taken."""
        low, high = points.min(axis=0), points.max(axis=0)
        middle, half = (low + high) / 2, (high - low) / 2
        against = np.zeros(len(kernels), bool)
        if self._painted.turns:
            normal = self._painted.normals((places.min(axis=0) + places.max(axis=0))[None] / 2)[0]
            against = kernels.normal @ normal < 0
        factors, shares = [], []
        for axis in range(3):
            turns = 2 * half[axis] * self._frequency
            count = LEAST_NODES + math.ceil(NODES_PER_TURN * turns) if half[axis] > 0 else 1
            order, angle = np.arange(count), (np.arange(count) + 0.5) * np.pi / count
            d = middle[axis] + half[axis] * np.cos(angle)[:, None] - kernels.centre_mm[:, axis]
            factors.append(np.exp(-kernels.decay * d**2 + 1j * kernels.wave[:, axis] * d))
            at = np.arccos(np.clip((points[:, axis] - middle[axis]) / (half[axis] or 1.0), -1.0, 1.0))
            terms = np.where(order > 0, 2.0, 1.0) / count * np.cos(order * at[:, None])
            shares.append(np.einsum("nk,ak->na", terms, np.cos(order * angle[:, None])))
        first = factors[0] * np.exp(1j * kernels.phase)
        if against.any():  # taken conjugated: with the opposite sign
            first, *rest = (np.where(against, f.conj(), f) for f in (first, *factors[1:]))
            factors[1:] = rest
        pairs = (first[:, None] * factors[1]).reshape(-1, len(kernels))
        # einsum, not @: BLAS takes threads of its own, that no --jobs bounds.
        (a, b), (c, d) = ((np.ascontiguousarray(f.real), np.ascontiguousarray(f.imag)) for f in (pairs, factors[2]))
        re, im = (np.einsum("pk,ck->pc", *one) + sign * np.einsum("pk,ck->pc", *other)
                  for one, sign, other in (((a, c), -1, (b, d)), ((a, d), 1, (b, c))))  # fmt: skip
        nodes = np.ascontiguousarray((re + 1j * im).reshape(len(first), -1)).view(np.float64)
        out = np.empty(len(points), np.complex128)
        for begin in range(0, len(points), INTERPOLATED_AT_ONCE):
            x, y, z = (share[begin : begin + INTERPOLATED_AT_ONCE] for share in shares)
            along = np.einsum("na,ap->np", x, nodes).view(np.complex128).reshape(len(x), y.shape[1], z.shape[1])
            out[begin : begin + len(x)] = np.einsum("nb,nb->n", y, np.einsum("nbc,nc->nb", along, z))
        return out

    def _of_points(self, points: Floats, places: Floats, kernels: Kernels) -> Complexes:
        noise = self._noise
        d = [points[:, axis, None] - kernels.centre_mm[:, axis] for axis in range(3)]
        squared = d[0] ** 2 + d[1] ** 2 + d[2] ** 2
        if noise.envelope is None:
            inside = (np.abs(d[0]) < kernels.radius_mm) & (np.abs(d[1]) < kernels.radius_mm)
            inside &= np.abs(d[2]) < kernels.radius_mm
            size = np.where(inside, np.exp(-kernels.decay * squared), 0.0)
        else:
            table = noise.envelope.astype(np.float64)
            size = np.interp(squared / kernels.radius_mm**2, np.linspace(0.0, 1.0, len(table)), table)
        if noise.at_nodes:
            waves = noise.waves_at(self._draw, self._painted, places)
            against = np.einsum("ni,ki->nk", waves, kernels.normal) < 0
            phase = np.where(against, -kernels.phase, kernels.phase)
            angle = waves[:, 0, None] * d[0] + waves[:, 1, None] * d[1] + waves[:, 2, None] * d[2] + phase
        else:
            k = kernels.wave
            angle = k[:, 0] * d[0] + k[:, 1] * d[1] + k[:, 2] * d[2] + kernels.phase
            if self._painted.turns:
                cosine = np.einsum("ni,ki->nk", self._painted.normals(places), kernels.normal)
                angle = np.where(cosine < 0, -angle, angle)
        return np.asarray((size * np.cos(angle)).sum(axis=1) + 1j * (size * np.sin(angle)).sum(axis=1))


def _near(kernels: Kernels, centres: Floats, half_mm: float) -> Iterator[NDArray[np.int64]]:
    """Per cube of half side half_mm, the kernels that reach it, in their order."""
    from scipy.spatial import cKDTree

    octave = np.frexp(kernels.radius_mm)[1]
    groups = [np.flatnonzero(octave == n) for n in np.unique(octave)]
    trees = [cKDTree(kernels.centre_mm[some]) for some in groups]
    reaches = [float(kernels.radius_mm[some].max()) + half_mm for some in groups]
    for centre in centres:
        found = [
            some[tree.query_ball_point(centre, reach, p=np.inf)]
            for some, tree, reach in zip(groups, trees, reaches, strict=True)
        ]
        near = np.sort(np.concatenate(found))
        reach = kernels.radius_mm[near, None] + half_mm
        yield near[np.all(np.abs(kernels.centre_mm[near] - centre) < reach, axis=1)]


def _of_waves(job: Job, painted: Painted, noise: Noise, points: Floats) -> Complexes:
    low, high = painted.isotropy_bounds
    period = painted.period_bounds_mm
    asked = Asked(
        job.spec.pattern.noise, (points[:, 0], points[:, 1], points[:, 2]), painted.periods,
        lambda _: np.clip(painted.periods(points), *period), period, job.spec.pattern.bandwidth,
        lambda _: painted.normals(points), low if low == high else lambda _: painted.isotropies(points),
        job.spec.pattern.seed, noise.dimensions, painted.turns, {},
    )  # fmt: skip
    return sampled_wave(cast("Wave", noise), asked)


def _of_planes(job: Job, painted: Painted, noise: Noise, points: Floats) -> Complexes:
    assert isinstance(noise, Hyperplanes)
    value, _ = planereference.values(
        noise.kind, *points.T, period=noise.period_mm, dimensions=noise.dimensions, seed=noise.seed,
        directions=noise.directions, probability=noise.probability, depth=noise.depth,
    )  # fmt: skip
    return value.astype(np.complex128)


def _of_textures(noise: Noise, points: Floats) -> Complexes:
    """As textureevaluator.py: all points at once, so that each texture is made once or twice."""
    assert isinstance(noise, RandomPhase)
    heights = points[:, 2] if noise.dimensions == 3 else np.zeros(len(points))
    unique, which = np.unique(heights, return_inverse=True)
    steps, shares = np.array([noise.place(float(height)) for height in unique], np.float64).reshape(-1, 2)[which].T
    x, y = points[:, 0] / noise.pixel_mm, points[:, 1] / noise.pixel_mm
    out = np.zeros(len(points))
    for up in (0, 1):
        weight = shares if up else 1 - shares
        for step in np.unique(steps[weight > 0]):
            here = np.flatnonzero((steps == step) & (weight > 0))
            texture = noise.texture(int(step) + up).astype(np.float64)
            out[here] += weight[here] * sample_bilinear(texture, x[here], y[here])
    return out.astype(np.complex128)


def turns_at(noise: Noise, g: Complexes) -> Floats:
    """Shares of a turn, 0…1, that waveforms are read at: of arg G, or half the share of all values above one."""
    if noise.reads == "phase":
        return np.asarray(np.where(g == 0, 0.5, np.angle(g) / (2 * np.pi) % 1.0))
    value = g.real if noise.reads == "value" else np.abs(g) ** 2
    share = np.linspace(0.0, 1.0, SHARES + 1)
    level = np.minimum.accumulate(noise.levels_of(share[1:-1]))
    return np.asarray(np.interp(-value, -level, share[1:-1]) / 2)
