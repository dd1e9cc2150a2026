"""`amslicer preview` of a part: what its picture shows is what slicing makes, at fewer pixels and in true aspect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from PIL import Image

import amslicer
from amslicer import Job, JobError, Run, analysis, cli
from amslicer.fieldpictures import RAMP, STROKE_STEP_PX, direction_picture, draw_strokes, hue_colors, ramp_colors
from amslicer.partpreview import (
    AREA_PX,
    PERIOD_PX,
    SIDE_PX,
    View,
    close_up,
    laminate,
    outline,
    overview,
    painted_maps,
    view_at,
)
from amslicer.partsheet import _field_panels, heading, part_sheet
from amslicer.pictures import BACKGROUND, GAP, TEXT_HEIGHT
from amslicer.pipeline import prepare

FINE = {"pitch_um": 50, "layer_um": 50}
OBLONG = {"pitch_um": [40, 80], "layer_um": 50}


def box_job(folder: Path, size_mm: tuple[float, float, float], printer: Any = FINE, **settings: Any) -> Job:
    return parts.job(parts.box(folder, size_mm), printer=printer, **settings)


def close_view(job: Job) -> View:
    return close_up(job, prepare(job))


# Which pixels


@pytest.mark.parametrize(
    ("size_mm", "printer", "pitch_mm"),
    [
        ((20, 10), FINE, (0.05, 0.05)),  # the printer's own: 400 × 200 pixels fit
        ((70, 70), FINE, (0.1, 0.1)),  # 700 × 700
        ((95, 10), FINE, (0.095, 0.095)),  # 1000 pixels long
        ((10, 95), FINE, (0.095, 0.095)),
        ((56, 56), OBLONG, (0.08, 0.16)),  # 700 of the finer pixels
    ],
)
def test_the_whole_part_fills_the_picture_in_the_printers_aspect(
    tmp_path: Path, size_mm: tuple[float, float], printer: Any, pitch_mm: tuple[float, float]
) -> None:
    view = close_view(box_job(tmp_path, (*size_mm, 0.2), printer, period=1.5))
    assert view.whole
    assert view.prepared.grid.pitch_mm == pytest.approx(pitch_mm)
    assert view.size_mm == pytest.approx(size_mm, abs=max(pitch_mm))
    assert view.prepared.grid.layer_mm == 0.05


@pytest.mark.parametrize("printer", [FINE, OBLONG])
def test_a_part_too_large_for_its_period_is_shown_in_a_window(tmp_path: Path, printer: dict[str, Any]) -> None:
    job = box_job(tmp_path, (200, 120, 0.2), printer, period=0.8)
    view = close_view(job)
    assert not view.whole
    pitch = view.prepared.grid.pitch_mm
    assert max(pitch) == pytest.approx(0.8 / PERIOD_PX)
    assert pitch[1] / pitch[0] == pytest.approx(2 if printer is OBLONG else 1)
    width, depth = (side / min(pitch) for side in view.size_mm)
    assert max(width, depth) <= SIDE_PX
    assert AREA_PX * 0.98 <= width * depth <= AREA_PX
    for (first, end), count in zip(
        (view.window.columns, view.window.rows), (view.prepared.grid.columns, view.prepared.grid.rows), strict=True
    ):
        assert abs(first - (count - end)) <= 1  # in the middle


def test_a_printer_too_coarse_for_the_period_is_not_made_finer(tmp_path: Path) -> None:
    view = close_view(box_job(tmp_path, (120, 100, 0.2), period=0.2))
    assert view.prepared.grid.pitch_mm == (0.05, 0.05)
    assert not view.whole


def test_the_overview_is_whole_however_fine_the_period(tmp_path: Path) -> None:
    job = box_job(tmp_path, (200, 120, 0.2), period=0.8)
    view = overview(job, prepare(job))
    assert view.whole
    assert view.prepared.grid.columns * view.prepared.grid.rows <= AREA_PX * 1.01


# What is in them


def labels_of(view: View) -> dict[int, NDArray[np.uint8]]:
    return {layer.index: layer.labels for layer in laminate(view, Run())}


def test_layers_of_a_small_part_are_those_of_its_stack(tmp_path: Path) -> None:
    job = box_job(tmp_path, (8, 6, 1), dimensions=3, ratio=0.3, orientation=20)
    shown = labels_of(close_view(job))
    assert list(shown) == [5, 10, 15]  # of 20 layers, at a quarter, a half and three quarters
    for index, labels in shown.items():
        assert np.array_equal(labels, parts.labels(job, index, index + 1)[0])


@pytest.mark.parametrize("dimensions", [2, 3])
def test_coarser_pixels_see_the_same_sheets(tmp_path: Path, dimensions: int) -> None:
    """Pixels three times as large have their centres on those of every third pixel of the printer."""
    job = box_job(tmp_path, (9, 6, 0.4), dimensions=dimensions, ratio=0.4, orientation=30)
    (layer, *_) = laminate(view_at(job, 0.15, whole=True), Run())
    (printed,) = parts.labels(job, layer.index, layer.index + 1)
    assert layer.labels.shape == (40, 60)
    assert np.mean(layer.labels == printed[1::3, 1::3]) > 0.999
    assert np.mean(layer.labels == printed[::3, ::3]) < 0.999  # one pixel beside: other sheets' edges


def test_a_window_shows_what_lies_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = box_job(tmp_path, (20, 12, 0.2), ratio=0.4, orientation=30, printer=FINE)
    whole = labels_of(view_at(job, 0.05, whole=True))
    monkeypatch.setattr("amslicer.partpreview.SIDE_PX", 100)
    monkeypatch.setattr("amslicer.partpreview.AREA_PX", 100 * 100)
    view = view_at(job, 0.05, whole=False)
    assert (view.window.columns, view.window.rows) == ((150, 250), (70, 170))
    shown = labels_of(view)
    assert list(shown) == list(whole)
    for index, labels in shown.items():
        assert np.array_equal(labels, whole[index][70:170, 150:250])  # 240 rows: 70 from below is 70 from above
        assert labels.all()


def test_the_period_is_the_painted_one(tmp_path: Path) -> None:
    job = box_job(tmp_path, (70, 70, 0.05), period=2.0, orientation=30, bandwidth=0.25)
    view = close_view(job)
    (labels,) = labels_of(view).values()
    measured = analysis.measured_period(analysis.signed(labels), view.prepared.grid.pitch_mm, 2.0)
    assert measured == pytest.approx(2.0, rel=0.04)


def test_the_outline_is_the_part_from_above(tmp_path: Path) -> None:
    """Two boxes that no layer has both of."""
    solid = meshes.joined(meshes.box((2, 2, 1)), meshes.box((2, 2, 1), (4, 0, 2)))
    part = parts.stl(tmp_path, solid)
    view = close_view(parts.job(part, printer={"pitch_um": 100, "layer_um": 100}))
    seen = outline(view)
    assert seen.shape == (20, 60)
    assert np.array_equal(seen, np.broadcast_to((np.arange(60) < 20) | (np.arange(60) >= 40), seen.shape))


def test_painted_maps(tmp_path: Path) -> None:
    job = box_job(
        tmp_path, (10, 4, 2), {"pitch_um": [100, 200], "layer_um": 100}, dimensions=3,
        ratio={"gradient": {"axis": "x", "from": 0.2, "to": 0.8}},
        orientation={"azimuth": 30, "elevation": {"gradient": {"axis": "y", "from": 0, "to": 40}}},
    )  # fmt: skip
    prepared = prepare(job)
    maps = painted_maps(prepared, np.ones((20, 100), bool))
    x, y = (np.arange(100) + 0.5) * 0.1, (np.arange(20) + 0.5) * 0.2
    assert maps.ratio == pytest.approx(np.broadcast_to(0.2 + 0.6 * x / 10, (20, 100)), abs=1e-6)
    expected = analysis.normal(30.0, 40 * y / 4)
    assert maps.normals == pytest.approx(np.broadcast_to(expected[:, None], (20, 100, 3)), abs=1e-9)
    assert maps.z_mm == pytest.approx(1.05)
    assert maps.others == {}


def test_painted_maps_of_other_fields_that_vary(tmp_path: Path) -> None:
    from amslicer.fields import SOURCES

    job = box_job(tmp_path, (10, 4, 2), {"pitch_um": 200, "layer_um": 100})
    gradient = SOURCES["gradient"].model_validate({"gradient": {"axis": "x", "from": 0.0, "to": 1.0}})
    fields = job.spec.fields.model_copy(update={"isotropy": gradient})
    painted = prepare(replace(job, spec=job.spec.model_copy(update={"fields": fields})))
    inside = np.ones((20, 50), bool)
    inside[:, 0] = False
    maps = painted_maps(painted, inside)
    assert list(maps.others) == ["isotropy"]
    expected = np.where(np.arange(50) > 0, (np.arange(50) + 0.5) / 50, 0.0)
    assert maps.others["isotropy"] == pytest.approx(np.broadcast_to(expected, (20, 50)))
    view = close_up(painted.job, painted)
    captions = [panel.caption for panel in _field_panels(view, view)]
    assert [caption.split(" at ")[0] for caption in captions] == ["ratio of rigid", "normal", "isotropy"]


def test_a_ratio_beyond_1_is_refused(tmp_path: Path) -> None:
    job = box_job(tmp_path, (4, 4, 1), ratio={"gradient": {"axis": "x", "from": 0.5, "to": 1.5}})
    with pytest.raises(JobError, match="a ratio is between 0 and 1"):
        part_sheet(prepare(job), Run())


# Colours and strokes


def test_the_ramp_goes_from_light_to_dark() -> None:
    colors = ramp_colors(np.linspace(0, 1, 101)).astype(float)
    assert np.array_equal(colors[[0, 25, 50, 75, 100]], RAMP)
    assert np.all(np.diff(colors @ (0.299, 0.587, 0.114)) < 0)
    assert np.array_equal(ramp_colors(np.array([-1.0, 2.0])), RAMP[[0, -1]])


def test_hues_are_those_of_lines() -> None:
    hues = hue_colors(np.array([-90.0, 90.0, 0.0, 180.0, 45.0]), np.ones(5)).astype(int)
    assert np.array_equal(hues[0], hues[1])
    assert np.array_equal(hues[2], hues[3])
    for a, b in ((0, 2), (0, 4), (2, 4)):
        assert np.abs(hues[a] - hues[b]).max() > 60
    assert np.array_equal(hue_colors(np.array([45.0]), np.zeros(1))[0], (255, 255, 255))  # sheets that lie flat


@pytest.mark.parametrize(
    ("normal", "along"),
    [((1, 0, 0), (0, 1)), ((0, 1, 0), (1, 0)), ((0.6, 0.8, 0), (0.8, -0.6)), ((0.6, -0.8, 0), (0.8, 0.6))],
)
def test_strokes_run_along_the_sheets(normal: tuple[float, ...], along: tuple[float, float]) -> None:
    """The dark pixels' main axis, in x right and y up, is across the normal."""
    side = STROKE_STEP_PX
    normals, inside = np.broadcast_to(np.array(normal, float), (side, side, 3)), np.ones((side, side), bool)
    picture = Image.new("RGB", (side, side), BACKGROUND)
    draw_strokes(picture, normals, inside)
    row, column = np.nonzero(np.asarray(picture).sum(axis=2) < 600)
    points = np.column_stack([column, -row]) - np.column_stack([column, -row]).mean(axis=0)
    main = np.linalg.svd(points)[2][0]
    assert abs(main @ along) > 0.98


def test_directions_are_drawn_with_the_largest_y_on_top() -> None:
    normals = np.zeros((2, 1, 3))
    normals[0], normals[1] = (1, 0, 0), (0, 1, 0)
    picture = np.asarray(direction_picture(normals, np.array([[True], [False]])))
    assert np.array_equal(picture[1, 0], hue_colors(np.array(0.0), np.array(1.0)))
    assert tuple(picture[0, 0]) == BACKGROUND


# The sheet


def colors_in(picture: Image.Image) -> set[tuple[int, ...]]:
    return {tuple(color) for color in np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0).tolist()}


def test_the_heading_says_when_only_a_window_is_shown(tmp_path: Path) -> None:
    job = box_job(tmp_path, (200, 120, 0.2), period=0.8)
    prepared = prepare(job)
    lines = heading(prepared, close_up(job, prepared))
    assert "part.stl: 200 x 120 x 0.2 mm" in lines[0]
    assert "period 0.8 mm" in lines[0]
    assert "100 x 100 um; the printer's are 50 x 50 um" in lines[1]
    assert "WINDOW of 70 x 70 mm" in lines[2]
    assert "2000 x 1200 pixels" in lines[2]
    small = box_job(tmp_path, (20, 12, 0.2))
    assert len(heading(prepare(small), close_view(small))) == 2


@pytest.mark.parametrize(("size_mm", "rows", "panel_px"), [((24, 8, 1), 3, 160), ((8, 24, 1), 2, 480)])
def test_long_parts_are_stacked_and_deep_ones_set_side_by_side(
    tmp_path: Path, size_mm: tuple[float, float, float], rows: int, panel_px: int
) -> None:
    """Fields in one column and layers in the other, or fields in one row and layers in the other."""
    sheet = part_sheet(prepare(box_job(tmp_path, size_mm)), Run())
    text_px = sheet.height - rows * (panel_px + TEXT_HEIGHT + GAP) - 2 * GAP
    assert text_px % TEXT_HEIGHT == 0
    assert 3 <= text_px // TEXT_HEIGHT <= 5


def test_pixels_that_are_not_square_are_drawn_in_true_aspect(tmp_path: Path) -> None:
    """A plate of one material, twice as wide as deep, under pixels that are twice as deep as wide."""
    sheet = part_sheet(prepare(box_job(tmp_path, (8, 4, 0.05), OBLONG, ratio=1)), Run())
    blue = np.all(np.asarray(sheet) == (0x2B, 0x6C, 0xB0), axis=2)
    blue[:, : sheet.width // 2] = False  # the heading's swatch
    row, column = np.nonzero(blue)
    assert np.ptp(column) + 1 == pytest.approx(2 * (np.ptp(row) + 1), rel=0.01)
    assert blue.sum() == (np.ptp(column) + 1) * (np.ptp(row) + 1)


# The command


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with part.stl and part.yaml in it."""
    box_job(tmp_path, (8, 6, 1), {"name": "mine", **FINE, "bed_mm": [7, 7, 7]}, ratio=0.4)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def preview(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main(["preview", "part.stl", "--fields", "part.yaml", *words])
    captured = capsys.readouterr()
    err = "".join(line for line in captured.err.splitlines(True) if not line.startswith("compiling the kernels"))
    return code, captured.out, err


def test_the_command_writes_a_picture_and_says_the_notes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {file.name for file in folder.iterdir()}
    code, out, err = preview(capsys)
    assert (code, out) == (0, "part-preview-fields.png\n")
    assert err.startswith("note: the part measures 8 × 6 × 1 mm, more than mine prints (7 × 7 × 7 mm)")
    assert {file.name for file in folder.iterdir()} - before == {"part-preview-fields.png"}
    with Image.open(folder / "part-preview-fields.png") as picture:
        assert {(0x2B, 0x6C, 0xB0), (0xF6, 0xAD, 0x55)} <= colors_in(picture)


def test_quiet_and_a_name_of_ones_own(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert preview(capsys, "--quiet", "-o", "mine.png") == (0, "", "")
    with Image.open("mine.png") as picture:
        picture.load()


def test_settings_change_the_picture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures = []
    for number, words in enumerate(((), ("--seed", "2"), ("--set", "pattern.period=2"), ("--jobs", "1"))):
        assert preview(capsys, "--quiet", *words, "-o", f"{number}.png")[0] == 0
        pictures.append(Path(f"{number}.png").read_bytes())
    assert pictures[0] == pictures[3]
    assert len(set(pictures)) == 3


def test_a_field_file_is_not_overwritten(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = parts.paint(folder, np.full((4, 4), 128, np.uint8), "ratio.png")
    before = (folder / name).read_bytes()
    code, _, err = preview(capsys, "--set", "fields.ratio={image: ratio.png}", "-o", "ratio.png")
    assert code == 2
    assert "'ratio.png' is what the preview is made from" in err
    assert (folder / name).read_bytes() == before


def test_a_preview_and_the_preview_of_its_stack_are_two_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    preview(capsys)
    amslicer.slice_job(amslicer.load_job("part.yaml", "part.stl"), "part")
    assert cli.main(["preview", "part"]) == 0
    assert {file.name for file in folder.glob("*.png")} == {"part-preview-fields.png", "part-preview.png"}
