"""Skins of one material: as thick as asked for, to a pixel, on every side; the pattern is inside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from scipy import ndimage

import amslicer
from amslicer.errors import JobError
from amslicer.grid import Grid, cover
from amslicer.mask import make_slicer
from amslicer.skin import Skin

PRINTER = {"pitch_um": [50, 80], "layer_um": 60}
MATERIALS = ("soft", "hard")


def skin_of(solid: meshes.Solid, thickness: float, top: float, bottom: float) -> tuple[Any, Any, Grid]:
    """(layers, rows, columns) what is solid and what is skin of a mesh in its own corner."""
    vertices, faces = solid
    vertices = vertices - vertices.min(axis=0)
    grid = cover(np.ptp(vertices, axis=0).tolist(), (0.05, 0.08), 0.06)
    inside = make_slicer(vertices, np.asarray(faces, np.int64), grid).runs(0, grid.layers).solid()
    skin = Skin(lambda layer: inside[layer], grid, thickness, top, bottom)
    return inside, np.stack([skin.of_layer(layer) for layer in range(grid.layers)]), grid


@pytest.mark.parametrize("thickness", [0.2, 0.7, 1.5])
def test_the_skin_of_a_ball_is_as_thick_everywhere(thickness: float) -> None:
    """No pixel is on the wrong side by more than its own size (0.08 mm, the longest side); 0.01: of the facets."""
    inside, skin, grid = skin_of(meshes.sphere(4.0, 5), thickness, thickness, thickness)
    z, y, x = np.meshgrid([grid.z_mm(i) for i in range(grid.layers)], grid.y_mm(), grid.x_mm(), indexing="ij")
    depth = 4.0 - np.sqrt((x - 4) ** 2 + (y - 4) ** 2 + (z - 4) ** 2)
    wrong = inside & (skin != (depth < thickness))
    worst = float(np.abs(depth[wrong] - thickness).max(initial=0))
    print(f"skin of {thickness} mm: wrong by {worst:.3f} mm at most")
    assert 0 < worst <= 0.08 + 0.01
    assert not (skin & ~inside).any()


def test_it_is_that_of_a_distance_transform() -> None:
    """Brute force: a pixel is skin if the near face of one outside is within the thickness."""
    rng = np.random.default_rng(5)
    solid = ndimage.binary_opening(ndimage.gaussian_filter(rng.normal(size=(20, 24, 30)), 2) > -0.05, iterations=1)
    grid = Grid(30, 24, 20, (0.05, 0.08), 0.06)
    skin = Skin(lambda layer: solid[layer], grid, 0.21, 0.33, 0.12)
    outside = np.argwhere(~np.pad(solid, 6)) - 6
    found = np.stack([skin.of_layer(layer) for layer in range(20)])
    for place in np.argwhere(solid)[::7]:
        step = outside - place
        gap = np.maximum(np.abs(step) - 0.5, 0) * (0.06, 0.08, 0.05)
        height = np.where(step[:, 0] > 0, 0.33, 0.12)
        distance = (gap[:, 1] ** 2 + gap[:, 2] ** 2) / 0.21**2 + gap[:, 0] ** 2 / height**2
        if abs(distance.min() - 1) > 1.5 / 120:  # three squares are rounded to 120ths
            assert found[tuple(place)] == (distance.min() < 1), place


def test_tops_and_bottoms_have_their_own_thickness() -> None:
    """A box of whole pixels: 0.5 mm are 10 columns, 0.48 mm 6 rows, 0.36 mm 6 layers at the top, none below."""
    inside, skin, _ = skin_of(meshes.box((4.0, 4.0, 3.0)), 0.5, 0.36, 0.0)
    assert inside.all()
    core = np.argwhere(~skin)
    low, high = core.min(axis=0), np.array(skin.shape) - 1 - core.max(axis=0)
    assert (~skin[low[0] : -high[0], low[1] : -high[1], low[2] : -high[2]]).all()
    assert low.tolist() == [0, 6, 10]
    assert high.tolist() == [6, 6, 10]


def test_in_any_order_and_part_of_the_layers(tmp_path: Path) -> None:
    job = parts.job(
        parts.box(tmp_path, (5.0, 4.0, 3.0)), printer=PRINTER, materials=MATERIALS, dimensions=3, period=0.8,
        sections={"skin": {"material": "hard", "thickness_mm": 0.4}},
    )  # fmt: skip
    whole = parts.labels(job)
    assert np.array_equal(parts.labels(job, 20, 31), whole[20:31])
    assert np.array_equal(
        np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1, layers=(7, 9)))]), whole[7:9]
    )
    without = parts.labels(parts.job(tmp_path / "part.stl", printer=PRINTER, dimensions=3, period=0.8))
    core = (slice(7, -7), slice(5, -5), slice(8, -8))
    assert np.array_equal(whole[core], without[core])  # the pattern is that of the part without a skin
    assert (whole[0] == 2).all()
    assert (whole[:, 0] == 2).all()


def test_a_skin_thinner_than_half_a_pixel_is_one_pixel() -> None:
    _, skin, _ = skin_of(meshes.box((1.0, 0.8, 0.6)), 0.01, 0.01, 0.0)
    core = np.argwhere(~skin)
    assert core.min(axis=0).tolist() == [0, 1, 1]
    assert (np.array(skin.shape) - 1 - core.max(axis=0)).tolist() == [1, 1, 1]


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_stack_with_a_skin_is_verified(tmp_path: Path, dimensions: int) -> None:
    job = parts.job(
        parts.stl(tmp_path, meshes.sphere(4.0, 4)), printer=PRINTER, materials=MATERIALS, period=0.8, ratio=0.4,
        dimensions=dimensions, sections={"skin": {"material": "hard", "thickness_mm": 0.3, "top_mm": 0.6}},
    )  # fmt: skip
    result = amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, [check for check in report.checks if not check.ok]
    share = report.materials["soft"].expected
    volume = 4.0**3
    assert 0.4 * (3.4 / 4) ** 3 < share < 0.4 * 3.7**3 / volume  # a ball that loses 0.3 to 0.6 mm
    assert result.materials[0].asked == pytest.approx(share, abs=1e-9)
    # A skin of the wrong thickness is found.
    text = (tmp_path / "out" / "job.yaml").read_text()
    (tmp_path / "other.yaml").write_text(text.replace("thickness_mm: 0.3", "thickness_mm: 0.8"))
    other = amslicer.verify(tmp_path / "out", fields=tmp_path / "other.yaml")
    assert not other.ok


@pytest.mark.parametrize(
    ("skin", "message"),
    [
        ({"material": "har", "thickness_mm": 0.4}, "no material 'har'"),
        ({"material": "hard", "thickness_mm": 0}, "greater than 0"),
        ({"material": "hard"}, "'skin.thickness_mm' is missing"),
        ({"material": "hard", "thickness_mm": 0.4, "top_mm": -1}, "greater than or equal to 0"),
        ({"material": "void", "thickness_mm": 0.4}, "no material 'void'"),
    ],
)
def test_refused(tmp_path: Path, skin: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message):
        parts.job(parts.box(tmp_path, (3.0, 3.0, 1.0)), materials=MATERIALS, sections={"skin": skin})
