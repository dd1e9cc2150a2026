"""A picture of a job before it is sliced: its painted fields beside the laminate of three layers.

Everything is what slicing would make, at fewer pixels: the same job with a coarser printer of the same aspect. The
noise is anchored in mm, so the sheets lie where they will be printed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.mask import Runs, Slicer
from amslicer.notes import sheet_bounds
from amslicer.pipeline import Prepared, Run, make_layers, prepare, workers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.grid import Grid
    from amslicer.job import Job
    from amslicer.layer import Layer

    Floats = NDArray[np.float64]

# A picture's largest side and area, in its finest pixels: two of them beside each other fit on a screen.
SIDE_PX, AREA_PX = 1000, 700 * 700
PERIOD_PX = 8  # pixels per period: coarser ones turn sheets into dots
HEIGHTS = (0.25, 0.5, 0.75)  # of the part's height: where the layers are
OUTLINE_LAYERS = 32  # evenly spaced layers that make the outline of the part seen from above


@dataclass(frozen=True)
class Window:
    """Half-open pixel columns and rows (row 0 = lowest y)."""

    columns: tuple[int, int]
    rows: tuple[int, int]


@dataclass(frozen=True)
class View:
    """A job at the pixels of a picture.

    Attributes:
        window: the pixels that are shown.
        whole: whether they are all there are.
    """

    prepared: Prepared
    window: Window
    whole: bool

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and depth of what is shown."""
        px, py = self.prepared.grid.pitch_mm
        (left, right), (low, high) = self.window.columns, self.window.rows
        return (right - left) * px, (high - low) * py

    def crop(self, picture: NDArray[np.generic]) -> NDArray[np.generic]:
        """The window of (rows, columns, …) pixels, row 0 = lowest y."""
        return picture[slice(*self.window.rows), slice(*self.window.columns)]


@dataclass(frozen=True)
class WindowSlicer(Slicer):
    """Slices what lies in a window and nothing else."""

    window: Window = field(kw_only=True)

    def runs(self, first: int, end: int) -> Runs:
        """As Slicer's, cut off at the window."""
        runs = super().runs(first, end)
        start, stop = (np.clip(ends, *self.window.columns) for ends in (runs.start, runs.stop))
        row, (low, high) = runs.row % self.grid.rows, self.window.rows
        kept = (row >= low) & (row < high) & (start < stop)
        return replace(runs, row=runs.row[kept], start=start[kept], stop=stop[kept])


def overview(job: Job, prepared: Prepared) -> View:
    """The whole part at the pixels of a picture, be they too coarse for the laminate."""
    return view_at(job, _pixel_mm(prepared), whole=True)


def close_up(job: Job, prepared: Prepared) -> View:
    """The whole part, or as much of its middle as a picture holds at PERIOD_PX pixels per period."""
    pitch, fitting_mm = job.spec.printer.pitch_mm, _pixel_mm(prepared)
    coarsest_mm = sheet_bounds(prepared)[0] / PERIOD_PX * min(pitch) / max(pitch)
    whole = max(coarsest_mm, min(pitch)) >= fitting_mm
    return view_at(job, min(coarsest_mm, fitting_mm), whole=whole)


def _pixel_mm(prepared: Prepared) -> float:
    """The finer side of the pixels with which the whole part fills a picture."""
    width, depth = (float(v) for v in prepared.placement.size_mm[:2])
    return max(width / SIDE_PX, depth / SIDE_PX, math.sqrt(width * depth / AREA_PX))


def view_at(job: Job, pixel_mm: float, *, whole: bool) -> View:
    """The job at pixels of this (finer) side, or at the printer's if those are larger.

    Args:
        whole: show all of it, or only what a picture holds.
    """
    printer = job.spec.printer
    times = max(1.0, pixel_mm / min(printer.pitch_mm))
    pitch_um = tuple(1000 * times * side for side in printer.pitch_mm)
    changed = printer.model_copy(update={"dpi": None, "pitch_um": pitch_um, "margin_px": 0})
    prepared = prepare(replace(job, spec=job.spec.model_copy(update={"printer": changed})))
    grid, slicer = prepared.grid, prepared.slicer
    if whole:
        return View(prepared, Window((0, grid.columns), (0, grid.rows)), whole)
    window = _middle(grid)
    cut = WindowSlicer(slicer.corners, slicer.first_layer, slicer.end_layer, slicer.grid, slicer.holes, window=window)
    return View(replace(prepared, slicer=cut), window, whole)


def _middle(grid: Grid) -> Window:
    """As much of the middle of the grid as a picture holds."""
    finer = [pitch / min(grid.pitch_mm) for pitch in grid.pitch_mm]  # finest pixels per column and per row
    counts = grid.columns, grid.rows
    short = min(math.sqrt(AREA_PX), *(count * share for count, share in zip(counts, finer, strict=True)))
    most = min(SIDE_PX, AREA_PX / short)
    shown = [min(count, int(most / share)) for count, share in zip(counts, finer, strict=True)]
    first = [(count - n) // 2 for count, n in zip(counts, shown, strict=True)]
    return Window((first[0], first[0] + shown[0]), (first[1], first[1] + shown[1]))


def laminate(view: View, run: Run) -> Iterator[Layer]:
    """Layers at evenly spaced heights, cut to the window; their `labels` have row 0 = largest y."""
    from amslicer.device import Device

    prepared = view.prepared
    count = prepared.grid.layers
    with Device(run.device, run.jobs) as device, workers(run.threads) as pool:
        pattern = prepared.pattern(device)
        for index in sorted({int(share * count) for share in HEIGHTS}):
            for batch in make_layers(prepared, pattern, pool, range(index, index + 1), run.threads):
                for made in batch:
                    layer = made.bitmaps.layer()
                    labels = view.crop(layer.labels[::-1])[::-1]
                    yield replace(layer, labels=np.asarray(labels, np.uint8))


def outline(view: View) -> NDArray[np.bool_]:
    """(rows, columns) where the part is, seen from above, in the window; row 0 = lowest y."""
    grid = view.prepared.grid
    seen = np.zeros((grid.rows, grid.columns), bool)
    for index in {round(place) for place in np.linspace(0, grid.layers - 1, min(OUTLINE_LAYERS, grid.layers))}:
        seen |= view.prepared.slicer.runs(index, index + 1).solid()[0]
    return np.asarray(view.crop(seen), bool)


@dataclass(frozen=True)
class Maps:
    """Painted fields at mid-height, per pixel of the whole grid; row 0 = lowest y.

    Attributes:
        ratio: share of the first material.
        normals: (rows, columns, 3) in printer axes; 0 outside the part.
        others: further fields that are not the same everywhere, by name; 0 outside the part.
    """

    z_mm: float
    ratio: NDArray[np.float32]
    normals: Floats
    others: dict[str, Floats]


def painted_maps(prepared: Prepared, inside: NDArray[np.bool_]) -> Maps:
    """The painted fields of a job.

    Args:
        inside: (rows, columns) where they are wanted.

    Raises:
        JobError: the painted ratio leaves 0…1.
    """
    grid, painted = prepared.grid, prepared.painted
    middle = grid.layers // 2
    row, column = np.nonzero(inside)
    points = np.column_stack([grid.x_mm()[column], grid.y_mm()[row], np.full(len(row), grid.z_mm(middle))])
    normals = np.zeros((*inside.shape, 3))
    normals[inside] = painted.normals(points)
    ratios = painted.asked_map(grid, middle)
    others: dict[str, Floats] = {}
    for m, name in enumerate(painted.materials[1:-1], 1):
        others[f"ratio of {name}"] = np.where(inside, ratios[m] - ratios[m - 1], 0.0)
    for name, sampler, values in (
        ("isotropy", painted.isotropy, painted.isotropies),
        ("period in mm", painted.period, painted.periods),
    ):
        if any(sampler.varies):
            others[name] = np.zeros(inside.shape)
            others[name][inside] = values(points)
    z_mm = float(prepared.placement.origin_mm[2]) + grid.z_mm(middle)
    return Maps(z_mm, ratios[0], normals, others)
