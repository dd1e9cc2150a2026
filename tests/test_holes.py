"""Open meshes: which rows pass through holes, what is left of the part, and what is said about it."""

from __future__ import annotations

import json
from pathlib import Path

import meshes
import numpy as np
import parts
import pytest
from meshes import Solid

import amslicer
from amslicer.errors import PartError
from amslicer.grid import Grid, cover
from amslicer.holes import Holes, OpenRows, find_holes
from amslicer.mask import Runs, make_slicer
from amslicer.mesh import read_mesh
from amslicer.pipeline import prepare

SOLIDS = ["box", "sphere", "torus", "nested_shells", "twisted_star", "random_boolean_1"]


def without(solid: Solid, *triangles: int) -> Solid:
    return solid[0], np.delete(solid[1], triangles, axis=0)


def opened(folder: Path, solid: Solid, grid: Grid) -> tuple[Runs, Holes]:
    """The runs of all layers of an open mesh, and its holes."""
    path = folder / "open.ply"
    path.write_bytes(meshes.ply(solid))
    mesh = read_mesh(path, allow_open=True)
    holes = find_holes(mesh.rim, mesh.vertices, grid)
    assert holes
    return make_slicer(mesh.vertices, mesh.triangles, grid, holes).runs(0, grid.layers), holes


def test_rows_beside_a_hole_are_whole_and_rows_through_it_empty(tmp_path: Path) -> None:
    """Half of the side x = 0 is missing: layer l has the hole y < 0.8 (l + ½), which 0, 1, 2, 3, 4 rows enter."""
    runs, holes = opened(tmp_path, without(meshes.box(), 0), Grid(3, 4, 5, (1.0, 1.0), 1.0))
    solid = runs.solid()
    for layer, through in enumerate((0, 1, 2, 3, 4)):
        assert not solid[layer, :through].any()
        assert solid[layer, through:].all()
    assert holes.count() == OpenRows(rows=10, layers=4, first_layer=1, last_layer=4)


def test_holes_that_cancel_each_other_are_seen(tmp_path: Path) -> None:
    """Both ends of a box are missing: every row has no crossing at all, or two where a second box stands behind."""
    first, second = meshes.box((3.0, 4.0, 5.0)), meshes.box((3.0, 4.0, 5.0), (5.0, 0.0, 0.0))
    pipe = meshes.joined(without(first, 0, 1, 2, 3), second)
    runs, holes = opened(tmp_path, pipe, Grid(8, 4, 5, (1.0, 1.0), 1.0))
    assert not runs.pixels.any()
    found = holes.count()
    assert found
    assert (found.rows, found.layers) == (20, 5)
    # The exit of the first box and the entry of the second: a row would be solid from 0 to 8 and return to 0.
    gap = meshes.joined(without(first, 2, 3), without(second, 0, 1))
    runs, holes = opened(tmp_path, gap, Grid(8, 4, 5, (1.0, 1.0), 1.0))
    assert not runs.pixels.any()
    assert len(np.unique(holes.hole)) == 2


def test_a_missing_lid_leaves_everything(tmp_path: Path) -> None:
    lid = [t for t, corners in enumerate(meshes.box()[0][meshes.box()[1]]) if (corners[:, 2] == 5).all()]
    runs, holes = opened(tmp_path, without(meshes.box(), *lid), Grid(3, 4, 5, (1.0, 1.0), 1.0))
    assert runs.solid().all()
    assert holes.count() is None
    assert "no pixel row passes through" in next(holes.notes(0.0))


@pytest.mark.parametrize("name", SOLIDS)
def test_no_row_is_wrong_and_no_other_is_lost(tmp_path: Path, name: str) -> None:
    """Against the closed mesh: a row is as it was, or passes through the missing triangles and is empty."""
    solid = dict(meshes.GENERATED)[name]()
    random = np.random.default_rng(5)
    for number in (1, 2, 5):
        missing = random.choice(len(solid[1]), number, replace=False)
        path = tmp_path / "whole.ply"
        path.write_bytes(meshes.ply(solid))
        mesh = read_mesh(path)
        grid = cover(mesh.size_mm, (0.13, 0.11), 0.17)
        whole = make_slicer(mesh.vertices, mesh.triangles, grid).runs(0, grid.layers).solid()
        holed, holes = opened(tmp_path, without(solid, *missing), grid)
        begin, stop = holes.spans(0, grid.layers)
        through = np.zeros(grid.layers * grid.rows, bool)
        for a, b in zip(begin, stop, strict=True):
            through[a:b] = True
        through = through.reshape(grid.layers, grid.rows)
        found = holed.solid()
        np.testing.assert_array_equal(found[~through], whole[~through])
        assert not found[through].any()
        # Rows that miss every missing triangle's box are not lost.
        corners = mesh.vertices[mesh.triangles[missing]]
        z, y = (np.arange(grid.layers) + 0.5) * grid.layer_mm, grid.y_mm()
        near = np.zeros_like(through)
        for c in corners:
            (_, y0, z0), (_, y1, z1) = c.min(axis=0), c.max(axis=0)
            near |= ((z >= z0) & (z <= z1))[:, None] & ((y >= y0) & (y <= y1))[None, :]
        assert not (through & ~near).any()


def test_layer_ranges_have_the_same_spans(tmp_path: Path) -> None:
    _, holes = opened(tmp_path, without(meshes.sphere(), 3, 40, 41, 700), cover((6.0, 6.0, 6.0), (0.1, 0.1), 0.1))
    begin, stop = holes.spans(0, 60)
    pieces = [holes.spans(first, first + 7) for first in range(0, 60, 7)]
    rows = holes.grid.rows
    joined = [np.concatenate([p[i] + 7 * n * rows for n, p in enumerate(pieces)]) for i in (0, 1)]
    np.testing.assert_array_equal(joined, [begin, stop])
    assert len(begin)


def test_the_volume_closes_a_flat_hole(tmp_path: Path) -> None:
    """A box without one side has the box's volume, wherever the side is; inside out it is turned over."""
    for side in range(6):
        for turned in (False, True):
            solid = without(meshes.box(at=(7.0, -3.0, 2.0)), 2 * side, 2 * side + 1)
            path = tmp_path / "open.ply"
            path.write_bytes(meshes.ply(meshes.turned(solid) if turned else solid))
            mesh = read_mesh(path, allow_open=True)
            assert mesh.volume_mm3 == pytest.approx(60)
            assert mesh.turned == turned
            assert mesh.rim


def test_what_no_open_mesh_may_be(tmp_path: Path) -> None:
    """A sheet has no inside; a face that looks the wrong way is no hole."""
    turned_face = meshes.box()[1].copy()
    turned_face[4] = turned_face[4, ::-1]
    sheet = meshes.box()[0], meshes.box()[1][:2]
    for solid, said in ((sheet, "no volume"), ((meshes.box()[0], turned_face), "partly inside out")):
        path = tmp_path / "open.ply"
        path.write_bytes(meshes.ply(solid))
        with pytest.raises(PartError, match=said):
            read_mesh(path, allow_open=True)


def test_closed_meshes_are_the_same_with_it(tmp_path: Path) -> None:
    part = parts.box(tmp_path, (4.0, 3.0, 0.5))
    stacks = [parts.labels(parts.job(part, settings={"allow_open": allowed})) for allowed in (False, True)]
    np.testing.assert_array_equal(*stacks)
    assert prepare(parts.job(part, settings={"allow_open": True})).slicer.holes is None


def test_the_stack_says_what_is_missing(tmp_path: Path) -> None:
    part = tmp_path / "part.ply"
    part.write_bytes(meshes.ply(without(meshes.box(), 0)))
    job = parts.job(part, printer={"pitch_um": 1000, "layer_um": 1000}, settings={"allow_open": True}, period=4)
    result = amslicer.slice_job(job, tmp_path / "out")
    (note,) = [note for note in result.notes if "open" in note]
    assert "3 open edges around 1 hole)" in note
    assert "10 pixel rows of 4 layers, between z = 1.500 and 4.500 mm" in note
    assert result.solid_pixels == 3 * (5 * 4 - 10)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["part"]["open"] == {"open_edges": 3, "empty_rows": 10, "layers": 4, "z_mm": [1.5, 4.5]}
    refused = parts.job(part, printer={"pitch_um": 1000, "layer_um": 1000})
    with pytest.raises(PartError, match="the mesh is open: 3 open edges") as caught:
        prepare(refused)
    assert "--allow-open" in str(caught.value.hint)
