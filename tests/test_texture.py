"""Texture of gratings whose direction and period are known, and what is said of blocks that are off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

from amslicer.grid import Grid
from amslicer.job import Job
from amslicer.judgement import direction_problems, isotropy_problems, period_problems, ratio_problems
from amslicer.painted import Painted
from amslicer.pipeline import prepare
from amslicer.profiles import PROFILES
from amslicer.texture import Shown, Texture
from amslicer.windows import Level, RatioWindows

PITCH_MM = 0.09
PRINTER = {"pitch_um": 90, "layer_um": 90}
# Narrow lines, as the gratings below have: the model is compared with what has no bandwidth at all.
NARROW = 1e-3


def prepared(folder: Path, size_mm: tuple[float, float, float], **changes: Any) -> tuple[Job, Painted, Grid]:
    job = parts.job(parts.box(folder, size_mm), printer=PRINTER, **changes)
    made = prepare(job)
    return job, made.painted, made.grid


def grating(grid: Grid, normal: np.ndarray[Any, Any], period_mm: float, share: float) -> np.ndarray[Any, Any]:
    """(layers, rows, columns) labels of plane sheets: material 1 within `share` of each period."""
    z = (np.arange(grid.layers) + 0.5)[:, None, None] * grid.layer_mm
    y, x = grid.y_mm()[None, :, None], grid.x_mm()[None, None, :]
    phase = (normal[0] * x + normal[1] * y + normal[2] * z) / period_mm % 1
    return np.where(phase < share, 1, 2).astype(np.uint8)


def texture(painted: Painted, grid: Grid, labels: np.ndarray[Any, Any]) -> list[Shown]:
    looked = Texture(painted, grid, NARROW, PROFILES["pwm"])
    assert looked.usable
    shown = [block for layer, plane in enumerate(labels) for block in looked.add(layer, looked.thin(plane))]
    return [*shown, *looked.finish()]


def unit(azimuth_deg: float, elevation_deg: float = 0.0) -> np.ndarray[Any, Any]:
    a, e = np.deg2rad((azimuth_deg, elevation_deg))
    return np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])


def degrees_between(a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]) -> float:
    return float(np.rad2deg(np.arccos(min(1.0, abs(float(a @ b))))))


@pytest.mark.parametrize("azimuth", [0.0, 17.0, 45.0, 90.0, 133.0])
@pytest.mark.parametrize("turned", [0.0, 8.0])
def test_a_flat_grating_shows_its_direction_and_period(tmp_path: Path, azimuth: float, turned: float) -> None:
    _, painted, grid = prepared(tmp_path, (28.0, 21.0, 0.27), orientation=azimuth, ratio=0.4)
    shown = texture(painted, grid, grating(grid, unit(azimuth + turned), 1.0, 0.4))
    assert len(shown) == 12
    for block in shown:
        assert degrees_between(block.normal, unit(azimuth + turned)) < 1
        assert block.turn_deg[2] == pytest.approx(turned, abs=1)
        assert block.frequency == pytest.approx(1, rel=0.01)


@pytest.mark.parametrize("longer", [0.9, 1.1])
def test_a_flat_grating_of_another_period(tmp_path: Path, longer: float) -> None:
    _, painted, grid = prepared(tmp_path, (28.0, 21.0, 0.27), orientation=30, ratio=0.4)
    for block in texture(painted, grid, grating(grid, unit(30), longer, 0.4)):
        assert block.frequency == pytest.approx(1 / longer, rel=0.01)


@pytest.mark.parametrize(("azimuth", "elevation"), [(20.0, 35.0), (-60.0, -20.0), (0.0, 80.0)])
def test_a_grating_in_space_shows_its_direction_and_period(tmp_path: Path, azimuth: float, elevation: float) -> None:
    orientation = {"azimuth": azimuth, "elevation": elevation}
    _, painted, grid = prepared(tmp_path, (14.0, 14.0, 7.0), orientation=orientation, ratio=0.4, dimensions=3)
    shown = texture(painted, grid, grating(grid, unit(azimuth, elevation), 1.0, 0.4))
    assert len(shown) == 4
    for block in shown:
        assert degrees_between(block.normal, unit(azimuth, elevation)) < 1
        assert block.frequency == pytest.approx(1, rel=0.01)


def test_blocks_lie_where_they_are(tmp_path: Path) -> None:
    """The right half of the labels is turned: the blocks there say so, the others do not."""
    _, painted, grid = prepared(tmp_path, (28.0, 14.0, 0.09), orientation=30, ratio=0.4)
    labels = grating(grid, unit(30), 1.0, 0.4)
    half = grid.columns // 2
    labels[..., half:] = grating(grid, unit(42), 1.0, 0.4)[..., half:]
    for block in texture(painted, grid, labels):
        assert block.turn_deg[2] == pytest.approx(12 if block.centre_mm[0] > 14 else 0, abs=1)


# --- windows -----------------------------------------------------------------------------------------------


def test_windows_count_what_plain_slices_do(tmp_path: Path) -> None:
    ratio = {"gradient": {"axis": "x", "from": 0.2, "to": 0.8}}
    _, painted, grid = prepared(tmp_path, (17.0, 9.0, 9.0), dimensions=3, ratio=ratio)
    random = np.random.default_rng(5)
    labels = random.integers(0, 3, (grid.layers, grid.rows, grid.columns)).astype(np.uint8)
    windows = RatioWindows(painted, grid)
    for layer, plane in enumerate(labels):
        windows.add(layer, *windows.count(plane, painted.ratio_map(grid, layer)))
    share = 0.2 + 0.6 * grid.x_mm() / 17.0
    levels = list(windows.levels(0.5, PROFILES["pwm"]))
    assert [level.counts for level in levels] == [(4, 2, 2), (2, 1, 1), (1, 1, 1)]
    for level in levels:
        assert len(level.got) == np.prod(level.counts)
        for low, high, got, asked in zip(level.low_mm, level.high_mm, level.got, level.asked, strict=True):
            (x0, y0, z0), (x1, y1, z1) = (np.rint(corner / PITCH_MM).astype(int) for corner in (low, high))
            cut = labels[z0:z1, y0:y1, x0:x1]
            solid = np.count_nonzero(cut)
            assert got == pytest.approx([np.count_nonzero(cut == m) / solid for m in (1, 2)])
            wanted = float(((cut > 0) * share[x0:x1]).sum()) / solid
            assert asked == pytest.approx([wanted, 1 - wanted], abs=1e-6)


# --- sentences ---------------------------------------------------------------------------------------------


def block(
    place: int = 0, *, turn: float = 0.0, frequency: float = 1.005, along: float = 0.8, isotropy: float = 0.0
) -> Shown:
    """A block that shows what is painted, but for what a test says."""
    return Shown(
        centre_mm=np.array([float(place), 0.0, 0.0]), normal=unit(turn), expected_normal=unit(0),
        turn_deg=np.array([0.0, 0.0, turn]), frequency=frequency, along=along, expected_along=0.8, isotropy=isotropy,
    )  # fmt: skip


def test_blocks_as_painted_have_no_problem() -> None:
    shown = [block(i) for i in range(32)]
    assert [*direction_problems(shown), *period_problems(shown, 3), *isotropy_problems(shown)] == []


def test_few_blocks_say_nothing() -> None:
    assert list(direction_problems([block(i, turn=30) for i in range(3)])) == []


def test_sentences_say_what_and_how_much() -> None:
    turned = list(direction_problems([block(i, turn=9.0) for i in range(5)]))
    assert turned[0].startswith("the part: sheets are turned by 9.0° on average, mostly about z")
    longer = list(period_problems([block(i, frequency=1 / 1.25 + 0.005) for i in range(5)], 3))
    assert longer[0].startswith("the part: the period is 1.250 times the painted one")
    rounder = list(isotropy_problems([block(i, along=0.5) for i in range(5)]))
    assert "50 % of the spectrum's power lies along the painted normal instead of 80 %" in rounder[0]
    assert rounder[0].endswith("sheets are more isotropic than the painted 0.00")


def test_the_half_that_is_turned_is_named() -> None:
    shown = [block(i, turn=9.0 if i >= 16 else 0.0) for i in range(32)]
    said = list(direction_problems(shown))
    assert any(line.startswith("the upper half along x") for line in said)
    assert not any(line.startswith("the lower half along x") for line in said)


def test_few_blocks_that_agree_by_chance_are_not_sure_of_it() -> None:
    """Honest plates have halves of five blocks that are all a tenth off; fifteen of them are too many."""
    shown = [block(i, frequency=0.905) for i in range(5)]
    assert list(period_problems(shown, 2)) == []
    assert len(list(period_problems(shown * 3, 2))) == 1


def test_where_directions_are_spread_a_turn_means_nothing() -> None:
    assert list(direction_problems([block(i, turn=20, isotropy=0.9) for i in range(8)])) == []


def test_a_window_is_named_with_its_place() -> None:
    def array(*rows: tuple[float, ...]) -> np.ndarray[Any, Any]:
        return np.array(rows)

    level = Level(
        low_mm=array((0, 0, 0), (4, 0, 0)), high_mm=array((4, 4, 1), (8, 4, 1)), got=array((0.3, 0.7), (0.35, 0.65)),
        asked=array((0.3, 0.7), (0.3, 0.7)), sigma=array((0.01, 0.01), (0.01, 0.01)),
        limit=array((0.04, 0.06), (0.04, 0.06)), place=np.array([(0, 0, 0), (1, 0, 0)]), counts=(2, 1, 1),
    )  # fmt: skip
    assert list(ratio_problems([level], ("a", "b"), np.array([10.0, 0.0, 0.0]))) == [
        "a: 0.3500 instead of 0.3000 (error +0.0500, allowed ± 0.0400) in x 14.0 to 18.0, y 0.0 to 4.0, z 0.0 to 1.0 mm"
    ]
    np.testing.assert_allclose(level.z, [(0, 0), (5, -5)], atol=1e-9)
