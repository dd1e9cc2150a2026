"""Printer profiles: those that come along, those of users, and how pitch and layer are said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import pytest

from amslicer import JobError, load_job
from amslicer.jobfile import _take_printers_format
from amslicer.pipeline import prepare
from amslicer.printers import printer_names, read_printer
from amslicer.specification import Printer
from amslicer.writers import WRITERS

CONFIGS = Path(__file__).parents[1] / "configs" / "printers"


LEAST = {"materials": ["a", "b"], "fields": {"ratio": 0.3}}


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
        ("stratasys-j750-high-mix", (600, 300), 0.027),
        ("stratasys-j750-high-quality", (600, 300), 0.014),
        ("stratasys-j55", (300, 300), 0.01875),
    ],
)
def test_the_grids_of_the_profiles(name: str, dpi: tuple[int, int], layer_mm: float) -> None:
    printer = job_printer(name)
    assert printer.pitch_mm == (25.4 / dpi[0], 25.4 / dpi[1])
    assert printer.layer_height_mm == layer_mm
    assert printer.margin_px == 0


@pytest.mark.parametrize(
    ("name", "pixels", "pitch_mm"), [("dlp-35um", (3840, 2400), 0.035), ("dlp-50um", (2560, 1620), 0.05)]
)
def test_a_panel_is_as_large_as_its_pixels(name: str, pixels: tuple[int, int], pitch_mm: float) -> None:
    printer = job_printer(name)
    assert printer.pitch_mm == pytest.approx((pitch_mm, pitch_mm), rel=1e-15)
    assert printer.layer_height_mm == 0.05
    assert printer.bed_mm is not None
    assert printer.bed_mm[:2] == pytest.approx([n * pitch_mm for n in pixels])
    assert f"{pixels[0]} × {pixels[1]}" in (printer.description or "")


@pytest.mark.parametrize("name", [name for name in printer_names() if name.startswith("stratasys")])
def test_what_grabcad_asks_for(name: str) -> None:
    """At least 30 slices, at most 6 colours (5 on a J55); where a number comes from stands beside it."""
    printer = job_printer(name)
    assert printer.min_layers == 30
    assert printer.max_materials == (5 if name.endswith("j55") else 6)
    assert printer.format == "grabcad"
    for line in (CONFIGS / f"{name}.yaml").read_text(encoding="utf-8").splitlines():
        if line.split(":")[0] in ("dpi", "layer_mm", "layer_um", "bed_mm", "max_materials", "min_layers"):
            assert "second-hand" in line


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
        ("smallest_feature_um", 0),
        ("smallest_feature_um", [200, 200]),
        ("smallest_feature_um", [200, 0, 200]),
        ("bed_mm", 200),
        ("bed_mm", [200, 200]),
        ("bed_mm", [200, 200, -1]),
        ("max_materials", 0),
        ("max_materials", 2.5),
        ("min_layers", 0),
        ("min_layers", "30"),
        ("format", "grabcab"),
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


# What a machine cannot do


def test_more_materials_than_the_printer_has_are_refused() -> None:
    printer = {"name": "mine", "dpi": 600, "layer_mm": 0.1, "max_materials": 2}
    job_printer(printer)
    with pytest.raises(JobError) as caught:
        load_job({**LEAST, "printer": printer, "materials": ["a", "b", "c"]}, part="p.stl")
    assert caught.value.message == "job: materials: 3 of them, but mine prints at most 2"
    assert "amslicer printers" in (caught.value.hint or "")
    assert caught.value.exit_code == 3


def test_the_place_of_too_many_materials_is_said(tmp_path: Path) -> None:
    file = tmp_path / "fields.yaml"
    names = [f"m{i}" for i in range(6)]
    file.write_text(f"printer: stratasys-j55\nfields: {{ratio: 0.3}}\nmaterials: {names}\n", encoding="utf-8")
    with pytest.raises(JobError, match=r"line 3, column 1: materials: 6 of them, but stratasys-j55 prints at most 5"):
        load_job(file, part="p.stl")


def notes(tmp_path: Path, size_mm: tuple[float, float, float], printer: Any, **settings: Any) -> list[str]:
    """The notes about a box on the origin."""
    (tmp_path / "part.stl").write_bytes(meshes.binary_stl(meshes.box(size_mm)))
    content = {**LEAST, "printer": printer, **settings}
    return prepare(load_job(content, part=tmp_path / "part.stl")).notes()


MACHINE = {"name": "mine", "pitch_um": 100, "layer_um": 100}


@pytest.mark.parametrize(
    ("size_mm", "said"),
    [
        ((20, 10, 5), None),
        ((20.0004, 10, 5), None),  # what would be shown as 20.000 mm fits
        ((20.2, 4, 5), "the part measures 20.2 × 4 × 5 mm, more than mine prints (20 × 10 × 5 mm)"),
        ((4, 4, 5.5), "the part measures 4 × 4 × 5.5 mm, more than mine prints (20 × 10 × 5 mm)"),
        (
            (8, 15, 5),
            "the part measures 8 × 15 × 5 mm, more than mine prints (20 × 10 × 5 mm): turned by 90° about z it would "
            "fit (part.rotate: [0, 0, 90])",
        ),
    ],
)
def test_a_part_larger_than_the_bed_is_noted(
    tmp_path: Path, size_mm: tuple[float, float, float], said: str | None
) -> None:
    printer = {**MACHINE, "bed_mm": [20, 10, 5]}
    assert notes(tmp_path, size_mm, printer) == ([] if said is None else [said])


def test_the_turn_that_is_advised_makes_the_part_fit(tmp_path: Path) -> None:
    printer = {**MACHINE, "bed_mm": [20, 10, 5]}
    (note,) = notes(tmp_path, (8, 5, 15), printer, part={"rotate": [90, 0, 0]})
    assert "8 × 15 × 5 mm" in note
    assert "part.rotate: [90, 0, 90]" in note
    assert notes(tmp_path, (8, 5, 15), printer, part={"rotate": [90, 0, 90]}) == []


def test_too_few_layers_are_noted(tmp_path: Path) -> None:
    printer = {**MACHINE, "min_layers": 30}
    assert notes(tmp_path, (5, 5, 3.0), printer) == []
    (note,) = notes(tmp_path, (5, 5, 2.9), printer)
    assert note == "the part makes 29 layers, fewer than the 30 that mine takes: print it thicker"


@pytest.mark.parametrize(
    ("feature", "ratio", "pattern", "said"),
    [
        (290, 0.3, {}, None),
        (310, 0.3, {}, "300 µm (30 % of a period of 1 mm), thinner than 310 µm, the smallest feature of mine"),
        (310, 0.8, {}, "200 µm (20 % of a period of 1 mm), thinner than 310 µm"),
        (310, 0.3, {"period": 2.0}, None),
        ([200, 200, 400], 0.3, {}, "thinner than 400 µm"),
        ([200, 200, 400], 0.3, {"dimensions": 2}, None),  # every layer is the same: no sheet lies flat
        ([400, 200, 200], 0.3, {"dimensions": 2}, "thinner than 400 µm"),
        (200, 0, {}, None),  # a plain fill has no sheets
        (200, 1, {}, None),
        (200, {"gradient": {"axis": "x", "from": 0.15, "to": 0.7}}, {}, "150 µm (15 % of a period of 1 mm)"),
        (
            200,
            {"gradient": {"axis": "x", "from": 0, "to": 0.7}},
            {"period": 0.8},
            "nothing where a share nears 0: below 25 % of a period of 0.8 mm they are thinner than 200 µm",
        ),
    ],
)
def test_sheets_thinner_than_the_smallest_feature_are_noted(
    tmp_path: Path, feature: Any, ratio: Any, pattern: dict[str, Any], said: str | None
) -> None:
    printer = {**MACHINE, "smallest_feature_um": feature}
    found = notes(tmp_path, (5, 5, 3), printer, fields={"ratio": ratio}, pattern=pattern)
    assert len(found) == (0 if said is None else 1)
    assert said is None or said in found[0]


def test_a_printers_format_that_is_not_built_is_noted_and_not_refused(tmp_path: Path) -> None:
    printer = {**MACHINE, "format": "grabcad"}
    (note,) = notes(tmp_path, (5, 5, 3), printer)
    assert note.startswith("mine takes grabcad files, which this version does not write yet")
    assert notes(tmp_path, (5, 5, 3), printer, output={"format": "png"}) == []
    assert notes(tmp_path, (5, 5, 3), {**MACHINE, "format": "png"}) == []


@pytest.mark.parametrize(
    ("output", "taken"),
    [({}, "tiff"), ({"output": {"compression": "small"}}, "tiff"), ({"output": {"format": "png"}}, "png")],
)
def test_a_printers_format_that_is_built_is_the_default(
    monkeypatch: pytest.MonkeyPatch, output: dict[str, Any], taken: str
) -> None:
    monkeypatch.setitem(WRITERS, "tiff", WRITERS["png"])
    content = {"printer": {**MACHINE, "format": "tiff"}, **output}
    _take_printers_format(content)
    assert content["output"] == {**output.get("output", {}), "format": taken}
