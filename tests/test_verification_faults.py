"""Verification sees a wrong laminate: direction, period, mirrored rows, swapped materials, ratio, isotropy, volume."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from test_verification import failed, rewrite

import amslicer
from amslicer.cli import main
from amslicer.writers.png import encode_png

Content = dict[str, Any]
PRINTER = {"pitch_um": 100, "layer_um": 100}
TURNING = {"gradient": {"axis": "x", "from": 0, "to": 60}}
STRAIGHT = 35
RATIO = {"gradient": {"axis": "y", "from": 0.3, "to": 0.6}}


@dataclass(frozen=True)
class Made:
    """A stack, and the job file that it was made from."""

    folder: Path
    content: Content

    @property
    def out(self) -> Path:
        return self.folder / "out"

    def against(self, change: Callable[[Content], None], folder: Path) -> Path:
        """A job file that asks for something else."""
        content = copy.deepcopy(self.content)
        change(content)
        file = folder / "other.yaml"
        file.write_text(json.dumps(content), encoding="utf-8")
        return file


def make(folder: Path, dimensions: int, fields: Content, materials: list[str] | None = None, **pattern: Any) -> Made:
    size = (42.0, 42.0, 0.3) if dimensions == 2 else (28.0, 22.0, 8.0)
    content = {
        "printer": PRINTER, "materials": materials or ["a", "b"],
        "pattern": {"dimensions": dimensions, **pattern}, "fields": {"ratio": RATIO, **fields},
    }  # fmt: skip
    file = folder / "fields.yaml"
    file.write_text(json.dumps(content), encoding="utf-8")
    amslicer.slice_job(amslicer.load_job(file, parts.box(folder, size)), folder / "out")
    return Made(folder, content)


def leaning(azimuth: Any, dimensions: int) -> Any:
    return azimuth if dimensions == 2 else {"azimuth": azimuth, "elevation": 25}


STACKS = [(2, STRAIGHT), (2, TURNING), (3, STRAIGHT), (3, TURNING)]
NAMES = ["2D straight", "2D turning", "3D straight", "3D turning"]


@pytest.fixture(scope="module", params=STACKS, ids=NAMES)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    dimensions, azimuth = request.param
    folder = tmp_path_factory.mktemp("made")
    return make(folder, dimensions, {"orientation": leaning(azimuth, dimensions)})


@pytest.fixture(scope="module", params=[2, 3])
def straight(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("straight")
    return make(folder, request.param, {"orientation": leaning(STRAIGHT, request.param)})


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(tmp_path_factory.mktemp("block"), 3, {"orientation": STRAIGHT})


def test_what_was_made_passes(made: Made) -> None:
    assert failed(made.out) == set()


@pytest.mark.parametrize("degrees", [-10, 10])
def test_a_direction_10_degrees_off(made: Made, tmp_path: Path, degrees: int) -> None:
    def turn(content: Content) -> None:
        field = content["fields"]["orientation"]
        holder, key = (content["fields"], "orientation") if not isinstance(field, dict) else (field, "azimuth")
        if isinstance(field, dict) and "gradient" in field:
            holder, key = content["fields"], "orientation"
        value = holder[key]
        if isinstance(value, dict):
            value["gradient"]["from"] += degrees
            value["gradient"]["to"] += degrees
        else:
            holder[key] = value + degrees

    assert "direction" in failed(made.out, made.against(turn, tmp_path))


@pytest.mark.parametrize("factor", [1.1, 1 / 1.1])
def test_a_period_a_tenth_off(straight: Made, tmp_path: Path, factor: float) -> None:

    def stretch(content: Content) -> None:
        content["pattern"]["period"] = factor

    assert "period" in failed(straight.out, straight.against(stretch, tmp_path))


def test_swapped_materials(straight: Made, tmp_path: Path) -> None:

    def swap(content: Content) -> None:
        content["fields"]["ratio"] = {"b": RATIO, "a": "rest"}

    assert {"ratio", "windows"} <= failed(straight.out, straight.against(swap, tmp_path))


def test_two_hundredths_in_a_quarter(made: Made, tmp_path: Path) -> None:
    def more(content: Content) -> None:
        content["fields"]["ratio"] = {"expression": "0.3 + 0.3*v + where(u > 0.5, where(v > 0.5, 0.02, 0), 0)"}

    assert "windows" in failed(made.out, made.against(more, tmp_path))


def test_a_laminate_where_isotropy_was_painted(straight: Made, tmp_path: Path) -> None:

    def loosen(content: Content) -> None:
        content["fields"]["isotropy"] = 0.6

    assert "isotropy" in failed(straight.out, straight.against(loosen, tmp_path))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_isotropy_where_a_laminate_was_painted(tmp_path: Path, dimensions: int) -> None:
    made = make(tmp_path, dimensions, {"orientation": leaning(STRAIGHT, dimensions), "isotropy": 0.6})
    assert failed(made.out) == set()

    def straighten(content: Content) -> None:
        content["fields"]["isotropy"] = 0

    assert {"direction", "isotropy"} & failed(made.out, made.against(straighten, tmp_path))


def replaced(made: Made, folder: Path, change: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]) -> Path:
    """A copy of the stack with other bitmaps, and a manifest that knows of them."""
    import hashlib

    out = shutil.copytree(made.out, folder / "forged")
    stack = amslicer.open_stack(out)
    totals = dict.fromkeys(stack.materials, 0)
    manifest = json.loads((out / "manifest.json").read_text())
    for layer, entry in zip(stack, manifest["layers"], strict=True):
        labels = change(layer.labels)
        for number, name in enumerate(stack.materials, 1):
            content = encode_png(labels == number, (0.1, 0.1), 1)
            (out / name / f"{layer.index:05d}.png").write_bytes(content)
            entry["sha256"][name] = hashlib.sha256(content).hexdigest()
            entry["pixels"][name] = int(np.count_nonzero(labels == number))
            totals[name] += entry["pixels"][name]

    def correct(old: Content) -> None:
        old["layers"] = manifest["layers"]
        for material in old["materials"]:
            material["pixels"] = totals[material["name"]]

    rewrite(out, correct)
    return out


def test_mirrored_rows(made: Made, tmp_path: Path) -> None:
    assert {"direction", "windows"} <= failed(replaced(made, tmp_path, lambda labels: labels[::-1]))


def test_a_missing_corner(block: Made, tmp_path: Path) -> None:

    def cut(labels: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        labels = labels.copy()
        labels[: labels.shape[0] // 2, : labels.shape[1] // 2] = 0
        return labels

    assert "volume" in failed(replaced(block, tmp_path, cut))


def test_three_materials(tmp_path: Path) -> None:
    shares = {"a": RATIO, "b": 0.25, "c": "rest"}
    made = make(tmp_path, 2, {"ratio": shares, "orientation": TURNING}, ["a", "b", "c"])
    assert failed(made.out) == set()

    def swap(content: Content) -> None:
        content["fields"]["ratio"] = {"b": RATIO, "a": 0.25, "c": "rest"}

    assert "windows" in failed(made.out, made.against(swap, tmp_path))


def test_the_command_line_says_so_with_exit_code_7(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def stretch(content: Content) -> None:
        content["pattern"]["period"] = 1.25

    file = made.against(stretch, tmp_path)
    maps = tmp_path / "maps.png"
    assert main(["verify", str(made.out), "--fields", str(file), "--maps", str(maps)]) == 7
    said = capsys.readouterr().out
    assert "FAILED period" in said
    assert "times the painted one" in said
    assert maps.stat().st_size > 1000


# --- what must not raise an alarm ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dimensions", "fields", "pattern"),
    [
        (2, {"orientation": STRAIGHT}, {"edges": "dithered"}),
        (2, {"orientation": STRAIGHT}, {"profile": "cyclic", "bandwidth": 1.0}),
        (2, {"orientation": 90}, {"bandwidth": 0.25}),
        (2, {"isotropy": {"gradient": {"axis": "x", "from": 0, "to": 1}}}, {}),
        (2, {}, {"period": {"gradient": {"axis": "x", "from": 0.8, "to": 2.4}}}),
        (3, {"orientation": {"vector": [{"expression": "x - 14"}, {"expression": "y - 11"}, 2]}}, {}),
    ],
)
def test_honest_stacks(tmp_path: Path, dimensions: int, fields: Content, pattern: Content) -> None:
    assert failed(make(tmp_path, dimensions, fields, **pattern).out) == set()


def test_overlapping_bodies_and_thin_parts(tmp_path: Path) -> None:
    solids = {
        "overlapping": meshes.joined(meshes.box((20, 20, 4)), meshes.box((20, 20, 4), (10, 10, 0))),
        "thin": meshes.box((30.0, 2.0, 3.0)),
    }
    for name, solid in solids.items():
        job = parts.job(parts.stl(tmp_path, solid, f"{name}.stl"), printer=PRINTER, dimensions=3, orientation=STRAIGHT)
        result = amslicer.slice_job(job, tmp_path / name)
        assert any("overlapping" in note for note in result.notes) == (name == "overlapping")
        assert failed(tmp_path / name) == set()
