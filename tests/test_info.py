"""`amslicer info`: what is in a stack, as a person and as a program read it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import parts
import pytest

import amslicer
from amslicer import Run, cli
from amslicer.stackinfo import describe_folder, ranges

DENSITY_G_CM3 = 1.25
JOB = {
    "printer": {"name": "mine", "pitch_um": [200, 250], "layer_um": 250},
    "materials": [{"name": "rigid", "color": "#123456", "density_g_cm3": DENSITY_G_CM3}, "flexible"],
    "pattern": {"period": 1.5, "bandwidth": 0.4, "seed": 7},
    "fields": {"ratio": 1, "orientation": 20},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stack of a box of 8 × 6 × 1 mm that is all rigid: its volume and weight are those of the box."""
    folder = tmp_path_factory.mktemp("made")
    parts.box(folder, (8.0, 6.0, 1.0), "brick.stl")
    amslicer.slice_job(amslicer.load_job(JOB, folder / "brick.stl"), folder / "stack")
    return folder / "stack"


@pytest.fixture
def stack(made: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    shutil.copytree(made, tmp_path / "stack")
    return tmp_path / "stack"


def info(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main(["info", *words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def row(out: str, name: str) -> str:
    (found,) = [line for line in out.splitlines() if line.strip().startswith(name)]
    return " ".join(found.split())


def test_what_a_person_reads(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = info(capsys, str(made))
    assert (code, err) == (0, "")
    manifest = json.loads((made / "manifest.json").read_text(encoding="utf-8"))
    assert row(out, "part") == "part brick.stl, 8 × 6 × 1 mm"
    assert row(out, "bitmaps") == "bitmaps 40 × 24 pixels of 200.00 × 250.00 µm"
    assert row(out, "layers") == "layers 4 of 250 µm"
    assert row(out, "printer") == "printer mine"
    assert row(out, "pattern") == "pattern phasor in 3D, period 1.5 mm, bandwidth 0.4, profile pwm, seed 7"
    assert row(out, "device") == f"device {manifest['device']}"
    assert row(out, "amslicer") == f"amslicer {amslicer.__version__}"
    assert row(out, "digest") == f"digest {manifest['job_digest']}"
    assert row(out, "on disk").endswith(f"MB in {made}")
    # 48 mm³ of 1.25 g/cm³
    assert row(out, "rigid") == "rigid #123456 48.00 0.060 100.00 % 100.00 %"
    assert row(out, "flexible").endswith("0.00 - 0.00 % 0.00 %")


def test_what_a_program_reads(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = info(capsys, str(made), "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["part"], found["size_mm"]) == ("brick.stl", pytest.approx([8, 6, 1]))
    assert (found["width_px"], found["height_px"], found["solid_pixels"]) == (40, 24, 40 * 24 * 4)
    assert (found["layer_count"], found["layers"], found["layer_ranges"]) == (4, 4, [[0, 4]])
    assert found["complete"] is True
    assert found["printer"]["name"] == "mine"
    assert (found["pattern"]["noise"], found["pattern"]["period"], found["pattern"]["seed"]) == ("phasor", 1.5, 7)
    rigid, flexible = found["materials"]
    assert rigid["volume_mm3"] == pytest.approx(48)
    assert rigid["grams"] == pytest.approx(48 / 1000 * DENSITY_G_CM3)
    assert (rigid["ratio"], rigid["asked"], rigid["color"]) == (1, 1, "#123456")
    assert flexible["grams"] is None
    assert found["bytes"] == sum(file.stat().st_size for file in made.rglob("*") if file.is_file())


def test_quiet(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert info(capsys, str(made), "--quiet") == (0, "", "")


def test_an_incomplete_stack_says_which_layers_are_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts.box(tmp_path, (8.0, 6.0, 1.0))
    amslicer.slice_job(amslicer.load_job(JOB, tmp_path / "part.stl"), tmp_path / "some", run=Run(layers=(1, 3)))
    _, out, _ = info(capsys, str(tmp_path / "some"))
    assert row(out, "layers") == "layers 4 of 250 µm; INCOMPLETE: 2 are there (1:3)"


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ([], []),
        ([5], [(5, 6)]),
        ([0, 1, 2], [(0, 3)]),
        ([0, 2, 3, 9], [(0, 1), (2, 4), (9, 10)]),
    ],
)
def test_ranges(numbers: list[int], expected: list[tuple[int, int]]) -> None:
    assert list(ranges(numbers)) == expected


def test_without_its_job_the_rest_is_shown(stack: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (stack / "job.yaml").unlink()
    code, out, _ = info(capsys, str(stack))
    assert code == 0
    assert row(out, "part") == "part brick.stl, 8 × 6 × 1 mm"
    assert "job.yaml' cannot be read: No such file" in row(out, "job")
    assert row(out, "rigid") == "rigid #123456 48.00 - 100.00 % 100.00 %"


def test_a_printer_without_a_name(stack: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = (stack / "job.yaml").read_text(encoding="utf-8")
    (stack / "job.yaml").write_text(job.replace("  name: mine\n", ""), encoding="utf-8")
    assert "without a name" in row(info(capsys, str(stack))[1], "printer")


def without(key: str) -> Any:
    def change(manifest: dict[str, Any]) -> None:
        del manifest[key]

    return change


@pytest.mark.parametrize("change", [without("device"), without("complete"), without("job_digest")])
def test_a_damaged_manifest_is_told(stack: Path, capsys: pytest.CaptureFixture[str], change: Any) -> None:
    manifest = json.loads((stack / "manifest.json").read_text(encoding="utf-8"))
    change(manifest)
    (stack / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    code, out, err = info(capsys, str(stack))
    assert (code, out) == (6, "")
    assert "manifest.json' is damaged" in err


def test_no_stack(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = info(capsys, str(tmp_path))
    assert code == 6
    assert "not a finished stack" in err


def test_bytes_count_what_lies_in_inputs_too(stack: Path) -> None:
    before = describe_folder(stack).bytes
    (stack / "inputs").mkdir()
    (stack / "inputs" / "ratio.png").write_bytes(b"x" * 1234)
    assert describe_folder(stack).bytes == before + 1234
