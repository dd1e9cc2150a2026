"""The lattice: its taps against least squares in float64, its kernel against NumPy, its labels against every pixel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer import Run
from amslicer.device import Device
from amslicer.evaluator import Evaluator
from amslicer.grid import Grid
from amslicer.lattice import ERROR, NODES, Lattice, Taps, choose_lattice
from amslicer.noise.bands import Band
from amslicer.pattern import Pattern
from amslicer.pipeline import prepare
from amslicer.reference import phasor
from amslicer.tiles import Tiling

Floats = NDArray[np.float64]
FINE = {"dpi": 600, "layer_um": 27}
OBLONG = {"dpi": [600, 300], "layer_um": 27}
CHANGED = 5e-4  # of the solid pixels
DIRECTION = {"gradient": {"axis": "x", "from": 0, "to": 90}}
PAIR = {"azimuth": DIRECTION, "elevation": {"gradient": {"axis": "y", "from": -20, "to": 50}}}
PAINTED = {"gradient": {"axis": "y", "from": 0.1, "to": 0.6}}
CASES: dict[str, dict[str, Any]] = {
    "2D": {"orientation": 27.0},
    "2D, along x": {"orientation": 0.0},
    "2D, turning": {"orientation": DIRECTION, "ratio": PAINTED},
    "2D, bandwidth 0.25": {"orientation": DIRECTION, "bandwidth": 0.25},
    "2D, bandwidth 1": {"orientation": DIRECTION, "bandwidth": 1.0},
    "2D, period from 1 to 3": {"orientation": 40.0, "period": {"gradient": {"axis": "x", "from": 1, "to": 3}}},
    "2D, isotropic": {"orientation": 40.0, "isotropy": {"gradient": {"axis": "x", "from": 0, "to": 1}}},
    "2D, dithered": {"orientation": 12.0, "edges": "dithered"},
    "2D, 600 × 300 dpi": {"orientation": 63.0, "printer": OBLONG},
    "3D": {"orientation": PAIR, "ratio": PAINTED, "dimensions": 3},
    "3D, along z": {"orientation": {"azimuth": 0, "elevation": 90}, "dimensions": 3},
    "3D, bandwidth 1": {"orientation": PAIR, "dimensions": 3, "bandwidth": 1.0},
    "3D, 600 × 300 dpi": {"orientation": PAIR, "dimensions": 3, "printer": OBLONG},
    "3D, 300 dpi": {"orientation": PAIR, "dimensions": 3, "printer": {"dpi": 300, "layer_um": 27}},
    "3D, ratio changes with z": {
        "orientation": PAIR, "dimensions": 3, "ratio": {"gradient": {"axis": "z", "from": 0.2, "to": 0.7}},
    },
    "3D, three materials, cyclic": {
        "orientation": PAIR, "dimensions": 3, "profile": "cyclic", "materials": ("a", "b", "c"),
        "ratio": {"a": PAINTED, "b": 0.2, "c": "rest"},
    },
}  # fmt: skip


def make(folder: Path, case: dict[str, Any], evaluate: str) -> amslicer.Job:
    size = (21.0, 17.0, 2.6) if case.get("dimensions") == 3 else (32.0, 26.0, 0.02)
    return parts.job(parts.box(folder, size), **{"printer": FINE, "ratio": 0.3, **case}, evaluate=evaluate)


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_few_pixels_differ_from_evaluating_every_one(tmp_path: Path, case: dict[str, Any]) -> None:
    """At most 0.05 % of the solid pixels, and none in the mask. A block is left and entered on the way."""
    job = make(tmp_path, case, "lattice")
    ready = prepare(job)
    assert ready.lattice is not None
    first = min(ready.tiling.layers, ready.grid.layers) - 1
    got, exact = (
        parts.labels(some, first, min(first + 3, ready.grid.layers)) for some in (job, make(tmp_path, case, "exact"))
    )
    np.testing.assert_array_equal(got > 0, exact > 0)
    changed = np.count_nonzero(got != exact) / np.count_nonzero(exact)
    nodes = " × ".join(str(n.count) for n in ready.tiling.nodes)
    print(f"{ready.tiling.pixels} pixels, {ready.tiling.layers} layers, {nodes} nodes: {100 * changed:.4f} % differ")
    # Painted directions and isotropy are read at the tiles' middles to choose signs, and tiles differ.
    assert changed <= CHANGED


@pytest.mark.parametrize("case", ["3D", "2D, turning", "3D, ratio changes with z"])
def test_cuts_change_no_byte(tmp_path: Path, case: str) -> None:
    """Layers alone, in pairs across a border of blocks, and with another number of threads."""
    job = make(tmp_path, CASES[case], "lattice")
    border, end = prepare(job).tiling.layers, prepare(job).grid.layers
    whole = parts.labels(job)
    for first, stop in {(0, 1), (border - 1, min(border + 1, end)), (end // 2, end), (end - 1, end)}:
        if first < stop <= end:
            np.testing.assert_array_equal(parts.labels(job, first, stop), whole[first:stop])
    single = np.stack([layer.labels for layer in amslicer.layers(job, Run(jobs=1))])
    np.testing.assert_array_equal(single, whole)


def test_a_block_that_does_not_fit_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bytes when only three layers are labelled at a time."""
    job = make(tmp_path, CASES["3D"], "lattice")
    whole = parts.labels(job)
    grid = prepare(job).grid
    monkeypatch.setattr("amslicer.pipeline.BATCH_BYTES", 3 * 2 * grid.columns * grid.rows)
    np.testing.assert_array_equal(parts.labels(job), whole)


RAMP = {"expression": "clip((x - 8) / 4, 0, 1)"}
SQUARE = {"expression": "where(abs(y - 8) < 4, 1, 0)"}
PLAIN: dict[str, dict[str, Any]] = {
    "ramp": {"ratio": RAMP}, "square": {"ratio": SQUARE}, "nothing": {"ratio": 0}, "all": {"ratio": 1},
    "three": {"ratio": {"a": RAMP, "b": 0, "c": "rest"}, "materials": ("a", "b", "c")},
}  # fmt: skip


@pytest.mark.parametrize("evaluate", ["lattice", "exact"])
@pytest.mark.parametrize("case", PLAIN.values(), ids=list(PLAIN))
def test_tiles_of_one_material_need_no_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: dict[str, Any], evaluate: str
) -> None:
    """Fewer tiles are evaluated, and no byte changes."""
    settings = {"printer": FINE, "dimensions": 3, "orientation": 30, "evaluate": evaluate, **case}
    job = parts.job(parts.box(tmp_path, (20.0, 16.0, 0.5)), **settings)
    counts: list[int] = []
    evaluator = Pattern.evaluator

    def counting(self: Pattern, tiling: Tiling, block: int, tiles: NDArray[np.int32]) -> Evaluator:
        counts.append(len(tiles))
        return evaluator(self, tiling, block, tiles)

    monkeypatch.setattr(Pattern, "evaluator", counting)
    some, of_some = parts.labels(job), max(counts)
    counts.clear()
    monkeypatch.setattr(Pattern, "may_be_plain", False)
    np.testing.assert_array_equal(some, parts.labels(job))
    assert of_some < 0.75 * max(counts)


@pytest.mark.parametrize("evaluate", ["lattice", "exact"])
@pytest.mark.parametrize("edges", ["sharp", "dithered"])
def test_a_flat_pattern_is_labelled_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edges: str, evaluate: str
) -> None:
    """What layers show of it is what each would be by itself."""
    settings = {
        "printer": {"dpi": 600, "layer_um": 400},
        "orientation": 30,
        "edges": edges,
        "evaluate": evaluate,
        "ratio": PAINTED,
    }
    job = parts.job(parts.stl(tmp_path, meshes.sphere(8.0)), **settings)
    once = parts.labels(job)
    assert len({layer.tobytes() for layer in once}) >= 20
    monkeypatch.setattr(Pattern, "same_in_all_layers", False)
    np.testing.assert_array_equal(once, parts.labels(job))


def chosen(bandwidth: float, periods: tuple[float, float] = (1.0, 1.0), **grid: Any) -> Lattice:
    settings = {"columns": 900, "rows": 700, "layers": 400, "pitch_mm": (0.0423, 0.0423), "layer_mm": 0.027, **grid}
    lattice = choose_lattice(Grid(**settings), Band(periods, bandwidth), periods[0], tile_periods=1.5, planar=False)
    assert lattice is not None
    return lattice


@pytest.mark.parametrize("bandwidth", [0.1, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_taps_give_waves_of_the_noise(bandwidth: float, axis: int) -> None:
    """Gabor kernels along the axis, of the finest period: rms error over centres and phases, in float64."""
    lattice = chosen(bandwidth)
    nodes, taps = lattice.tiling.nodes[axis], lattice.taps[axis]
    pixels = len(taps.first)
    at = (np.arange(pixels) + 0.5) * nodes.side_mm / pixels
    places = nodes.start_mm + nodes.step_mm * np.arange(nodes.count)
    centres = np.linspace(-3 / bandwidth, 3 / bandwidth + nodes.side_mm, 4001)[:, None]

    def kernels(x: Floats) -> NDArray[np.complex128]:
        return np.exp(-np.pi * (bandwidth * (x - centres)) ** 2 + 2j * np.pi * (x - centres))

    values = kernels(places)
    got = np.zeros((len(centres), pixels), np.complex128)
    for k in range(taps.count):
        got += taps.weights[:, k] * values[:, taps.first + k]
    expected = kernels(at)
    error = np.sqrt(np.sum(np.abs(got - expected) ** 2, axis=0) / np.sum(np.abs(expected) ** 2, axis=0))
    print(f"bandwidth {bandwidth}, axis {axis}: {pixels} from {nodes.count}, worst error {error.max():.1e}")
    assert error.max() <= 1.05 * ERROR


def test_taps_of_vectors_are_the_same() -> None:
    for taps in (*chosen(0.5).taps[:2], Taps(np.arange(NODES, dtype=np.int32), np.ones((NODES, 1), np.float32))):
        for width in (8, 16):
            grouped = taps.by_vector(width)
            dense = np.zeros((len(taps.first), NODES))
            again = np.zeros_like(dense)
            for pixel, first in enumerate(taps.first):
                dense[pixel, first : first + taps.count] = taps.weights[pixel]
                vector, lane = divmod(pixel, width)
                start = grouped.first[vector]
                assert 0 <= start <= NODES - grouped.count
                again[pixel, start : start + grouped.count] = grouped.weights[vector, :, lane]
            np.testing.assert_array_equal(again, dense)


def test_a_lattice_is_never_finer_than_pixels_nor_larger_than_the_period_allows() -> None:
    for period in (0.4, 0.7, 1.0, 2.0, 5.0, 20.0):
        for bandwidth in (0.1, 0.5, 1.0, 2.0):
            for pitch in ((0.0423, 0.0423), (0.0423, 0.0847), (0.01, 0.03)):
                grid = Grid(900, 700, 400, pitch, 0.027)
                lattice = choose_lattice(
                    grid, Band((period, 2 * period), bandwidth), period, tile_periods=1.5, planar=False
                )
                if lattice is None:
                    continue
                for nodes, step in zip(lattice.tiling.nodes, (*pitch, 0.027), strict=True):
                    assert nodes.step_mm >= step
                    assert nodes.side_mm <= 1.5 * period + 1e-9
                    assert nodes.start_mm <= step / 2 + 1e-9
                    assert nodes.end_mm >= nodes.side_mm - step / 2 - 1e-9


def test_coarse_pixels_are_evaluated_one_by_one() -> None:
    for planar in (False, True):
        assert (
            choose_lattice(
                Grid(90, 70, 40, (0.25, 0.25), 0.3), Band((1.0, 1.0), 0.5), 1.0, tile_periods=1.5, planar=planar
            )
            is None
        )


def test_a_large_part_has_flat_blocks() -> None:
    """G of a layer of tiles is bounded: by flatter blocks, and where the flattest are too large, by no lattice."""
    bed = {"columns": 9450, "rows": 7090}
    small, large = chosen(0.5), chosen(0.5, **bed)
    assert large.tiling.layers < small.tiling.layers
    for lattice, columns, rows in ((small, 900, 700), (large, 9450, 7090)):
        tiles = np.prod(lattice.tiling.over(Grid(columns, rows, 400, (0.0423, 0.0423), 0.027)))
        slab = int(tiles) * NODES**2 * 8 * lattice.tiling.nodes[2].count
        assert slab <= max(192 << 20, 16 * columns * rows)
    fine = {"layers": 400, "pitch_mm": (0.03, 0.03), "layer_mm": 0.027}
    for columns, chooses in ((900, True), (9450, False)):
        grid = Grid(columns, columns, **fine)
        lattice = choose_lattice(grid, Band((0.5, 0.5), 0.5), 0.5, tile_periods=1.5, planar=False)
        assert (lattice is not None) == chooses
    assert chosen(0.5, rows=100_000).tiling.layers <= (1 << 20) // 100_000  # whose runs are kept


def test_against_the_twin(tmp_path: Path, device: Device) -> None:
    """Labels of a small block against float64 kernels summed at every pixel."""
    case = {"orientation": {"azimuth": 30, "elevation": 20}, "dimensions": 3, "seed": 5}
    job = parts.job(parts.box(tmp_path, (6.0, 5.0, 0.8)), printer=FINE, ratio=0.3, **case)
    ready = prepare(job)
    assert ready.lattice is not None
    grid, layer = ready.grid, 11
    x, y = grid.x_mm()[None, :], grid.y_mm()[:, None]
    normal = np.array([np.cos(np.pi / 9) * np.cos(np.pi / 6), np.cos(np.pi / 9) * 0.5, np.sin(np.pi / 9)])
    g = phasor(
        x, y, grid.z_mm(layer), period=lambda p: np.ones(len(p)), bandwidth=0.5, dimensions=3, seed=5,
        normal=lambda p: np.broadcast_to(normal, p.shape), impulses=4.0, isotropy=lambda p: np.zeros(len(p)),
        periods=(1.0, 1.0),
    )  # fmt: skip
    expected = np.where(np.cos(np.angle(g)) > np.cos(0.3 * np.pi), 1, 2)
    got = parts.labels(job, layer, layer + 1)[0][::-1]
    changed = np.mean(got[got > 0] != expected[got > 0])
    print(f"{100 * changed:.4f} % differ from the twin")
    assert changed <= CHANGED
