"""Bad input through the command line: its exit code, what is said, and that it costs little and writes nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import pytest
from test_expression import REFUSED as EXPRESSIONS
from test_fields import REFUSED as PICTURES
from test_fields import ROWS, chunk, png, raw_png, saved
from test_mesh import BOX, HOLED, ITEM, STL
from test_mesh import REFUSED as MESHES

MAX_MB = 700  # peak memory of a refusal; the interpreter with NumPy and pydantic takes about 100
FIELDS = "materials: [rigid, flexible]\nprinter: {pitch_um: 200, layer_um: 250}\nfields: {ratio: 0.3}\n"

Files = Mapping[str, bytes | Callable[[Path], None]]


@dataclass(frozen=True)
class Trap:
    """A command line in a folder with part.stl (a box) and fields.yaml, unless `files` says otherwise.

    Attributes:
        said: what the error line must contain: what, where, value.
        hint: what the hint must contain; None: there may be none.
    """

    name: str
    code: int
    said: tuple[str, ...]
    hint: str | None = ""
    files: Files = field(default_factory=dict)
    words: tuple[str, ...] = ()
    part: str = "part.stl"


# ---------------------------------------------------------------------------------------------------------
# Meshes


def sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 1 << 40)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def mesh(name: str, file: str, content: bytes | Callable[[Path], None], *said: str, hint: str | None = "") -> Trap:
    return Trap(f"mesh: {name}", 4, (f"error: {file}: ", *said), hint, {file: content}, part=file)


def glb(**changes: Any) -> bytes:
    """The box as GLB with entries of its header replaced."""
    content = meshes.glb(BOX)
    length = int.from_bytes(content[12:16], "little")
    header = json.dumps(json.loads(content[20 : 20 + length]) | changes).encode()
    header += b" " * (-len(header) % 4)
    total = len(content) - length + len(header)
    lengths = [number.to_bytes(4, "little") for number in (2, total, len(header), 0x4E4F534A)]
    return b"glTF" + b"".join(lengths) + header + content[20 + length :]


def zip_bomb(path: Path) -> None:
    """300 MB of spaces in a third of a megabyte; the interpreter's memory would show whether they were unpacked."""
    path.write_bytes(meshes.threemf(meshes.model_object(1, BOX), ITEM))
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("Metadata/thumbnail.png", "w", force_zip64=True) as member,
    ):
        for _ in range(300):
            member.write(b" " * (1 << 20))


def encrypted_package() -> bytes:
    """The flag alone: what is there is as plain as before."""
    content = bytearray(meshes.threemf(meshes.model_object(1, BOX), ITEM))
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at = content.find(signature)
        while at >= 0:
            content[at + offset] |= 1
            at = content.find(signature, at + 4)
    return bytes(content)


IN_HINT = ("unsupported suffix",)  # what test_mesh expects stands in its hint
ZEROS = [{"componentType": 5126, "type": "VEC3", "count": 3_000_000_000}] * 2
MESH_TRAPS = [
    *(mesh(name, file, content, *said) for name, file, content, said in MESHES if name not in IN_HINT),
    Trap("mesh: missing", 4, ("no part 'absent.stl'",), "stl obj ply off glb 3mf", part="absent.stl"),
    mesh("folder", "folder.stl", Path.mkdir, "is a folder", hint="inside it"),
    mesh("pipe", "pipe.stl", os.mkfifo, "not a regular file"),
    mesh("device", "device.stl", device, "not a regular file"),
    mesh("a terabyte", "huge.stl", sparse, "1099511627776 bytes", "at most 2147483648"),
    mesh("zip bomb", "bomb.3mf", zip_bomb, "unpack to 3145", "more than is read"),
    mesh("encrypted", "locked.3mf", encrypted_package(), "is encrypted", hint="password"),
    mesh("deep XML", "deep.3mf", meshes.threemf("<object>" * 200_000, ITEM), "not valid XML"),
    mesh("GLB of zeros", "zeros.glb", glb(accessors=ZEROS), "declares 3000000000 elements", "in a file of"),
    mesh("GLB of copies", "copies.glb", glb(nodes=[{"mesh": 0}] * 20_001), "20001 placed meshes", "20000"),
    mesh("GLB of shared nodes", "shared.glb", glb(nodes=[{"children": [1, 1]}, {"mesh": 0}]), "listed 2 times"),
    mesh("GLB in a ring", "ring.glb", glb(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}]), "node 0"),
    mesh("OFF of few corners", "few.off", meshes.off(BOX).replace(b"\n3 ", b"\n9 ", 1), "face 0", "9 corners"),
    mesh("OFF of less than nothing", "less.off", meshes.off(BOX).replace(b"8 12", b"-8 12"), "-8 OFF vertices"),
    mesh("PLY of 10^15 faces", "many.ply",
         meshes.ply(BOX).replace(b"face 12", b"face 1000000000000000"), "1000000000000000 PLY face rows", "12 found"),
    mesh("blank text STL", "blank.stl", b"solid\n" + b" \n" * 500_000, "no triangles"),
    mesh("open, but no inside", "sheet.stl", meshes.binary_stl((BOX[0], BOX[1][:2])), "4 open edges"),
]  # fmt: skip
OPEN_TRAPS = [
    Trap("open mesh without the flag", 4, ("4 open edges", "z = 5 and 5 mm"), "--allow-open",
         {"part.stl": meshes.binary_stl(HOLED)}),
    Trap("open sheet with the flag", 4, ("no volume",), "thickness",
         {"part.stl": meshes.binary_stl((BOX[0], BOX[1][:2]))}, ("--allow-open",)),
]  # fmt: skip

# ---------------------------------------------------------------------------------------------------------
# Job files


def job(name: str, text: str | bytes, *said: str, hint: str | None = "") -> Trap:
    content = text.encode() if isinstance(text, str) else text
    return Trap(f"job: {name}", 3, ("fields.yaml", *said), hint, {"fields.yaml": content})


def line(extra: str) -> str:
    """The job file and one more line, which is line 4."""
    return f"{FIELDS}{extra}\n"


def ratio(text: str) -> str:
    return FIELDS.replace("0.3", text)


YAML_TRAPS = [
    job("anchor", line("part: &a {scale: 1}"), "line 4, column 7", "anchors", hint="write each value"),
    job("alias", line("part: *a"), "line 4, column 7", "aliases", hint="write each value"),
    job("merge key", line("part: {<<: {scale: 1}}"), "line 4, column 8", "merge keys", hint="write each value"),
    job("tag", line("part: !!python/object/apply:os.abort []"), "line 4, column 7", "tags"),
    job("several documents", line("---\npart: {}"), "line 4, column 1", "several documents"),
    job("directive", "%YAML 1.1\n---\n" + FIELDS, "line 1, column 1", "directives"),
    job("over 1 MiB", FIELDS + "#" * (1 << 20), "at most 1048576 bytes", hint="picture"),
    job("billions of nothing", "a: [" + "[" * 100_000, "nested deeper than 32 levels"),
    job("a list of 200 000", f"a: [{'1,' * 200_000}]", "line 1", "more than 100000", hint="picture"),
    job("blank lines", "a:" + "\n" * 300_000 + "b: c: d", "line 300001", "mapping values"),
    job("Latin-1", "# \xe4".encode("latin-1") + FIELDS.encode(), "not UTF-8 (byte 2)", hint="UTF-8"),
    job("UTF-16", FIELDS.encode("utf-16"), "not UTF-8 (byte 0)", hint="UTF-8"),
    job("a picture", png(np.zeros((2, 2), np.uint8)), "not UTF-8"),
    job("tab", line("\tpart: {}"), "line 4, column 1", "'\\t'"),
    job("NUL", line("part: \0"), "not YAML"),
    job("duplicate key", line("materials: [a, b]"), "line 4, column 1", "duplicate key 'materials'", "line 1",
        hint="keep one"),
    job("unknown key", line("pattern: {perid: 2}"), "line 4, column 11", "unknown key 'pattern.perid'",
        hint="did you mean pattern.period?"),
    job("empty file", "", "'materials' is missing", hint="amslicer init"),
    job("only comments", "# nothing\n\n# here\n", "'materials' is missing", hint="amslicer init"),
    job("a list", "- materials\n", "must be a mapping", hint="amslicer init"),
    job("number as key", line("1: a"), "line 4, column 1", "the key 1 is not a word", hint='quote it: "1"'),
    job("5000 digits", line(f"pattern: {{seed: {'9' * 5000}}}"), "not YAML"),
    job("seed 2^64", line("pattern: {seed: 18446744073709551616}"), "pattern.seed", "18446744073709551616", hint=None),
    job("period as a word", line("pattern: {period: 1e3mm}"), "line 4, column 11", "pattern.period", '"1e3mm"',
        hint=None),
    job("12:30 is no number", ratio("12:30"), "line 3, column 10", "fields.ratio", '"12:30"', hint=None),
    job("no is no flag", line("part: {on_bed: no}"), "line 4, column 8", "part.on_bed", '"no"', hint=None),
    job("true is no number", ratio("true"), "line 3, column 10", "fields.ratio", "true", hint=None),
    job("NaN", ratio(".nan"), "line 3, column 10", "fields.ratio", "NaN", hint=None),
    job("infinity", line("pattern: {period: .inf}"), "line 4, column 11", "pattern.period", "Infinity", hint=None),
    job("1e400", line("part: {scale: 1e400}"), "line 4, column 8", "part.scale", "Infinity", hint=None),
    job("ratio 1.5", ratio("1.5"), "line 3, column 10", "between 0 and 1", "1.5", hint=None),
    job("ratio -1e-3", ratio("-1e-3"), "line 3, column 10", "between 0 and 1", "-0.001", hint=None),
    Trap("job: missing", 3, ("'absent.yaml' cannot be read", "No such file"), "amslicer init",
         words=("--fields", "absent.yaml")),
    Trap("job: folder", 3, ("'jobs' is not a regular file",), "", {"jobs": Path.mkdir}, ("--fields", "jobs")),
    Trap("job: pipe", 3, ("'pipe.yaml' is not a regular file",), "", {"pipe.yaml": os.mkfifo},
         ("--fields", "pipe.yaml")),
    Trap("job: device", 3, ("'zero.yaml' is not a regular file",), "", {"zero.yaml": device},
         ("--fields", "zero.yaml")),
]  # fmt: skip

ABSURD_TRAPS = [
    Trap("1 km at 1 µm", 3, ("the job is too large", "1000000000 × 1000000000 pixels in 1000000000 layers"), "--units",
         {"part.stl": meshes.binary_stl(meshes.box((1e6, 1e6, 1e6)))},
         ("--set", "printer={pitch_um: 1, layer_um: 1}")),
    Trap("a margin of 10 m", 3, ("the job is too large", "20015 × 20020 pixels"), "--printer",
         words=("--set", "printer.margin_px=10000")),
    Trap("scaled to 10^30 mm", 3, ("the job is too large", "5e+30 mm"), "--scale", words=("--scale", "1e30")),
    Trap("a period of 1 nm", 3, ("the job is too large", "pattern.period 1e-06 mm"), "period",
         words=("--set", "pattern.period=1e-6")),
    Trap("a period of 1 km", 3, ("the job is too large", "pattern.period 1e+06 mm"), "period",
         words=("--set", "pattern.period=1e6")),
    Trap("a bandwidth of 10^-9", 3, ("the job is too large", "bandwidth 1e-09"), "bandwidth",
         words=("--set", "pattern.bandwidth=1e-9")),
]  # fmt: skip

# ---------------------------------------------------------------------------------------------------------
# Field files


def image(
    name: str,
    content: bytes | Callable[[Path], None] | None,
    *said: str,
    path: str = "paint.png",
    hint: str | None = "",
) -> Trap:
    files: dict[str, bytes | Callable[[Path], None]] = {"fields.yaml": ratio(f'{{image: "{path}"}}').encode()}
    if content is not None:
        files["paint.png"] = content
    return Trap(f"field file: {name}", 3, (path, *said), hint, files)


INTERLACED = bytearray(raw_png(8, 8, ROWS))
INTERLACED[28] = 1  # the last byte of IHDR
BOMB = chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(20_000_000)))
MAGICK = "magick"
PICTURE_TRAPS = [
    *(image(name, content, hint="smaller" if "Mpx" in name or name == "largest PNG" else MAGICK)
      for name, content in PICTURES.items()),
    image("interlaced", bytes(INTERLACED), "is interlaced", hint=MAGICK),
    image("16-bit colours", PICTURES["16-bit RGB"], "not grey", hint="-depth 16"),
    image("declared 3600 Mpx", PICTURES["3600 Mpx"], "60000 × 60000 pixels", "100 million"),
    image("cut short", PICTURES["half of the rows"], "cut short", "4 of 8 rows", hint=MAGICK),
    image("EPS in disguise", PICTURES["EPS named png"], "is not a PNG or TIFF picture", hint=MAGICK),
    image("frames", PICTURES["animated"], "frames", hint=MAGICK),
    image("turned by Exif", PICTURES["rotated PNG"], "Exif orientation", hint="-auto-orient"),
    image("palette mode", PICTURES["palette"], "not grey (mode P)", hint="-colorspace Gray"),
    image("alpha", PICTURES["grey and alpha"], "mode LA", hint="-alpha off"),
    image("CMYK mode", PICTURES["CMYK"], "mode CMYK", hint="-colorspace Gray"),
    image("text bomb behind the rows", raw_png(8, 8, ROWS)[:-12] + BOMB + chunk(b"IEND", b""), hint=MAGICK),
    image("WebP in disguise", saved("L", "WEBP"), "is not a PNG or TIFF", hint=MAGICK),
    image("missing", None, "cannot be read: No such file", hint="relative to the job file"),
    image("URL", None, "cannot be read", path="https://example.org/a.png", hint="download"),
    image("file URL", None, "cannot be read", path="file:///etc/hostname", hint="download"),
    image("absolute", None, "outside", path="/etc/hostname", hint="--allow-outside"),
    image("parent", None, "outside", path="../a.png", hint="--allow-outside"),
    image("device outside", None, "outside", path="/dev/zero", hint="--allow-outside"),
    image("link outside", device, "outside", hint="--allow-outside"),
    image("pipe", os.mkfifo, "not a regular file"),
    image("folder", Path.mkdir, "not a regular file"),
    image("a terabyte", sparse, "1099511627776 bytes", "at most 1073741824"),
    Trap("field file: device, outside allowed", 3, ("/dev/zero", "not a regular file"), "",
         {"fields.yaml": ratio("{image: /dev/zero}").encode()}, ("--allow-outside",)),
    Trap("ratio leaves 0 … 1", 3, ("fields.ratio is 1.067 at x = 1.70",), "range",
         {"fields.yaml": ratio("{gradient: {axis: x, from: 0.5, to: 1.5}}").encode()}),
]  # fmt: skip

# ---------------------------------------------------------------------------------------------------------
# Expressions


def expression(text: str) -> Trap:
    """One of test_expression's, whose meant hint may stand in the error line or in the hint."""
    what, column, _ = EXPRESSIONS[text]
    place = () if column is None else (f"(column {column})",)
    content = ratio(json.dumps({"expression": text})).encode()
    said = ("error: fields.yaml, line ", "fields.ratio.expression: ", what, *place)
    return Trap(f"expression: {text[:30]!a}", 3, said, None, {"fields.yaml": content})


EXPRESSION_TRAPS = [expression(text) for text in EXPRESSIONS]

REFUSED: dict[str, list[Trap]] = {
    "meshes": MESH_TRAPS, "open meshes": OPEN_TRAPS, "job files": YAML_TRAPS, "absurd jobs": ABSURD_TRAPS,
    "field files": PICTURE_TRAPS, "expressions": EXPRESSION_TRAPS,
}  # fmt: skip

# ---------------------------------------------------------------------------------------------------------
# What is sliced, but not silently: what stderr must contain

FLAKE = meshes.joined(BOX, meshes.box((0.01, 0.01, 3.0), (0.0, 0.0, 5.0)), meshes.box((3.0, 4.0, 1.0), (0.0, 0.0, 8.0)))
NOTED = [
    Trap("open mesh", 0, ("note: the mesh is open (3 open edges around 1 hole)", "pixel rows of", "stay empty"),
         files={"part.stl": meshes.binary_stl((BOX[0], np.delete(BOX[1], 0, axis=0)))}, words=("--allow-open",)),
    Trap("inside out", 0, ("note: the whole mesh was inside out and has been turned over",),
         files={"part.stl": meshes.binary_stl(meshes.turned(BOX))}),
    Trap("metres read as mm", 0, ("note: the largest side is 0.5 mm", "--units cm (5 mm)", "--units m (500 mm)"),
         files={"part.stl": meshes.binary_stl(meshes.box((0.4, 0.3, 0.5)))}),
    Trap("below the bed", 0, ("note: the part was 2.500 mm below the bed: moved up to z = 0",),
         files={"part.stl": meshes.binary_stl(meshes.box(at=(0.0, 0.0, -2.5)))}),
    Trap("thinner than a pixel", 0, ("note: 12 layers between solid ones are empty, first 20",),
         files={"part.stl": meshes.binary_stl(FLAKE)}),
    Trap("thinner than a layer", 0, ("note: no pixel is solid",),
         files={"part.stl": meshes.binary_stl(meshes.box((3.0, 4.0, 0.1)))}),
    Trap("overlapping bodies", 0, ("note: the stack holds", "overlapping bodies count once"),
         files={"part.stl": meshes.binary_stl(meshes.joined(*[meshes.box((9.0, 9.0, 9.0))] * 2))}),
    Trap("a period of 2 pixels", 0, ("note: the period of 0.5 mm is 2.0 pixels or layers of 250 µm",),
         words=("--set", "pattern.period=0.5")),
    Trap("stripes thinner than a pixel", 0, ("note: the thinnest sheets are 100 µm",),
         words=("--set", "fields.ratio=0.1")),
    Trap("a field file outside, allowed", 0, (),
         files={"jobs": Path.mkdir, "jobs/fields.yaml": ratio("{image: ../paint.png}").encode(),
                "paint.png": png(np.full((2, 2), 128, np.uint8))},
         words=("--allow-outside", "--fields", "jobs/fields.yaml")),
    Trap("what people write", 0, (),
         files={"fields.yaml": ("\ufeff---\r\n" + FIELDS.replace("\n", "\r\n")
                                + "pattern: {seed: 017, bandwidth: 5e-1}\r\n").encode()}),
]  # fmt: skip


def put(folder: Path, trap: Trap) -> dict[str, Any]:
    """Writes a trap's files into a folder of its own; returns its task for the runner."""
    folder.mkdir()
    for name, content in ({"part.stl": STL, "fields.yaml": FIELDS.encode()} | dict(trap.files)).items():
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            content(folder / name)
    # argparse takes the last --fields
    return {"folder": str(folder), "words": [trap.part, "--fields", "fields.yaml", "-o", "out", *trap.words]}


def outcomes(base: Path, traps: list[Trap]) -> list[dict[str, Any]]:
    """What every trap's command line did, all run by one child process."""
    tasks = [put(base / str(number), trap) for number, trap in enumerate(traps)]
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("trap_runner.py")], input=json.dumps(tasks), capture_output=True,
        text=True, check=False, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout)
    for trap, task, result in zip(traps, tasks, results, strict=True):
        print(f"{trap.name}: {result['seconds']:.2f} s, {result['mb']:.0f} MB\n{result['err']}")
        result["written"] = (Path(task["folder"]) / "out").exists()
    return list(results)


def faults(trap: Trap, found: Mapping[str, Any]) -> list[str]:
    """What is not as it should be about a refusal."""
    first, *others = found["err"].splitlines() or [""]
    hint = others[0] if others else ""
    wrong = {
        f"exit code {found['code']} instead of {trap.code}": found["code"] != trap.code,
        "a traceback": "Traceback" in found["err"],
        "no error line": not first.startswith("error: "),
        "more than an error and a hint": len(others) > 1 or len(first) > 1000,
        "no hint": trap.hint is not None and not hint.startswith("hint: "),
        f"the hint lacks {trap.hint!r}": trap.hint is not None and trap.hint not in hint,
        "something was written": found["written"],
        "something was printed": found["out"] != "",
        f"{found['mb']:.0f} MB": found["mb"] > MAX_MB,
        **{f"nothing of {word!r}": word.lower() not in first.lower() for word in trap.said},
    }
    return [f"{trap.name}: {fault}: {first!r}, {hint!r}" for fault, found_wrong in wrong.items() if found_wrong]


@pytest.mark.parametrize("group", REFUSED)
def test_refusals(tmp_path: Path, group: str) -> None:
    traps = REFUSED[group]
    found = outcomes(tmp_path, traps)
    assert [fault for trap, result in zip(traps, found, strict=True) for fault in faults(trap, result)] == []


def test_notes(tmp_path: Path) -> None:
    """Sliced, but what is odd is said; and nothing is said of what is not odd."""
    for trap, found in zip(NOTED, outcomes(tmp_path, NOTED), strict=True):
        assert found["code"] == 0, trap.name
        assert [word for word in trap.said if word not in found["err"]] == [], trap.name
        assert trap.said or "note:" not in found["err"], trap.name
        assert (found["written"], found["mb"] < MAX_MB) == (True, True), trap.name


@pytest.mark.parametrize("trap", [MESH_TRAPS[-1], YAML_TRAPS[0], ABSURD_TRAPS[0]], ids=lambda trap: trap.name)
def test_a_process_of_its_own_does_the_same(tmp_path: Path, trap: Trap) -> None:
    (expected,) = outcomes(tmp_path, [trap])
    words = put(tmp_path / "here", trap)["words"]
    done = subprocess.run(
        [sys.executable, "-m", "amslicer", *words], cwd=tmp_path / "here", capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == tuple(expected[key] for key in ("code", "out", "err"))


def test_every_fault_is_seen() -> None:
    trap = Trap("t", 3, ("what",), "try")
    good = {"code": 3, "err": "error: what\nhint: try\n", "out": "", "mb": 90.0, "written": False}
    assert faults(trap, good) == []
    bad: dict[str, Any] = {"code": 1, "out": "x", "mb": 701.0, "written": True}
    for key, value in bad.items():
        assert len(faults(trap, {**good, key: value})) == 1
    for err in (
        "",
        "error: what",
        "error: what\nhint: no",
        "error: that\nhint: try",
        "error: what\nTraceback\nhint: try",
    ):
        assert faults(trap, {**good, "err": err})
