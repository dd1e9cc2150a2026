"""What people put into their own test suites, `amslicer.testing`, and the maps that show where a stack is off."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import forgery
import numpy as np
import parts
import pytest

import amslicer
from amslicer.errormaps import PANEL_PX, error_maps
from amslicer.pictures import GAP, TEXT_HEIGHT
from amslicer.testing import assert_ratios

SIZE_MM = (32.0, 32.0, 0.4)
PRINTER = {"pitch_um": 120, "layer_um": 400}


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("honest")
    job = parts.job(parts.box(folder, SIZE_MM), ratio=0.4, orientation=25, printer=PRINTER)
    amslicer.slice_job(job, folder / "out")
    return folder / "out"


def less_in_the_upper_left_quarter(out: Path) -> None:
    """A fifth of the first material's pixels there become the second's; the first rows of a bitmap are the upper."""

    def change(labels: forgery.Labels) -> forgery.Labels:
        labels = labels.copy()
        quarter = labels[: labels.shape[0] // 2, : labels.shape[1] // 2]
        quarter[(quarter == 1) & (np.arange(quarter.size).reshape(quarter.shape) % 5 == 0)] = 2
        return labels

    forgery.forge(out, change)


@pytest.fixture
def locally_wrong(honest: Path, tmp_path: Path) -> Path:
    out = shutil.copytree(honest, tmp_path / "out")
    less_in_the_upper_left_quarter(out)
    return out


def test_the_documented_example(tmp_path: Path) -> None:
    (tmp_path / "fields.yaml").write_text(
        json.dumps({"printer": PRINTER, "materials": ["rigid", "flexible"], "pattern": {"dimensions": 2},
                    "fields": {"ratio": 0.4, "orientation": 25}})
    )  # fmt: skip
    job = amslicer.load_job(tmp_path / "fields.yaml", part=parts.box(tmp_path, (20.0, 20.0, 0.4)))
    amslicer.slice_job(job, tmp_path / "out")
    assert_ratios(amslicer.open_stack(tmp_path / "out"), tolerance=0.01)


def test_an_honest_stack_passes_by_every_measure(honest: Path) -> None:
    assert_ratios(honest)
    assert_ratios(str(honest), tolerance=0.01, expected={"rigid": 0.4})
    assert_ratios(amslicer.open_stack(honest), expected={"rigid": 0.4, "flexible": 0.6})


def test_a_tolerance_that_is_too_small(honest: Path) -> None:
    with pytest.raises(AssertionError, match=r"rigid: 0\.\d{4} instead of 0\.4000"):
        assert_ratios(honest, tolerance=1e-6)


def test_another_ratio_than_expected(honest: Path) -> None:
    with pytest.raises(AssertionError, match=r"flexible: 0\.\d{4} instead of 0\.5000 \(error \+0\.0"):
        assert_ratios(honest, expected={"flexible": 0.5})


def test_a_stack_that_is_wrong_in_a_quarter(locally_wrong: Path) -> None:
    with pytest.raises(AssertionError, match=r"rigid: .* in x 0\.0 to 16\.\d, y 16\.\d to 32\.0"):
        assert_ratios(locally_wrong, tolerance=0.05)
    assert_ratios(locally_wrong, tolerance=0.05, windows=False)


def test_a_material_that_is_not_there(honest: Path) -> None:
    with pytest.raises(amslicer.UsageError, match="no material 'soft'") as caught:
        assert_ratios(honest, expected={"soft": 0.5})
    assert "rigid, flexible" in (caught.value.hint or "")


def quarters(panel: np.ndarray[Any, Any]) -> dict[tuple[str, str], np.ndarray[Any, Any]]:
    """Mean colours of a map's quarters."""
    rows, columns = (n // 2 for n in panel.shape[:2])
    vertical, horizontal = (
        {"upper": slice(0, rows), "lower": slice(rows, None)},
        {"left": slice(0, columns), "right": slice(columns, None)},
    )
    return {
        (v, h): panel[vs, hs].reshape(-1, 3).mean(axis=0) for v, vs in vertical.items() for h, hs in horizontal.items()
    }


def test_a_wrong_quarter_is_blue_where_it_is(locally_wrong: Path) -> None:
    """Too little rigid is blue, too much flexible red; the other quarters are neither."""
    picture = np.asarray(error_maps(amslicer.verify(locally_wrong), amslicer.open_stack(locally_wrong).grid), float)
    top = GAP + TEXT_HEIGHT
    for panel, sign in ((0, -1), (1, 1)):
        left = GAP + panel * (PANEL_PX + GAP)
        for place, (red, _, blue) in quarters(picture[top : top + PANEL_PX, left : left + PANEL_PX]).items():
            if place == ("upper", "left"):
                assert sign * (red - blue) > 60, place
            else:
                assert abs(red - blue) < 40, place
