"""The command line: exit codes, messages with what, where, value and hint, and what each command prints."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import meshes
import numpy as np
import parts
import pytest
from PIL import Image

import amslicer
from amslicer import __version__, cli

JOB = """\
printer: {pitch_um: 200, layer_um: 250}
materials: [rigid, flexible]
pattern: {period: 1.0}
fields: {ratio: 0.3, orientation: 25}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with part.stl (8 × 6 × 1 mm) and fields.yaml in it."""
    parts.box(tmp_path, (8.0, 6.0, 1.0))
    (tmp_path / "fields.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main(list(words))
    captured = capsys.readouterr()
    # The first run on a machine says that it is compiling.
    err = "".join(line for line in captured.err.splitlines(True) if not line.startswith("compiling the kernels"))
    return code, captured.out, err


SLICE = ("part.stl", "--fields", "fields.yaml")


def test_slice_verify_preview(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, *SLICE, "-o", "stack")
    assert (code, err) == (0, "")
    assert "stack: stack" in out
    assert "ratio asked" in out
    code, out, err = run(capsys, "verify", "stack")
    assert (code, err) == (0, "")
    assert "as it was asked for" in out
    code, out, _ = run(capsys, "preview", "stack")
    assert code == 0
    assert out.strip() == str(folder / "stack-preview.png")
    Image.open(out.strip()).load()


def test_the_default_folder_is_the_parts_name(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *SLICE)[0] == 0
    assert (folder / "part" / "manifest.json").is_file()


def test_quiet_prints_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *SLICE, "-o", "stack", "--quiet") == (0, "", "")
    assert run(capsys, "verify", "stack", "--quiet") == (0, "", "")


def test_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, *SLICE, "-o", "stack", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["layers"] == 4
    assert result["complete"] is True
    assert result["solid_pixels"] == 40 * 30 * 4
    assert [m["name"] for m in result["materials"]] == ["rigid", "flexible"]
    report = json.loads(run(capsys, "verify", "stack", "--json")[1])
    assert report["ok"] is True
    assert report["materials"]["rigid"]["expected"] == pytest.approx(0.3)


def test_verify_fails_with_7(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, *SLICE, "-o", "stack")
    (folder / "stack" / "rigid" / "00001.png").unlink()
    code, out, _ = run(capsys, "verify", "stack")
    assert code == 7
    assert "FAILED files" in out
    assert "00001.png" in out
    assert json.loads(run(capsys, "verify", "stack", "--json")[1])["ok"] is False


def test_set_and_the_shorthands_change_the_job(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--set", "pattern.period=2", "--set", "printer.margin_px=2", "--seed", "9", "--scale", "0.5")
    assert run(capsys, *SLICE, *words, "-o", "stack", "--compression", "small")[0] == 0
    job = (folder / "stack" / "job.yaml").read_text()
    for line in ("period: 2.0", "margin_px: 2", "seed: 9", "scale: 0.5", "compression: small"):
        assert line in job
    grid = json.loads((folder / "stack" / "manifest.json").read_text())["grid"]
    assert (grid["width_px"], grid["height_px"], grid["layer_count"]) == (20 + 4, 15 + 4, 2)


def test_units(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *SLICE, "--units", "cm", "--set", "part.scale=0.1", "-o", "stack")[0] == 0
    assert json.loads((folder / "stack" / "manifest.json").read_text())["grid"]["width_px"] == 40


def test_layers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *SLICE, "--layers", "1:3", "-o", "stack")[0] == 0
    assert sorted(p.name for p in (folder / "stack" / "rigid").iterdir()) == ["00001.png", "00002.png"]


def test_dry_run_writes_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = set(folder.rglob("*"))
    code, out, _ = run(capsys, *SLICE, "--dry-run")
    assert code == 0
    assert "40 × 30 px" in out
    assert "nothing was written" in out
    found = json.loads(run(capsys, *SLICE, "--dry-run", "--json")[1])
    assert (found["layers"], found["files"]) == (4, 8)
    assert set(folder.rglob("*")) == before


def test_dry_run_tells_the_size_of_a_part_that_is_thin_in_the_middle(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plates = [meshes.box((20.0, 20.0, 2.0), (0.0, 0.0, z)) for z in (0.0, 10.0)]
    post = meshes.box((2.0, 2.0, 9.0), (9.0, 9.0, 1.5))
    (folder / "hourglass.stl").write_bytes(meshes.binary_stl(meshes.joined(*plates, post)))
    words = ("hourglass.stl", *SLICE[1:], "--printer", "generic-300dpi", "--set", "printer.layer_um=60")
    found = json.loads(run(capsys, *words, "--dry-run", "--json")[1])
    assert run(capsys, *words, "-o", "stack")[0] == 0
    real = sum(file.stat().st_size for file in (folder / "stack").rglob("*.png"))
    assert 0.6 * real < found["bytes"] < 1.6 * real


def test_init_writes_a_file_that_slices(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "init", "mine.yaml")[0] == 0
    words = ("part.stl", "--fields", "mine.yaml", "--printer", "generic-300dpi", "--layers", "0:2", "-o", "stack")
    assert run(capsys, *words)[0] == 0
    code, _, err = run(capsys, "init", "mine.yaml")
    assert code == 2
    assert "exists already" in err


def test_printers_lists_every_profile(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "printers")
    assert code == 0
    for name in ("generic-300dpi", "generic-600dpi", "generic-1200dpi"):
        assert name in out
    by_name = {p["name"]: p for p in json.loads(run(capsys, "printers", "--json")[1])}
    assert by_name["generic-600dpi"]["pitch_mm"] == pytest.approx([25.4 / 600, 25.4 / 600])
    assert by_name["generic-600dpi"]["layer_mm"] == 0.027


def test_devices(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "devices")
    assert code == 0
    assert ": works" in out
    assert any(d["works"] for d in json.loads(run(capsys, "devices", "--json")[1]))


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"amslicer {__version__}\n", "")
    for words in ((), ("--help",)):
        code, out, err = run(capsys, *words)
        assert (code, err) == (0, "")
        assert "amslicer PART --fields" in out
    for command in cli.COMMANDS:
        with pytest.raises(SystemExit) as caught:
            cli.main([command, "--help"])
        assert caught.value.code == 0
        assert "exit codes" in capsys.readouterr().out


# What the user typed, exit code, what the error line says, what the hint says.
MISTAKES: list[tuple[tuple[str, ...], int, str, str]] = [
    (("part.stl",), 2, "--fields is missing", "amslicer init"),
    (("absent.stl", "--fields", "fields.yaml"), 4, "there is no part 'absent.stl'", "mesh file"),
    (("fields.yaml", "--fields", "fields.yaml"), 4, "fields.yaml", "stl"),
    (("part.stl", "--fields", "absent.yaml"), 3, "'absent.yaml' cannot be read: No such file", ""),
    ((*SLICE, "--colour"), 2, "unrecognized arguments: --colour", "--help"),
    ((*SLICE, "--jobs", "0"), 2, "from 1, but is '0'", "--help"),
    ((*SLICE, "--layers", "3"), 2, "must be A:B", "--help"),
    ((*SLICE, "--layers", "4:"), 2, "the part has 4 layers", "0:4"),
    ((*SLICE, "--set", "pattern.period"), 2, "--set needs KEY=VALUE, but is 'pattern.period'", "pattern.period=0.8"),
    ((*SLICE, "--set", "pattern.perid=2"), 2, "unknown key 'pattern.perid'", "did you mean pattern.period?"),
    ((*SLICE, "--set", "fields.ratio=1.5"), 2, "between 0 and 1, but it is 1.5", ""),
    ((*SLICE, "--set", "seed.x.y=1"), 2, "unknown key 'seed'", "the key is pattern.seed"),
    ((*SLICE, "--set", "fields.ratio=[1"), 2, "--set fields.ratio", ""),
    ((*SLICE, "--seed", "-1"), 2, "greater than or equal to 0, but it is -1", ""),
    ((*SLICE, "--scale", "0"), 2, "greater than 0, but it is 0.0", ""),
    ((*SLICE, "--format", "bmp"), 2, 'but it is "bmp"', ""),
    ((*SLICE, "--resume"), 2, "not built yet", "--overwrite"),
    ((*SLICE, "--printer", "generic-60dpi"), 3, "no printer profile 'generic-60dpi'", "generic-600dpi"),
    ((*SLICE, "--device", "abacus"), 5, "no OpenCL device matches --device 'abacus'", "there are:"),
    ((*SLICE, "-o", "."), 2, "is not empty", "--overwrite"),
    ((*SLICE, "-o", "part.stl"), 2, "'part.stl' is a file", "-o OUT"),
    (("verify", "absent"), 6, "not a finished stack", ""),
    (("preview", "absent"), 6, "not a finished stack", ""),
    (("preview", "part.stl"), 2, "no fields for 'part.stl': --fields is missing", "amslicer init"),
    (("preview", "absent.stl", "--fields", "fields.yaml"), 4, "there is no part 'absent.stl'", "mesh file"),
    (("preview", "part.stl", "--fields", "absent.yaml"), 3, "'absent.yaml' cannot be read: No such file", ""),
    (("preview", "part.stl", "--fields", "fields.yaml", "--layer", "3"), 2, "'part.stl' is a part", "slice the part"),
    (("preview", "part.stl", "--fields", "fields.yaml", "-o", "part.stl"), 2, "'part.stl' is what", "another name"),
    (("preview", "part.stl", "--fields", "fields.yaml", "-o", "./fields.yaml"), 2, "is what the preview", "another"),
    (
        ("preview", ".", "--fields", "fields.yaml"),
        2,
        "--fields is for parts, and '.' is not a mesh file",
        "leave it out",
    ),
    (("preview", ".", "--set", "pattern.seed=3"), 2, "--set is for parts", "leave it out"),
    (("info", "absent"), 6, "not a finished stack", ""),
    (("convert", "absent"), 2, "not built yet", "--help"),
    (("verfy", "stack"), 2, "no command and no part 'verfy'", "amslicer verify"),
    ((*SLICE, "-o", ""), 2, "the folder's name is empty", "-o"),
    ((*SLICE, "--set", "pattern.period=0.002"), 3, "needs", "period of at least 3 pixels"),
    ((*SLICE, "--set", "pattern.period=1e9"), 3, "too large", "period"),
    ((*SLICE, "--set", "pattern.impulses=0.5"), 2, "greater than or equal to 2", ""),
    ((*SLICE, "--format", "grabcad"), 2, "but it is", "not built yet"),
    (("verify",), 2, "OUT", "--help"),
]


@pytest.mark.parametrize(("words", "code", "message", "hint"), MISTAKES, ids=[" ".join(m[0]) for m in MISTAKES])
def test_mistakes_are_told_in_one_line_and_a_hint(
    folder: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], code: int, message: str, hint: str
) -> None:
    found, out, err = run(capsys, *words)
    lines = err.splitlines()
    assert found == code, err
    assert out == ""
    assert lines[0].startswith("error: ")
    assert message in lines[0]
    assert all(line.startswith("hint: ") for line in lines[1:])
    assert len(lines) <= 2
    assert hint in " ".join(lines[1:])


def test_debug_shows_the_traceback(folder: Path) -> None:
    with pytest.raises(Exception, match="missing"):
        cli.main(["part.stl", "--debug"])


def test_an_unexpected_error_is_1_without_a_traceback(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from amslicer import commands

    def broken(options: object, check: object) -> int:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(commands, "printers_command", broken)
    code, _, err = run(capsys, "printers")
    assert code == 1
    assert "ZeroDivisionError: oh" in err
    assert "--debug" in err


def test_a_swallowed_signal_stops_the_run_at_the_next_check(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some libraries catch everything while they are imported."""
    from amslicer import pipeline

    prepare = pipeline.prepare

    def swallows(job: amslicer.Job) -> pipeline.Prepared:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except BaseException:
            return prepare(job)
        raise AssertionError("no signal arrived")

    monkeypatch.setattr(pipeline, "prepare", swallows)
    code, _, err = run(capsys, *SLICE, "-o", "stack")
    assert code == 130
    assert "the stack is not finished" in err
    assert not (folder / "stack" / "manifest.json").exists()


def test_a_printer_file_is_found_where_the_command_was_typed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "jobs").mkdir()
    (folder / "fields.yaml").rename(folder / "jobs" / "fields.yaml")
    (folder / "mine.yaml").write_text("{pitch_um: 500, layer_um: 500}")
    words = ("part.stl", "--fields", "jobs/fields.yaml", "--printer", "mine.yaml", "-o", "stack")
    assert run(capsys, *words)[0] == 0
    assert json.loads((folder / "stack" / "manifest.json").read_text())["grid"]["width_px"] == 16


def test_the_exit_code_survives_a_closed_pipe(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, *SLICE, "-o", "stack")
    (folder / "stack" / "rigid" / "00001.png").unlink()
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "amslicer", "verify", "stack"]
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert done.returncode == 7
    assert "Traceback" not in done.stderr


def test_output_that_cannot_be_written_is_6(folder: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "amslicer", "printers"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 6
    assert "the output cannot be written" in done.stderr
    assert "Traceback" not in done.stderr


def test_quiet_is_kept_by_every_command_that_takes_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, *SLICE, "-o", "stack", "--quiet")
    for words in (("printers",), ("devices",), ("verify", "stack"), ("preview", "stack"), (*SLICE, "--dry-run")):
        assert run(capsys, *words, "--quiet") == (0, "", "")


def test_interrupting_what_writes_nothing_does_not_advise_to_overwrite(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from amslicer import commands

    monkeypatch.setattr(commands, "printers_command", lambda options, check: os.kill(os.getpid(), signal.SIGINT))
    code, _, err = run(capsys, "printers")
    assert (code, err) == (130, "error: interrupted\n")


def test_preview_has_the_true_aspect(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printer = "--set=printer={dpi: [600, 300], layer_mm: 0.25}"
    run(capsys, *SLICE, printer, "--set", "fields.ratio=1", "-o", "stack")
    assert run(capsys, "preview", "stack", "--layer", "2", "-o", "layer.png")[0] == 0
    picture = Image.open("layer.png")
    # 8 × 6 mm at 600 × 300 dpi: 189 × 71 pixels, the rows drawn twice as high
    assert picture.size == (189, 142)
    assert np.all(np.asarray(picture)[40, 40] == (0x2B, 0x6C, 0xB0))  # the first material's default colour
    code, _, err = run(capsys, "preview", "stack", "--layer", "77")
    assert code == 2
    assert "no layer 77" in err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_run_with_its_code(folder: Path, number: int, code: int) -> None:
    """The signal is sent once the first bitmap is there: in the middle of the work."""
    words = [sys.executable, "-m", "amslicer", *SLICE, "-o", "stack"]
    words += ["--set", "printer={pitch_um: 20, layer_um: 5}", "--set", "pattern.period=0.5"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=os.environ, start_new_session=True)
    first = folder / "stack" / "rigid" / "00000.png"
    deadline = time.monotonic() + 120
    while not first.exists() and process.poll() is None and time.monotonic() < deadline:
        os.sched_yield()
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    assert process.returncode == code, err
    assert "Traceback" not in err
    assert "--overwrite" in err
    assert not (folder / "stack" / "manifest.json").exists()
    for file in (folder / "stack").rglob("*.png"):
        Image.open(file).load()
