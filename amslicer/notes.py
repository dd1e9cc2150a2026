"""What a person should know about a job before it is printed, in sentences. None of it stops the run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.profiles import make_profile

if TYPE_CHECKING:
    from amslicer.pipeline import Prepared
    from amslicer.specification import JobFile

# Foretold errors are noted from here on: of 627 random gratings that err by more than 1 % the least foretold is 0.84 %.
LOCKED_SHARE = 0.008
STRAIGHT_DEG = 1.0  # sheets that turn by more are rounded differently from place to place
LOCKING_PERIODS = 8.0  # parts of fewer sheets are further off by chance, and by how their sides cut the sheets
LOCKING_STEP_PERIODS = 4.0  # between places where the direction is read
COARSE_PX = 64  # pixels per side that stand for the part's mean ratio
NOTED_MM = 5e-4  # moves that would be shown as 0.000 mm are float noise
MIN_PERIOD_PX = 3  # below, pixels do not show where one sheet ends

Bounds = tuple[float, float]


def notes_of(prepared: Prepared) -> list[str]:
    """All notes about a job that is ready to be sliced."""
    spec, grid = prepared.job.spec, prepared.grid
    printer, solid = spec.printer, spec.pattern.dimensions == 3
    name = printer.name or "the printer"
    period_mm, shares = sheet_bounds(prepared)
    pitch_mm = max(*grid.pitch_mm, *((grid.layer_mm,) if solid else ()))
    feature = printer.feature_mm
    return [
        *prepared.mesh.notes,
        *bed_notes(prepared.placement.lifted_mm),
        *(prepared.slicer.holes.notes(float(prepared.placement.origin_mm[2])) if prepared.slicer.holes else ()),
        *size_notes(prepared.placement.size_mm.tolist(), printer.bed_mm, name, spec.part.rotate),
        *layer_notes(grid.layers, printer.min_layers, name),
        *pixel_notes(period_mm, shares, pitch_mm),
        *feature_notes(period_mm, shares, feature and max(feature[: 3 if solid else 2]), name),
        *locking_notes(prepared),
        *format_notes(spec),
    ]


def sheet_bounds(prepared: Prepared) -> tuple[float, list[Bounds]]:
    """The least mm from sheet to sheet of a material, and the smallest and largest painted share of each material."""
    humps = make_profile(prepared.job.spec.pattern.profile).humps
    return prepared.painted.period_bounds_mm[0] / humps, prepared.painted.share_bounds()


def bed_notes(lifted_mm: float) -> Iterator[str]:
    """How far the part was moved to stand on the bed."""
    if abs(lifted_mm) >= NOTED_MM:
        was, moved = ("above", "down") if lifted_mm < 0 else ("below", "up")
        yield f"the part was {abs(lifted_mm):.3f} mm {was} the bed: moved {moved} to z = 0"


def size_notes(
    size_mm: Sequence[float], bed_mm: Sequence[float] | None, printer: str, rotate_deg: Sequence[float]
) -> Iterator[str]:
    """Whether the part fits on the printer.

    Args:
        rotate_deg: the job's `part.rotate`, to say how to turn the part where that helps.
    """
    if bed_mm is None or _fits(size_mm, bed_mm):
        return
    x, y, z = size_mm
    turn = ""
    if _fits((y, x, z), bed_mm):
        about = ", ".join(f"{angle:g}" for angle in (*rotate_deg[:2], rotate_deg[2] + 90))
        turn = f": turned by 90° about z it would fit (part.rotate: [{about}])"
    measures, bed = (" × ".join(f"{v:.5g}" for v in side) for side in (size_mm, bed_mm))
    yield f"the part measures {measures} mm, more than {printer} prints ({bed} mm){turn}"


def _fits(size_mm: Sequence[float], bed_mm: Sequence[float]) -> bool:
    return all(size <= bed + NOTED_MM for size, bed in zip(size_mm, bed_mm, strict=True))


def layer_notes(layers: int, least: int | None, printer: str) -> Iterator[str]:
    """Whether the printer's software takes so few layers."""
    if least is not None and layers < least:
        yield f"the part makes {layers} layers, fewer than the {least} that {printer} takes: print it thicker"


def pixel_notes(period_mm: float, shares: Sequence[Bounds], pitch_mm: float) -> Iterator[str]:
    """Whether pixels and layers show the sheets.

    Args:
        pitch_mm: the coarsest of pixel and layer.
    """
    if period_mm < MIN_PERIOD_PX * pitch_mm:
        yield (
            f"the period of {period_mm:g} mm is {period_mm / pitch_mm:.1f} pixels or layers of "
            f"{1000 * pitch_mm:.0f} µm: sheets are lost below {MIN_PERIOD_PX}"
        )
        return
    thinnest_mm = _thinnest(shares) * period_mm
    if thinnest_mm < pitch_mm:
        yield (
            f"the thinnest sheets are {1000 * thinnest_mm:.0f} µm, less than a pixel or layer of "
            f"{1000 * pitch_mm:.0f} µm: the ratio will not be exact there"
        )


def feature_notes(period_mm: float, shares: Sequence[Bounds], feature_mm: float | None, printer: str) -> Iterator[str]:
    """Whether the printer makes sheets so thin: the share of a material times the period is a sheet's thickness."""
    if feature_mm is None:
        return
    least = f"{1000 * feature_mm:g} µm, the smallest feature of {printer}"
    thinnest = _thinnest(shares)
    if thinnest * period_mm < feature_mm:
        yield (
            f"the thinnest sheets are {1000 * thinnest * period_mm:.0f} µm ({100 * thinnest:.3g} % of a period of "
            f"{period_mm:g} mm), thinner than {least}: they may tear or blur"
        )
    elif any(low <= 0 < high for low, high in shares):
        yield (
            f"sheets thin out to nothing where a share nears 0: below {100 * feature_mm / period_mm:.3g} % of a period "
            f"of {period_mm:g} mm they are thinner than {least}"
        )


def locking_notes(prepared: Prepared) -> Iterator[str]:
    """Whether sheets are in step with the pixels, so that all of them are rounded alike.

    A direction or a period that changes through the part, and any isotropy, take sheets out of step.
    """
    from amslicer.arrows import sample_places
    from amslicer.locking import locking_error
    from amslicer.noise import NOISES
    from amslicer.pattern import job_lobes

    spec, grid, painted = prepared.job.spec, prepared.grid, prepared.painted
    shortest, longest = painted.period_bounds_mm
    if NOISES[spec.pattern.noise].read_by(spec.pattern) != "phase":
        return  # whose sheets wander too much
    if spec.pattern.edges == "dithered" or not painted.is_laminate or shortest < longest:
        return
    normals = painted.normals(sample_places(painted, LOCKING_STEP_PERIODS * shortest).reshape(-1, 3))
    if np.abs(normals @ normals[0]).min() < math.cos(math.radians(STRAIGHT_DEG)):
        return
    lobes = job_lobes(prepared.job, painted)
    directions = normals[:1] if lobes is None else lobes.all_directions(normals[:1])[0]
    axes = painted.dimensions
    pitch = np.array([*grid.pitch_mm, grid.layer_mm])[:axes]
    size = painted.placement.size_mm
    coarse = replace(
        grid, columns=COARSE_PX, rows=COARSE_PX, layers=1, margin_px=0, layer_mm=float(size[2]),
        pitch_mm=(float(size[0]) / COARSE_PX, float(size[1]) / COARSE_PX),
    )  # fmt: skip
    ratios = painted.ratio_map(coarse, 0).mean(axis=(1, 2))
    worst: tuple[float, int, Any] = (LOCKED_SHARE, 0, None)
    for normal in directions[:, :axes]:
        if float(np.abs(normal) @ size[:axes]) < LOCKING_PERIODS * shortest:
            continue
        errors = locking_error(
            ratios, profile=make_profile(spec.pattern.profile), cycles_per_pixel=normal * pitch / shortest,
            extents_px=np.array([grid.columns, grid.rows, grid.layers])[:axes],
            width_per_pixel=spec.pattern.bandwidth * pitch / shortest, aligned=spec.pattern.alignment > 0,
        )  # fmt: skip
        material = int(np.argmax(errors))
        worst = max(worst, (float(errors[material]), material, normal), key=lambda found: found[0])
    error, material, normal = worst
    if normal is not None:
        along = int(np.argmax(np.abs(normal) / pitch))
        pixels = shortest / abs(float(normal[along])) / pitch[along]
        yield (
            f"the ratio of {painted.materials[material]} may be off by up to {100 * error:.1f} %: straight sheets "
            f"{pixels:.2f} {('pixels along x', 'pixels along y', 'layers')[along]} apart are in step with the grid and "
            "all rounded alike; set pattern.edges to dithered, change the period a little, or turn the part"
        )


def _thinnest(shares: Sequence[Bounds]) -> float:
    """The smallest share that makes sheets: 0 and 1 everywhere are plain fills. Infinite where there are none."""
    return min((low for low, _ in shares if 0 < low < 1), default=math.inf)


def format_notes(spec: JobFile) -> Iterator[str]:
    """Whether the stack is written as the printer's software takes it."""
    from amslicer.writers import WRITERS

    wanted = spec.printer.format
    if wanted is not None and wanted not in WRITERS and "format" not in spec.output.model_fields_set:
        yield (
            f"{spec.printer.name or 'the printer'} takes {wanted} files, which this version does not write yet: "
            f"the stack is written as {spec.output.format}"
        )
