"""Surface relief: the pattern, or a field, moves the part's surface along its normal (Tricard et al. 2019, 4.2).

    displacement: {amplitude_mm: 0.4, profile: sawtooth, at: FIELD, both_ways: false, resolution_mm: 0.05}
    displacement: {amplitude_mm: 0.4, field: FIELD}

A vertex goes by amplitude · at · h, outwards; h is the waveform, from 0 to 1, of the pattern's phase there, or the
field; -½ to ½ with `both_ways`. Faces that meet at an edge both move by that much (amslicer/refine.py). An amplitude
below 0 engraves. `pwm` is 1 where the first material is. Of noises that are read by value, h is the waveform of the
value's rank, so that heights are spread as they are for a phase.

Triangles are refined first, so that no edge is longer than the resolution. Where a waveform jumps, the surface does so
within one edge: it is that steep, and the lowest and highest points of a sawtooth are missed by less than an edge's
share of the period. So its default is finer.

**Frames.** Painted fields, this one's and the materials', are read at the coordinates of the part's file: they do not
know of the relief. The box that the grid covers is that which the part fills where the relief has its full height
everywhere (with a `field`: the displaced part's own), so it follows from the part and `at` alone. The noise is
anchored to its lowest corner, and relief and materials are one pattern. on_bed puts that corner at z = 0. What this
section names in bed coordinates sees the part as it stands without a relief.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.arrows import refuse_lines
from amslicer.errors import JobError
from amslicer.fields import Frame, open_field
from amslicer.profiles import make_profile, profile_name
from amslicer.profiles.rank import RankProfile
from amslicer.profiles.waveforms import WAVES, BlendShape, SquareShape
from amslicer.refine import Surface, join_places, refine, ways_out
from amslicer.surface import connect

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.fields import FieldSpec
    from amslicer.fields.source import Part
    from amslicer.job import Job
    from amslicer.mesh import Mesh
    from amslicer.noise import Noise
    from amslicer.painted import Painted
    from amslicer.placement import Placement
    from amslicer.profiles.waveforms import Waveform
    from amslicer.specification import Displacement
    from amslicer.surface import Rim

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

KEY = "displacement"
# Edges to a period. The mean of a sine is then exact to 0.1 % and its crests to 3 %; a sawtooth loses one edge of its
# height, less than 3 %.
SMOOTH_EDGES, JUMPING_EDGES = 12, 36
LARGEST_SHARE = 0.5  # of the part's smallest side that the amplitude may be: beyond, opposite sides meet
LEAST_LEFT = 0.1  # of the part's volume, engraved all over: less is walls that are gone
MANY_VERTICES = 200_000  # take some seconds: someone may be waiting
PULSE = "pwm"
ROUNDING = 1e-9  # how far interpolation may leave 0…1
SAMPLES = 1 << 14  # of a waveform, for its range


@dataclass(frozen=True)
class Moved:
    """The surface with its relief.

    Attributes:
        surface: in the pattern frame, mm.
        rim: of an open mesh's holes; None of a closed one.
        resolution_mm: no edge was longer before it was moved.
        shell_mm3: between the surface where the pattern raises it nowhere and where it does so everywhere: there,
            shares of materials are not those painted, for one pattern decides both; None where a field gives heights.
    """

    surface: Surface
    rim: Rim | None
    resolution_mm: float
    volume_mm3: float
    shell_mm3: float | None

    def notes(self) -> list[str]:
        """How many triangles it took."""
        return [
            f"relief: the surface has {len(self.surface.triangles)} triangles, with edges of at most "
            f"{self.resolution_mm:.3g} mm"
        ]


@dataclass(frozen=True)
class Relief:
    """A part whose surface is about to be moved.

    Attributes:
        placement: of the part with its relief.
    """

    job: Job
    placement: Placement
    _surface: Surface
    _ways: Floats  # (V, 3) for a height of 1
    _places: tuple[Floats, Floats, Floats]  # of the vertices in the part's file, from its minimum: field frame
    _heights: Floats | None  # (V,) where a field gives them
    _blend: Floats | None  # (V,) of two waveforms
    _resolution_mm: float
    _is_open: bool
    _shell_mm3: float | None

    def moved(self, painted: Painted, noise: Noise) -> Moved:
        """The displaced surface.

        Raises:
            JobError: a painted field is not usable somewhere, or the profile is none for this pattern.
        """
        heights = self._heights
        count = len(self._surface.vertices)
        if count > MANY_VERTICES and heights is None:
            logging.getLogger(__name__).info("note: relief: the pattern is evaluated at %d vertices first …", count)
        if heights is None:
            heights = _raised(self._spec, self._of_pattern(painted, noise))
        vertices = self._surface.vertices + self._ways * heights[:, None]
        surface = Surface(vertices, self._surface.triangles)
        rim = connect(vertices, surface.triangles, np.zeros(3)).rim if self._is_open else None
        return Moved(surface, rim, self._resolution_mm, surface.volume_mm3, self._shell_mm3)

    @property
    def _spec(self) -> Displacement:
        assert self.job.spec.displacement is not None
        return self.job.spec.displacement

    def _of_pattern(self, painted: Painted, noise: Noise) -> Floats:
        """(V,) 0…1."""
        from amslicer.pointfield import field_at, turns_at

        profile = self._spec.waveform
        waves = _waves(profile)
        _refuse_arrows(profile, painted, noise)
        turns = turns_at(noise, field_at(self.job, painted, noise, self._surface.vertices))
        if profile == PULSE:
            return np.where(np.abs(turns - np.round(turns)) * 2 < self._first_share(painted), 1.0, 0.0)
        values = [_from_0_to_1(wave)(turns) for wave in waves]
        if self._blend is None:
            return np.asarray(values[0])
        return np.asarray(values[0] + self._blend * (values[1] - values[0]))

    def _first_share(self, painted: Painted) -> Floats:
        """(V,) painted share of the first material."""
        shares = [None if r is None else np.asarray(r.scalar(*self._places)) for r in painted.ratios]
        first = shares[0]
        return np.asarray(1 - sum(s for s in shares[1:] if s is not None) if first is None else first)


def plan_relief(
    job: Job, mesh: Mesh, placement: Placement, vertices: Floats, load_part: Callable[[], Part]
) -> Relief | None:
    """What a job's displacement will do to its part; None where there is none.

    Args:
        placement: of the part as it is.
        vertices: (V, 3) of the mesh, in the pattern frame.
        load_part: as of a Frame.

    Raises:
        JobError: a field of it cannot be used, it is larger than the part allows, or it takes too many triangles.
    """
    spec = job.spec.displacement
    if spec is None or spec.amplitude_mm == 0:
        return None
    _refuse_large(spec, float(mesh.size_mm.min()) * placement.scale)
    frame = Frame(placement.file_minimum_mm, mesh.size_mm, placement, load_part)
    resolution_mm = spec.resolution_mm or default_resolution_mm(job, frame)
    surface = refine(join_places(vertices, mesh.triangles, mesh.body), resolution_mm, f"{KEY}.resolution_mm")
    places = placement.to_field(*surface.vertices.T)
    x, y, z = np.broadcast_arrays(*places)
    places = (x, y, z)
    at = _unit_field(f"{KEY}.at", spec.at, frame, job, places)
    blend = None
    if spec.field is None and isinstance(spec.waveform, BlendShape):
        blend = _unit_field(f"{KEY}.profile.blend.by", spec.waveform.blend.by, frame, job, places)
    ways = ways_out(surface) * (spec.amplitude_mm * at)[:, None]
    heights = None if spec.field is None else _raised(spec, _unit_field(f"{KEY}.field", spec.field, frame, job, places))
    reached = [_raised(spec, np.full(len(at), end)) for end in (0.0, 1.0)] if heights is None else [heights]
    ends = [surface.vertices + ways * height[:, None] for height in reached]
    volumes = [Surface(end, surface.triangles).volume_mm3 for end in ends]
    _refuse_engraved_away(spec, min(volumes), surface.volume_mm3)
    shell_mm3 = abs(volumes[1] - volumes[0]) if heights is None else None
    low, high = (extreme([extreme(end, axis=0) for end in ends], axis=0) for extreme in (np.min, np.max))
    return Relief(
        job, _around(placement, low, high, on_bed=job.spec.part.on_bed),
        Surface(surface.vertices - low, surface.triangles), ways, places, heights, blend, resolution_mm,
        mesh.rim is not None, shell_mm3,
    )  # fmt: skip


def default_resolution_mm(job: Job, frame: Frame) -> float:
    """A share of the pattern's shortest period, but a pixel at least."""
    spec, pattern = job.spec.displacement, job.spec.pattern
    assert spec is not None
    shortest = open_field(pattern.period, frame, job.inputs).bounds[0]
    edges = JUMPING_EDGES if spec.field is None and jumps(spec.waveform) else SMOOTH_EDGES
    return max(min(job.spec.printer.pitch_mm), shortest / edges)


def jumps(profile: object) -> bool:
    """Whether a waveform does."""
    if isinstance(profile, BlendShape):
        return jumps(profile.blend.start) or jumps(profile.blend.end)
    return isinstance(profile, SquareShape) or profile in ("sawtooth", "square", PULSE)


def _around(placement: Placement, low: Floats, high: Floats, *, on_bed: bool) -> Placement:
    """The placement whose pattern frame begins at the lowest corner of another box, given in the old one's."""
    origin = placement.origin_mm + low
    lifted = placement.lifted_mm
    if on_bed:
        lifted, origin[2] = lifted - float(low[2]), 0.0
    return replace(placement, low_mm=placement.low_mm + low, size_mm=high - low, origin_mm=origin, lifted_mm=lifted)


def _raised(spec: Displacement, height: Floats) -> Floats:
    return height - 0.5 if spec.both_ways else height


def _waves(profile: object) -> tuple[Waveform, ...]:
    """The waveform, or the two of a blend; turned so that they are even where they can be, as a profile's."""
    if isinstance(profile, str):
        return (WAVES[profile],)
    made = make_profile(profile)  # type: ignore[arg-type]
    assert isinstance(made, RankProfile)
    return made.waves


def _from_0_to_1(wave: Waveform) -> Waveform:
    values = np.asarray(wave(np.arange(SAMPLES) / SAMPLES))
    low, high = float(values.min()), float(values.max())
    return lambda t: np.clip((np.asarray(wave(t)) - low) / (high - low), 0.0, 1.0)


def _refuse_arrows(profile: object, painted: Painted, noise: Noise) -> None:
    """A waveform that knows forth from back, where the pattern does not."""
    made, name = make_profile(profile), profile_name(profile)  # type: ignore[arg-type]
    if not made.arrows:
        return
    if noise.reads != "phase":
        raise JobError(
            f"{KEY}.profile: {name} needs a phase, but this noise is read by its values",
            hint="use profile: triangle, which is as high as the values' rank, or noise: phasor",
        )
    try:
        refuse_lines(painted, name)
    except JobError as error:
        said = error.message.replace("pattern.profile", f"{KEY}.profile").replace("the materials", "its flanks")
        raise JobError(said, hint=(error.hint or "").replace("symmetric", "triangle")) from None


def _refuse_large(spec: Displacement, smallest_mm: float) -> None:
    most = LARGEST_SHARE * smallest_mm
    if abs(spec.amplitude_mm) > most:
        raise JobError(
            f"{KEY}.amplitude_mm is {spec.amplitude_mm:g}, but the part's smallest side is {smallest_mm:.4g} mm; "
            f"its surface moves by half of that, {most:.4g} mm, at most",
            hint="use a smaller amplitude_mm, or check the part's units (--units)",
        )


def _refuse_engraved_away(spec: Displacement, left_mm3: float, plain_mm3: float) -> None:
    """Walls thinner than what is engraved on both sides turn inside out, and count as less than nothing."""
    if left_mm3 < LEAST_LEFT * plain_mm3:
        raise JobError(
            f"{KEY}.amplitude_mm is {spec.amplitude_mm:g}, which leaves {left_mm3:.3g} of the part's {plain_mm3:.4g} "
            "mm³: its walls are thinner than that",
            hint="use a smaller amplitude_mm, a positive one that adds ridges, or both_ways: true",
        )


def _unit_field(key: str, spec: FieldSpec, frame: Frame, job: Job, places: tuple[Floats, Floats, Floats]) -> Floats:
    """(V,) values of a field that is between 0 and 1."""
    values = np.broadcast_to(open_field(spec, frame, job.inputs).scalar(*places), places[0].shape)
    wrong = ~((values >= -ROUNDING) & (values <= 1 + ROUNDING))
    if wrong.any():
        i = int(np.argmax(wrong))
        where = ", ".join(
            f"{axis} = {float(c[i] + low):.2f}" for axis, c, low in zip("xyz", places, frame.minimum_mm, strict=True)
        )
        raise JobError(
            f"{key} is {values[i]:.4g} at {where} mm (file coordinates); it is between 0 and 1",
            hint="change the field's range (or from and to) so that it stays within 0 and 1, or clip() an expression",
        )
    return np.clip(values, 0.0, 1.0)
