"""What is painted on a placed part: shares of the materials, direction, isotropy and period, sampled anywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.fields import Frame, Sampler, open_field, open_orientation
from amslicer.fields.materialmap import MaterialMap
from amslicer.fields.orientation import Angles, Orientation, Vector
from amslicer.fields.raster import Raster, Rastered, raster_of
from amslicer.fields.source import Source
from amslicer.profiles.waveforms import BlendShape
from amslicer.specification import REST, AzimuthElevation, VectorComponents, shares_by_material

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.envelope import EnvelopePeriods
    from amslicer.fields.source import Part
    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.placement import Placement
    from amslicer.regions import Regions

    Floats = NDArray[np.float64]

RATIO_ROWS = 64  # rows of the ratio evaluated at a time; fixed, so that every run does the same arithmetic
ROUNDING = 1e-9  # how far interpolation may leave 0…1
SUM_ROUNDING = 1e-6  # how far ratios that are all given may be from summing to 1


@dataclass(frozen=True)
class Painted:
    """A job's fields, opened over its placed part. Points are pattern-frame mm, directions printer axes.

    Attributes:
        materials: names, in the order of the profile.
        ratios: share of each material; None for the one that takes the rest.
        orientation: the laminate's normal.
        isotropy: 0 laminate … 1 isotropic.
        period: mm.
        blend: of the profile's two waveforms, 0…1; None where there is nothing to blend.
        regions: what is of one material whatever is painted there; None where nothing is.
        mid_height_mm: where a 2D pattern's kernels sample the fields.
    """

    materials: tuple[str, ...]
    ratios: tuple[Sampler | None, ...]
    orientation: Orientation
    isotropy: Sampler
    period: Sampler
    placement: Placement
    mid_height_mm: float
    dimensions: int
    blend: Sampler | None = None
    regions: Regions | None = None

    def normals(self, points_mm: Floats) -> Floats:
        """(N, 3) unit normals at (N, 3) points; flat in 2D, at mid-height."""
        normals = self.placement.turn(self.orientation.normals(*self._coordinates(points_mm)))
        if self.dimensions == 2:
            normals = normals * (1.0, 1.0, 0.0)
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            upright = length < 1e-6  # a normal that points straight up has no direction in the plane
            normals = np.where(upright, (1.0, 0.0, 0.0), normals / np.where(upright, 1.0, length))
        return normals

    def isotropies(self, points_mm: Floats) -> Floats:
        """(N,) painted isotropy, 0…1, at (N, 3) points.

        Raises:
            JobError: it leaves 0…1; the message says where and how much.
        """
        coordinates = self._coordinates(points_mm)
        values = np.broadcast_to(self.isotropy.scalar(*coordinates), (len(points_mm),))
        wrong = ~((values >= -ROUNDING) & (values <= 1 + ROUNDING))
        if wrong.any():
            i = int(np.argmax(wrong))
            raise _out_of_range("fields.isotropy", values[i], self._where(*(c[i] for c in coordinates)), "an isotropy")
        return np.clip(values, 0.0, 1.0)

    def periods(self, points_mm: Floats) -> Floats:
        """(N,) painted period, mm, at (N, 3) points."""
        return np.broadcast_to(self.period.scalar(*self._coordinates(points_mm)), (len(points_mm),))

    def envelope_periods(self, points_mm: Floats, periods_mm: Floats) -> Floats:
        """(N,) the period that kernels' widths follow at (N, 3) points of these periods: less where it steps."""
        if not any(self.period.varies):
            return periods_mm
        return self._envelope.at(points_mm, periods_mm)

    @cached_property
    def _envelope(self) -> EnvelopePeriods:
        from amslicer.envelope import EnvelopePeriods

        return EnvelopePeriods(self)

    @property
    def period_bounds_mm(self) -> tuple[float, float]:
        """No painted period is shorter than the first or longer than the second."""
        return self.period.bounds

    @property
    def is_laminate(self) -> bool:
        """Whether isotropy is 0 everywhere."""
        return self.isotropy.bounds == (0.0, 0.0)

    @property
    def isotropy_bounds(self) -> tuple[float, float]:
        """No painted isotropy is below the first or above the second."""
        return self.isotropy.bounds

    @property
    def turns(self) -> bool:
        """Whether the painted direction is not the same everywhere."""
        return self.orientation.turns

    @property
    def one_direction(self) -> bool:
        """Whether direction and isotropy are the same everywhere."""
        return not self.turns and self.isotropy.bounds[0] == self.isotropy.bounds[1]

    @property
    def direction_depends_on_z(self) -> bool:
        """Whether direction, isotropy or period change from layer to layer."""
        fields = (self.orientation, self.isotropy, self.period)
        return any(self.placement.depends_on_z(field.varies) for field in fields)

    @property
    def ratio_depends_on_z(self) -> bool:
        """Whether any material's share changes from layer to layer."""
        return any(self.placement.depends_on_z(ratio.varies) for ratio in self.ratios if ratio is not None)

    @property
    def materials_depend_on_z(self) -> bool:
        """Whether the ratio or the blend of profiles changes from layer to layer."""
        blended = self.blend is not None and self.placement.depends_on_z(self.blend.varies)
        return blended or self.ratio_depends_on_z

    def share_bounds(self) -> list[tuple[float, float]]:
        """Per material, bounds of its painted share; those of the rest follow from the others."""
        given = [ratio.bounds for ratio in self.ratios if ratio is not None]
        rest = 1 - sum(high for _, high in given), 1 - sum(low for low, _ in given)
        return [rest if ratio is None else ratio.bounds for ratio in self.ratios]

    def check_ratio(self, grid: Grid) -> None:
        """Looks for painted ratios and blends that are none in a few layers, before anything is written.

        Raises:
            JobError: as ratio_map does.
        """
        if self.blend is not None and not (self.blend.bounds[0] >= -ROUNDING and self.blend.bounds[1] <= 1 + ROUNDING):
            for layer in {0, grid.layers // 2, grid.layers - 1} if self.materials_depend_on_z else {0}:
                self.blend_map(grid, layer)
        surely = all(low >= -ROUNDING and high <= 1 + ROUNDING for low, high in self.share_bounds())
        if not surely or None not in self.ratios:
            for layer in {0, grid.layers // 2, grid.layers - 1} if self.ratio_depends_on_z else {0}:
                self.ratio_map(grid, layer)

    def ratio_map(self, grid: Grid, layer: int) -> NDArray[np.float32]:
        """Cumulative painted ratios at the pixel centres of a layer: the share of the materials up to m.

        Returns:
            (materials - 1, rows, columns), row 0 = lowest y; not decreasing along the first axis.

        Raises:
            JobError: a ratio leaves 0…1, or they do not sum to 1; the message says where and how much.
        """
        x, z = grid.x_mm()[None, :], np.asarray(grid.z_mm(layer))
        out = np.empty((len(self.ratios) - 1, grid.rows, grid.columns), np.float32)
        for first in range(0, grid.rows, RATIO_ROWS):
            y = grid.y_mm()[first : first + RATIO_ROWS, None]
            shape = (len(y), grid.columns)
            coordinates = self.placement.to_field(x, y, z)
            values = [None if r is None else np.broadcast_to(r.scalar(*coordinates), shape) for r in self.ratios]
            self._check_shares(values, coordinates, shape)
            rows = out[:, first : first + RATIO_ROWS]
            for m, share in enumerate(_cumulative(values)):
                rows[m] = np.clip(share, 0.0, 1.0)
                if m:
                    np.maximum(rows[m - 1], rows[m], out=rows[m])
        return out

    def ratio_rasters(self, grid: Grid, layer: int) -> list[Raster]:
        """What ratio_map gives, plane by plane, as texels to interpolate between, but for the rounding of float32.

        Raises:
            JobError: as ratio_map.
        """
        few = self.ratio_texels(grid, layer)
        return [raster_of(plane) for plane in self.ratio_map(grid, layer)] if few is None else [few]

    def ratio_texels(self, grid: Grid, layer: int) -> Raster | None:
        """The same of two materials, where the field has texels of its own; None where not, or it may leave 0…1."""
        ratio = self.ratios[0]
        if len(self.ratios) != 2 or self.ratios[1] is not None or not isinstance(ratio, Rastered):
            return None
        if not (ratio.bounds[0] >= 0 and ratio.bounds[1] <= 1):
            return None
        x, y, z = self.placement.to_field(grid.x_mm()[None, :], grid.y_mm()[:, None], np.asarray(grid.z_mm(layer)))
        if x.shape != (1, grid.columns) or y.shape != (grid.rows, 1) or z.size != 1:  # a turned part
            return None
        found = ratio.raster(x, y, z)
        return found.used() if found is not None and found.is_plain else None

    def asked_map(self, grid: Grid, layer: int) -> NDArray[np.float32]:
        """As ratio_map, with what is asked where skins and bodies have a material of their own."""
        asked = self.ratio_map(grid, layer)
        if self.regions is not None:
            given = self.regions.labels(layer)
            for m, until in enumerate(asked, 1):
                np.copyto(until, given <= m, where=given > 0, casting="unsafe")
        return asked

    @property
    def asked_depends_on_z(self) -> bool:
        """Whether what asked_map says changes from layer to layer."""
        return self.ratio_depends_on_z or self.regions is not None

    def blend_map(self, grid: Grid, layer: int) -> NDArray[np.float32]:
        """(rows, columns) from the profile's first waveform to its second, 0…1, at the pixel centres of a layer.

        Raises:
            JobError: it leaves 0…1; the message says where and how much.
        """
        assert self.blend is not None
        x, z = grid.x_mm()[None, :], np.asarray(grid.z_mm(layer))
        out = np.empty((grid.rows, grid.columns), np.float32)
        for first in range(0, grid.rows, RATIO_ROWS):
            y = grid.y_mm()[first : first + RATIO_ROWS, None]
            coordinates = self.placement.to_field(x, y, z)
            values = np.broadcast_to(self.blend.scalar(*coordinates), (len(y), grid.columns))
            wrong = ~((values >= -ROUNDING) & (values <= 1 + ROUNDING))
            if wrong.any():
                raise _out_of_range("pattern.profile.blend.by", *self._first(wrong, values, coordinates), "a blend")
            out[first : first + RATIO_ROWS] = np.clip(values, 0.0, 1.0)
        return out

    def blends(self, points_mm: Floats) -> Floats:
        """(N,) the blend at (N, 3) points; 0 where there is none."""
        if self.blend is None:
            return np.zeros(len(points_mm))
        return np.clip(np.broadcast_to(self.blend.scalar(*self._coordinates(points_mm)), (len(points_mm),)), 0.0, 1.0)

    def _check_shares(
        self, values: list[Floats | None], coordinates: tuple[Floats, Floats, Floats], shape: tuple[int, int]
    ) -> None:
        rest = _rest(values)
        total: Floats = np.zeros(shape)
        for name, share in zip(self.materials, values, strict=True):
            if share is not None:
                key = "fields.ratio" if len(self.materials) == 2 and rest is not None else f"fields.ratio.{name}"
                wrong = ~((share >= -ROUNDING) & (share <= 1 + ROUNDING))
                if wrong.any():
                    raise _out_of_range(key, *self._first(wrong, share, coordinates), "a ratio")
                total = total + share
        if rest is not None:
            wrong = ~(total <= 1 + len(values) * ROUNDING)
            if wrong.any():
                excess, where = self._first(wrong, total, coordinates)
                raise JobError(
                    f"fields.ratio: the ratios sum to {excess:.6g} at {where}, which leaves {1 - excess:.3g} for "
                    f"'{self.materials[rest]}', the rest",
                    hint="change the fields so that the others never sum to more than 1",
                )
            return
        wrong = ~(np.abs(total - 1) <= SUM_ROUNDING)
        if wrong.any():
            amount, where = self._first(wrong, total, coordinates)
            raise JobError(
                f"fields.ratio: the ratios sum to {amount:.6g} instead of 1 at {where} (off by {amount - 1:+.3g})",
                hint=f"give one material the rest, for example {self.materials[-1]}: {REST}",
            )

    def _first(
        self, wrong: NDArray[np.bool_], values: Floats, coordinates: tuple[Floats, Floats, Floats]
    ) -> tuple[float, str]:
        """The first wrong value, and where it stands."""
        row, column = np.argwhere(wrong)[0]
        x, y, z = (np.broadcast_to(c, wrong.shape)[row, column] for c in coordinates)
        return float(values[row, column]), self._where(x, y, z)

    def _where(self, *place: float) -> str:
        corner = self.placement.file_minimum_mm
        at = ", ".join(f"{axis} = {float(v + low):.2f}" for axis, v, low in zip("xyz", place, corner, strict=True))
        return f"{at} mm (file coordinates)"

    def _coordinates(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """(N,) field-frame coordinates of (N, 3) points; all at mid-height in 2D."""
        z = np.full(len(points_mm), self.mid_height_mm) if self.dimensions == 2 else points_mm[:, 2]
        x, y, z = np.broadcast_arrays(*self.placement.to_field(points_mm[:, 0], points_mm[:, 1], z))
        return x, y, z


def _out_of_range(key: str, value: float, where: str, what: str) -> JobError:
    return JobError(
        f"{key} is {value:.4g} at {where}; {what} is between 0 and 1",
        hint="change the field's range (or from and to) so that it stays within 0 and 1, clip() an expression, or give "
        "points within: [0, 1]: a thin plate overshoots them",
    )


def _cumulative(values: list[Floats | None]) -> Iterator[Floats]:
    """Shares of the first, the first two, … materials, but for all of them: from the front, and beyond the
    material that takes the rest from the back."""
    found = _rest(values)
    rest = len(values) - 1 if found is None else found
    front: list[Floats] = []
    for value in values[:rest]:
        assert value is not None
        front.append(front[-1] + value if front else value)
    back: list[Floats] = []
    for value in values[:rest:-1]:
        assert value is not None
        back.append(back[-1] - value if back else 1.0 - value)
    yield from front
    yield from reversed(back)


def _rest(values: list[Floats | None]) -> int | None:
    """The material that takes the rest."""
    return next((m for m, value in enumerate(values) if value is None), None)


def open_fields(
    job: Job,
    placement: Placement,
    file_size_mm: Floats,
    load_part: Callable[[], Part] | None = None,
    grid: Grid | None = None,
) -> Painted:
    """Opens a job's fields over its part.

    Args:
        file_size_mm: (3,) bounding box size in the file's axes.
        load_part: reads the part, for fields that look at more than its box.
        grid: the printer's, for fields by body.

    Raises:
        JobError: a field file cannot be used.
    """
    priorities = {name: body.priority for name, body in (job.spec.bodies or {}).items() if body.priority}
    frame = Frame(placement.file_minimum_mm, file_size_mm, placement, load_part, grid, priorities)
    fields, pattern = job.spec.fields, job.spec.pattern
    return Painted(
        materials=job.materials,
        ratios=_open_shares(job, frame),
        orientation=_open_orientation(job, frame),
        isotropy=open_field(fields.isotropy, frame, job.inputs),
        period=open_field(pattern.period, frame, job.inputs),
        placement=placement,
        mid_height_mm=float(placement.size_mm[2]) / 2,
        dimensions=pattern.dimensions,
        blend=open_field(pattern.profile.blend.by, frame, job.inputs)
        if isinstance(pattern.profile, BlendShape)
        else None,
    )


def _open_shares(job: Job, frame: Frame) -> tuple[Sampler | None, ...]:
    ratio = job.spec.fields.ratio
    if isinstance(ratio, MaterialMap):
        return ratio.open_shares(frame, job.inputs, [(m.name, m.color) for m in job.spec.materials])
    shares = shares_by_material(ratio, job.materials)
    assert shares is not None  # the job file's validation saw to it
    return tuple(
        None if shares[name] == REST else open_field(shares[name], frame, job.inputs) for name in job.materials
    )


def _open_orientation(job: Job, frame: Frame) -> Orientation:
    spec = job.spec.fields.orientation
    if isinstance(spec, AzimuthElevation):
        for key, angle in (("azimuth", spec.azimuth), ("elevation", spec.elevation)):
            if isinstance(angle, Source):
                angle.check_angles(f"fields.orientation.{key}")
        return Angles(open_field(spec.azimuth, frame, job.inputs), open_field(spec.elevation, frame, job.inputs))
    if isinstance(spec, VectorComponents):
        x, y, z = (open_field(component, frame, job.inputs) for component in spec.vector)
        return Vector((x, y, z))
    return open_orientation(spec, frame, job.inputs)
