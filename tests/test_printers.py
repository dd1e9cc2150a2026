"""Printer profiles: those that come along, those of users, and how pitch and layer are said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import pytest

from amslicer import JobError, load_job
from amslicer.pipeline import prepare
from amslicer.printers import printer_names, read_printer
from amslicer.specification import Printer

CONFIGS = Path(__file__).parents[1] / "configs" / "printers"


def job_printer(printer: Any) -> Printer:
    return load_job({"printer": printer, "materials": ["a", "b"], "fields": {"ratio": 0.3}}, part="p.stl").spec.printer


def refused(printer: Any) -> JobError:
    with pytest.raises(JobError) as caught:
        job_printer(printer)
    return caught.value


def test_there_are_profiles() -> None:
    assert "generic-600dpi" in printer_names()
    assert printer_names() == sorted(file.stem for file in CONFIGS.iterdir())


@pytest.mark.parametrize("file", sorted(CONFIGS.iterdir()), ids=lambda file: file.name)
def test_every_profile_is_a_printer(file: Path) -> None:
    assert file.suffix == ".yaml"
    printer = job_printer(file.stem)
    assert printer.name == file.stem
    assert printer.description
    assert printer == job_printer({"name": file.stem, **read_printer(str(file), file.parent)})


@pytest.mark.parametrize(
    ("name", "dpi", "layer_mm"),
    [
        ("generic-300dpi", (300, 300), 0.05),
        ("generic-600dpi", (600, 600), 0.027),
        ("generic-600x300dpi", (600, 300), 0.027),
        ("generic-1200dpi", (1200, 1200), 0.015),
    ],
)
def test_the_grids_of_the_profiles(name: str, dpi: tuple[int, int], layer_mm: float) -> None:
    printer = job_printer(name)
    assert printer.pitch_mm == (25.4 / dpi[0], 25.4 / dpi[1])
    assert printer.layer_height_mm == layer_mm
    assert printer.margin_px == 0


@pytest.mark.parametrize(
    ("printer", "pitch_mm", "layer_mm"),
    [
        ({"dpi": 254, "layer_mm": 0.1}, (0.1, 0.1), 0.1),
        ({"dpi": [600, 300], "layer_mm": 0.027}, (25.4 / 600, 25.4 / 300), 0.027),
        ({"pitch_um": 50, "layer_um": 30}, (0.05, 0.05), 0.03),
        ({"pitch_um": [42.3, 84.7], "layer_um": 27}, (0.0423, 0.0847), 0.027),
        ({"pitch_um": 50, "layer_mm": 1}, (0.05, 0.05), 1.0),
        ({"dpi": 508, "layer_um": 25.4}, (0.05, 0.05), 0.0254),
    ],
)
def test_pitch_and_layer_in_either_unit(
    printer: dict[str, Any], pitch_mm: tuple[float, float], layer_mm: float
) -> None:
    found = job_printer(printer)
    assert found.pitch_mm == pytest.approx(pitch_mm, rel=1e-15)
    assert found.layer_height_mm == pytest.approx(layer_mm, rel=1e-15)


@pytest.mark.parametrize(
    ("printer", "said"),
    [
        ({}, "dpi and pitch_um"),
        ({"layer_mm": 0.1}, "dpi and pitch_um"),
        ({"dpi": 600, "pitch_um": 42, "layer_mm": 0.1}, "dpi and pitch_um"),
        ({"dpi": 600}, "layer_mm and layer_um"),
        ({"dpi": 600, "layer_mm": 0.1, "layer_um": 100}, "layer_mm and layer_um"),
        ({"dpi": None, "pitch_um": None, "layer_mm": 0.1}, "dpi and pitch_um"),
    ],
)
def test_exactly_one_of_each_pair(printer: dict[str, Any], said: str) -> None:
    message = refused(printer).message
    assert "needs exactly one of" in message
    assert said in message


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("dpi", 0),
        ("dpi", -600),
        ("dpi", "600"),
        ("dpi", True),
        ("dpi", float("nan")),
        ("dpi", float("inf")),
        ("dpi", [600, 0]),
        ("dpi", [600]),
        ("dpi", [600, 300, 150]),
        ("pitch_um", 0),
        ("pitch_um", [42, "84"]),
        ("layer_mm", 0),
        ("layer_mm", -0.1),
        ("layer_mm", [0.1]),
        ("layer_mm", True),
        ("layer_um", float("inf")),
        ("margin_px", -1),
        ("margin_px", 0.5),
        ("margin_px", True),
        ("margin_px", 10_001),
    ],
)
def test_values_out_of_range(key: str, value: Any) -> None:
    printer = {"dpi": 600, "layer_mm": 0.1}
    for pair in (("dpi", "pitch_um"), ("layer_mm", "layer_um")):
        if key in pair:
            printer = {k: v for k, v in printer.items() if k not in pair}
    assert f"printer.{key}" in refused({**printer, key: value}).message


@pytest.mark.parametrize(
    "printer",
    [
        {"pitch_um": 5e-324, "layer_um": 30},
        {"pitch_um": 50, "layer_um": 5e-324},
        {"dpi": 5e-324, "layer_um": 30},
        {"dpi": 1e308, "layer_um": 30},
        {"dpi": 600, "layer_mm": 1e-300},
    ],
)
def test_grids_that_no_number_holds_are_refused(tmp_path: Path, printer: dict[str, Any]) -> None:
    """A pitch of 0 or infinity after conversion, or more pixels than can be counted; exit 3, not a traceback."""
    (tmp_path / "part.stl").write_bytes(meshes.binary_stl(meshes.box()))
    content = {"printer": printer, "materials": ["a", "b"], "fields": {"ratio": 0.3}}
    with pytest.raises(JobError):
        prepare(load_job(content, part=tmp_path / "part.stl"))


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("generic-600", "generic-600dpi"),
        ("generic600dpi", "generic-600dpi"),
        ("generic-60dpi", "generic-600dpi"),
        ("generic-300x600dpi", "generic-600x300dpi"),
        ("generic-1200dpi.yaml", "generic-1200dpi"),
    ],
)
def test_near_names_are_suggested(name: str, near: str) -> None:
    error = refused(name)
    assert f"'{name}'" in error.message
    assert error.hint is not None
    assert near in error.hint


@pytest.mark.parametrize("name", ["zzz", "", "..", "/", "/dev/zero", "a\0.yaml", "x" * 300 + ".yaml"])
def test_a_hopeless_name_lists_all(name: str) -> None:
    error = refused(name)
    assert error.hint is not None
    for profile in printer_names():
        assert profile in error.hint


def write_job(folder: Path, printer: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "fields.yaml"
    file.write_text(f"printer: {printer}\nmaterials: [a, b]\nfields: {{ratio: 0.3}}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("name", ["mine.yaml", "printers/mine.yaml", "../mine.yml"])
def test_an_own_profile_lies_relative_to_the_job_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    file = write_job(tmp_path / "jobs", name)
    own = tmp_path / "jobs" / name
    own.parent.mkdir(exist_ok=True)
    own.write_text("pitch_um: [40, 80]\nlayer_um: 20\nmargin_px: 3\n", encoding="utf-8")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    printer = load_job(file, part="p.stl").spec.printer
    assert (printer.pitch_mm, printer.layer_height_mm, printer.margin_px) == ((0.04, 0.08), 0.02, 3)
    assert printer.name == "mine"


def test_an_own_profile_by_its_whole_path(tmp_path: Path) -> None:
    own = tmp_path / "a printer.yaml"
    own.write_text("dpi: 254\nlayer_mm: 0.1\n", encoding="utf-8")
    assert job_printer(str(own)).pitch_mm == (25.4 / 254, 25.4 / 254)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("dip: 300\nlayer_mm: 0.1\n", "dip"),
        ("dpi: 300\n", "layer_mm and layer_um"),
        ("dpi: 300\ndpi: 600\nlayer_mm: 0.1\n", "line 2, column 1"),
        ("dpi: -1\nlayer_mm: 0.1\n", "printer.dpi"),
        ("dpi: !!int 300\nlayer_mm: 0.1\n", "tags"),
        ("- dpi\n", "mapping"),
    ],
)
def test_own_profiles_that_are_refused(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "mine.yaml").write_text(content, encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load_job(write_job(tmp_path, "mine.yaml"), part="p.stl")
    assert said in caught.value.message


def test_a_profile_of_another_type_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("dpi: 300\nlayer_mm: 0.1\n", encoding="utf-8")
    with pytest.raises(JobError, match=r"no printer profile 'mine\.txt'") as caught:
        load_job(write_job(tmp_path, "mine.txt"), part="p.stl")
    assert ".yaml" in (caught.value.hint or "")
