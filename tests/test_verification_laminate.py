"""Verification finds a laminate that is not the painted one, names the law, and takes every honest one as it is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import forgery
import meshes
import numpy as np
import parts
import pytest

import amslicer
from amslicer import Job, Run, cli

PRINTER = {"pitch_um": 120, "layer_um": 120}
FLAT = {"pitch_um": 110, "layer_um": 500}
PLATE_MM, BLOCK_MM = (30.0, 30.0, 0.5), (20.0, 20.0, 14.0)
# A plate of two materials, a block of two, and a block of three whose sheets are oblique in space.
KINDS = ("plate", "block", "three")
TWO_KINDS = ("plate", "block")
AZIMUTH = {"plate": 25.0, "block": 35.0, "three": -40.0}
ELEVATION = {"block": 20.0, "three": 30.0}
SHARES = {"plate": (0.3, 0.7), "block": (0.35, 0.65), "three": (0.3, 0.45, 0.25)}


def write(
    folder: Path, kind: str, *, turned: float = 0.0, longer: float = 1.0, isotropy: Any = 0.0, shares: Any = None,
    name: str = "fields.yaml", **pattern: Any,
) -> Path:  # fmt: skip
    """A job file of one of the kinds, with what a test changes about it."""
    azimuth = AZIMUTH[kind] + turned
    materials = ["a", "b", "c"][: len(SHARES[kind])]
    content = {
        "printer": FLAT if kind == "plate" else PRINTER,
        "materials": materials,
        "pattern": {"dimensions": 2 if kind == "plate" else 3, "period": longer, **pattern},
        "fields": {
            "ratio": dict(zip(materials, shares or SHARES[kind], strict=True)),
            "orientation": azimuth if kind == "plate" else {"azimuth": azimuth, "elevation": ELEVATION[kind]},
            "isotropy": isotropy,
        },
    }
    file = folder / name
    file.write_text(json.dumps(content), encoding="utf-8")
    return file


def load(folder: Path, kind: str, **changes: Any) -> Job:
    return amslicer.load_job(
        write(folder, kind, **changes), parts.box(folder, PLATE_MM if kind == "plate" else BLOCK_MM)
    )


@pytest.fixture(scope="module")
def stacks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An honest stack of each kind: never changed, only copied or held against other fields."""
    found = {}
    for kind in KINDS:
        folder = tmp_path_factory.mktemp(kind)
        amslicer.slice_job(load(folder, kind), folder / "out")
        found[kind] = folder / "out"
    return found


def broken(report: amslicer.Report) -> set[str]:
    """The first words of the laws that a stack breaks."""
    found = {check.name.partition(":")[0] for check in report.checks if not check.ok}
    assert report.ok == (not found)
    return found


def said(report: amslicer.Report) -> str:
    return "\n".join(problem for check in report.checks for problem in check.problems)


@pytest.mark.parametrize("kind", KINDS)
def test_the_honest_stacks_pass(stacks: dict[str, Path], kind: str) -> None:
    report = amslicer.verify(stacks[kind])
    assert report.ok, said(report)
    assert len(report.shown) >= 4  # so that the tests below test something


@pytest.mark.parametrize(("kind", "degrees"), [("plate", 10), ("block", -10), ("three", 10)])
def test_a_direction_ten_degrees_off_is_found(
    stacks: dict[str, Path], tmp_path: Path, kind: str, degrees: float
) -> None:
    """The stack is held against sheets that are turned the other way: what it shows is too far in this one."""
    report = amslicer.verify(stacks[kind], write(tmp_path, kind, turned=-degrees))
    assert broken(report) == {"direction"}
    turns = np.mean([shown.turn_deg for shown in report.shown], axis=0)
    assert np.sign(turns[2]) == np.sign(degrees)


@pytest.mark.parametrize(("kind", "longer"), [("plate", 1.1), ("plate", 1 / 1.1), ("block", 1.1), ("three", 1 / 1.1)])
def test_a_period_a_tenth_off_is_found(stacks: dict[str, Path], tmp_path: Path, kind: str, longer: float) -> None:
    report = amslicer.verify(stacks[kind], write(tmp_path, kind, longer=1 / longer))
    assert broken(report) == {"period"}
    # Wide lines reach out of the band where their power is looked for, so the figure itself falls short.
    assert report.as_dict()["period_ratio"] == pytest.approx(longer, abs=0.05)


@pytest.mark.parametrize("kind", TWO_KINDS)
def test_rows_upside_down_are_found(stacks: dict[str, Path], tmp_path: Path, kind: str) -> None:
    out = shutil.copytree(stacks[kind], tmp_path / "out")
    forgery.forge(out, lambda labels: labels[::-1])
    assert broken(amslicer.verify(out)) >= {"direction"}


def test_rows_upside_down_are_found_by_a_graded_ratio(tmp_path: Path) -> None:
    """Sheets along x look the same upside down; the ratio does not."""
    part = parts.box(tmp_path, PLATE_MM)
    graded = {"gradient": {"axis": "y", "from": 0.3, "to": 0.6}}
    amslicer.slice_job(parts.job(part, ratio=graded, orientation=90, printer=FLAT), tmp_path / "out")
    assert amslicer.verify(tmp_path / "out").ok
    forgery.forge(tmp_path / "out", lambda labels: labels[::-1])
    assert broken(amslicer.verify(tmp_path / "out")) == {"windows"}


@pytest.mark.parametrize("kind", ["plate", "three"])
def test_swapped_materials_are_found(stacks: dict[str, Path], tmp_path: Path, kind: str) -> None:
    out = shutil.copytree(stacks[kind], tmp_path / "out")
    swap = np.array([0, 2, 1, 3], np.uint8)
    forgery.forge(out, lambda labels: swap[labels])
    assert broken(amslicer.verify(out)) >= {"ratio", "windows"}


@pytest.mark.parametrize("kind", TWO_KINDS)
def test_two_hundredths_too_much_in_a_quarter_are_found(stacks: dict[str, Path], tmp_path: Path, kind: str) -> None:
    """Held against fields that ask for 0.02 less there."""
    first, *others = SHARES[kind]
    less = {"expression": f"{first} - 0.02*where(u < 0.5, 1, 0)*where(v < 0.5, 1, 0)"}
    report = amslicer.verify(stacks[kind], write(tmp_path, kind, shares=(less, *others[:-1], "rest")))
    assert broken(report) - {"ratio"} == {"windows"}


@pytest.mark.parametrize("kind", TWO_KINDS)
def test_a_stack_without_the_painted_isotropy_is_found(stacks: dict[str, Path], tmp_path: Path, kind: str) -> None:
    report = amslicer.verify(stacks[kind], write(tmp_path, kind, isotropy=0.6))
    assert broken(report) == {"isotropy"}
    assert "less isotropic than the painted 0.60" in said(report)


@pytest.mark.parametrize("kind", TWO_KINDS)
def test_a_stack_with_isotropy_that_is_not_painted_is_found(tmp_path: Path, kind: str) -> None:
    amslicer.slice_job(load(tmp_path, kind, isotropy=0.6), tmp_path / "out")
    report = amslicer.verify(tmp_path / "out", write(tmp_path, kind, name="other.yaml"))
    assert broken(report) >= {"isotropy"}
    assert "more isotropic than the painted 0.00" in said(report)


def test_the_command_line_says_7_and_the_law(
    stacks: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fields = write(tmp_path, "plate", turned=10)
    assert cli.main(["verify", str(stacks["plate"]), "--fields", str(fields)]) == 7
    assert "sheets are turned by" in " ".join(capsys.readouterr().out.split())


# --- the part itself ---------------------------------------------------------------------------------------


def test_a_corner_that_is_missing_breaks_volume(stacks: dict[str, Path], tmp_path: Path) -> None:
    out = shutil.copytree(stacks["block"], tmp_path / "out")

    def erase(labels: forgery.Labels) -> forgery.Labels:
        rows, columns = (n // 3 for n in labels.shape)
        labels = labels.copy()
        labels[:rows, :columns] = 0
        return labels

    forgery.forge(out, erase)
    report = amslicer.verify(out)
    assert "volume" in broken(report)
    # 20 × 20 × 14 mm less a ninth of it.
    assert "the part 5600 mm³" in said(report)


def test_bodies_that_overlap_have_the_volume_of_their_union(tmp_path: Path) -> None:
    solid = meshes.joined(meshes.box((12.0, 9.0, 0.5)), meshes.box((12.0, 9.0, 0.5), (6.0, 3.0, 0.0)))
    job = parts.job(parts.stl(tmp_path, solid), orientation=25, printer=FLAT)
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, said(report)
    # 2 × 108 - 36 mm² of 0.11 mm pixels; half a pixel of the outline of 78 mm - 18 mm either way.
    assert report.solid_pixels * 0.11**2 == pytest.approx(180, abs=60 * 0.11 / 2)


# --- honest stacks of every make ---------------------------------------------------------------------------

EVERY_MAKE: dict[str, dict[str, Any]] = {
    "margin": {"printer": FLAT | {"margin_px": 7}},
    "oblong pixels": {"printer": {"dpi": [600, 300], "layer_mm": 0.5}},
    "turned": {"settings": {"rotate": [0, 0, 33]}, "orientation": 25},
    "cyclic": {"profile": "cyclic", "orientation": 200},
    "dithered": {"edges": "dithered"},
    "graded period": {"period": {"gradient": {"axis": "x", "from": 1, "to": 2}}},
    "graded period, cyclic and dithered": {
        "period": {"gradient": {"axis": "y", "from": 2, "to": 1}}, "profile": "cyclic", "edges": "dithered",
        "orientation": -60,
    },
}  # fmt: skip


@pytest.mark.parametrize("make", EVERY_MAKE)
def test_honest_stacks_of_every_make_pass(tmp_path: Path, make: str) -> None:
    settings: dict[str, Any] = {"printer": FLAT, "orientation": 25, "ratio": 0.3} | EVERY_MAKE[make]
    amslicer.slice_job(parts.job(parts.box(tmp_path, PLATE_MM), **settings), tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, said(report)
    assert report.shown


def test_layers_from_the_middle_of_a_block_pass(tmp_path: Path) -> None:
    job = load(tmp_path, "block")
    amslicer.slice_job(job, tmp_path / "out", run=Run(layers=(31, 97)))
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, said(report)
    assert report.layers == 66


@pytest.mark.parametrize("size_mm", [(20.0, 20.0, 0.8), (3.0, 20.0, 3.0), (0.5, 0.4, 0.3)])
def test_parts_thinner_than_a_block_pass(tmp_path: Path, size_mm: tuple[float, float, float]) -> None:
    orientation = {"azimuth": 30, "elevation": 25}
    job = parts.job(parts.box(tmp_path, size_mm), orientation=orientation, dimensions=3, printer=PRINTER)
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, said(report)
