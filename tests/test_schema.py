"""The JSON Schema of the job file: valid, described throughout, and of one mind with the job file's own reader."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from amslicer import AmslicerError, cli, load_job
from amslicer.jobfile import DEFAULT_PRINTER
from amslicer.printers import printer_names, read_printer
from amslicer.schema import SCHEMA_FILE, job_schema
from amslicer.specification import DEFAULT_COLORS, JobFile, key_paths
from amslicer.starter import starter_file
from amslicer.yamlfile import parse_yaml, read_yaml

REPOSITORY = Path(__file__).resolve().parents[1]
SAMPLES = sorted((REPOSITORY / "samples").glob("*/fields.yaml"))
LEAST: dict[str, Any] = {"materials": ["rigid", "flexible"], "fields": {"ratio": 0.3}}
GRADIENT = {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}
IMAGE = {"image": "ratio.png", "range": [0, 1]}
TEXTURE = {"texture": "grain.png", "mean": 0.4, "spread": 0.1, "size_mm": 12}

SCHEMA = job_schema()
VALIDATOR = Draft202012Validator(SCHEMA)


def with_key(key: str, value: Any) -> dict[str, Any]:
    content = deepcopy(LEAST)
    *parents, last = key.split(".")
    node = content
    for parent in parents:
        node = node.setdefault(parent, {})
    node[last] = value
    return content


def problems(content: Any) -> list[str]:
    return [error.message for error in VALIDATOR.iter_errors(content)]


def loads(content: dict[str, Any]) -> bool:
    try:
        load_job(content, part="p.stl")
    except AmslicerError:
        return False
    return True


def test_it_is_a_schema_of_draft_2020_12() -> None:
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    Draft202012Validator.check_schema(SCHEMA)


def objects(node: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every part of the schema that lists properties."""
    if isinstance(node, dict):
        if node.get("type") == "object" and "propertyNames" not in node:  # of materials, whose names are the user's
            yield path, node
        for key, value in node.items():
            yield from objects(value, f"{path}/{key}")
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from objects(value, f"{path}/{index}")


def test_every_key_is_described_and_no_other_is_accepted() -> None:
    found = dict(objects(SCHEMA))
    keys = {key for node in found.values() for key in node.get("properties", ())}
    assert keys >= {path.split(".")[-1] for path in key_paths().values()}
    for path, node in found.items():
        if "properties" not in node:  # a mapping by names of the user's
            assert isinstance(node["additionalProperties"], dict), path
            continue
        assert node["additionalProperties"] is False, path
        for key, value in node["properties"].items():
            assert value.get("description"), f"{path}: {key} has no description"
            assert "title" not in value


def test_the_walk_finds_every_section() -> None:
    """It would prove nothing of a section that it did not see."""
    sections = {path.split("/")[-1] for path, _ in objects(SCHEMA)}
    names = {"Printer", "PartSettings", "Material", "Pattern", "Fields", "AzimuthElevation", "Output"}
    assert sections >= {"", *names, "VectorComponents", "GradientSource", "LinearGradient", "RadialGradient"}
    assert sections >= {"ImageSource", "ExpressionSource", "TextureSource"}


@pytest.mark.parametrize("file", SAMPLES, ids=lambda file: file.parent.name)
def test_the_samples_are_accepted(file: Path) -> None:
    assert problems(read_yaml(file, "job file")[0]) == []


def test_there_are_samples() -> None:
    assert len(SAMPLES) >= 2


def test_the_starter_file_is_accepted_and_points_at_the_schema() -> None:
    text = starter_file("fields.yaml")
    assert text.splitlines()[0] == f"# yaml-language-server: $schema={SCHEMA_FILE}"
    assert f"amslicer schema > {SCHEMA_FILE}" in text.splitlines()[1]
    assert problems(parse_yaml(text, "starter")[0]) == []


@pytest.mark.parametrize("name", printer_names())
def test_printer_profiles_are_accepted_by_name_and_in_place(name: str) -> None:
    assert problems(with_key("printer", name)) == []
    assert problems(with_key("printer", read_printer(name, Path()))) == []


# Content that both the schema and the reader take.
ACCEPTED: list[tuple[str, Any]] = [
    ("printer", {"dpi": [600, 300], "layer_mm": 0.027}),
    ("printer", {"dpi": 600, "pitch_um": None, "layer_um": 27}),
    ("printer", {"pitch_um": 50, "layer_um": 50, "margin_px": 2, "smallest_feature_um": [100, 100, 50]}),
    ("materials", [{"name": "a b"}, "c"]),
    ("materials", ["a", {"name": "d", "color": "#00FF00", "density_g_cm3": 1.2}]),
    ("part", {"units": "inch", "scale": 2, "rotate": [0, 90, 0], "on_bed": False}),
    ("pattern.period", 0.8),
    ("pattern.impulses", None),
    ("pattern.seed", 2**64 - 1),
    ("fields.ratio", GRADIENT),
    ("fields.ratio", {"rigid": 0.3, "flexible": "rest"}),
    ("fields.ratio", {"flexible": GRADIENT, "rigid": "rest"}),
    ("fields.ratio", {"gradient": {"center": [1, 2, 3], "radius": 4, "from": 0, "to": 1}}),
    ("fields.ratio", {"expression": "0.5 + 0.1*sin(x)"}),
    ("fields.orientation", {"vector": [1, {"expression": "x"}, 0]}),
    ("fields.isotropy", GRADIENT),
    ("pattern.period", {"gradient": {"axis": "x", "from": 1, "to": 2}}),
    ("pattern.profile", "cyclic"),
    ("pattern.profile", {"table": [0, 1, 0.5]}),
    ("pattern.profile", {"harmonics": [1, {"amplitude": 0.5, "phase": 90}]}),
    ("pattern.profile", {"blend": {"from": "sine", "to": {"square": 0.3}, "by": GRADIENT}}),
    ("pattern.edges", "dithered"),
    ("fields.ratio", {"gradient": {"axis": "z", "from": 0, "to": 1, "start": -1, "end": 2.5}}),
    ("fields.ratio", {**IMAGE, "box": [0, 0, 10, 5]}),
    ("fields.ratio", TEXTURE),
    ("fields.ratio", {**TEXTURE, "kind": "asymptotic-spot", "seed": 2, "plane": "xz", "renew_mm": 3}),
    ("fields.orientation", 30),
    ("fields.orientation", IMAGE),
    ("fields.orientation", {"azimuth": IMAGE, "elevation": GRADIENT}),
    ("fields.orientation", {"elevation": 10}),
    ("output", {"format": "png", "compression": "small"}),
]
# What neither takes: typos, wrong types, values out of range.
REFUSED: list[tuple[str, Any]] = [
    ("printr", DEFAULT_PRINTER),
    ("printer", "generic-60dpi"),
    ("printer", 600),
    ("printer", None),
    ("printer", {"dpi": 600}),
    ("printer", {"dpi": 600, "pitch_um": 42, "layer_mm": 0.1}),
    ("printer", {"dpi": 600, "layer_mm": 0.1, "bed": [1, 2, 3]}),
    ("printer", {"dpi": 600, "layer_mm": 0.1, "bed_mm": [1, 2]}),
    ("materials", ["alone"]),
    ("materials", ["a", "b/c"]),
    ("materials", ["a", {"name": "b", "colour": "#000000"}]),
    ("materials", ["a", {"name": "b", "color": "blue"}]),
    ("materials", ["a", {"color": "#000000"}]),
    ("part.unit", "mm"),
    ("part.units", "ft"),
    ("pattern.perid", 1),
    ("pattern.bandwidth", 3),
    ("pattern.dimensions", 4),
    ("pattern.noise", "phaser"),
    ("fields.ratios", 0.5),
    ("fields.ratio", "0.5"),
    ("fields.ratio", True),
    ("fields.ratio", {}),
    ("fields.ratio", {"rigid": "most", "flexible": "rest"}),
    ("fields.ratio", {"rigid": 0.3, "flexible": {"gradiant": {"axis": "x", "from": 0, "to": 1}}}),
    ("fields.ratio", {"rigid": 0.5, "gradient": {"axis": "x", "from": 0, "to": 1}}),
    ("fields.orientation", {"vector": [1, 0]}),
    ("pattern.edges", "soft"),
    ("fields.ratio", {"gradiant": {"axis": "x", "from": 0, "to": 1}}),
    ("fields.ratio", {"gradient": {"axis": "x", "from": 0}}),
    ("fields.ratio", {"gradient": {"axis": "x", "from": 0, "too": 1}}),
    ("fields.ratio", {**GRADIENT, **IMAGE}),
    ("fields.ratio", {"image": "ratio.png", "range": [0]}),
    ("fields.orientation", {}),
    ("fields.orientation", {"azimut": 30}),
    ("fields.orientation", {"azimuth": 30, "elevatoin": 20}),
    ("output.format", "bmp"),
]


@pytest.mark.parametrize(("key", "value"), ACCEPTED)
def test_what_is_accepted(key: str, value: Any) -> None:
    content = with_key(key, value)
    assert loads(content)
    assert problems(content) == []


@pytest.mark.parametrize(("key", "value"), REFUSED)
def test_what_is_refused(key: str, value: Any) -> None:
    content = with_key(key, value)
    assert not loads(content)
    assert problems(content)


@pytest.mark.parametrize("key", ["materials", "fields"])
def test_what_must_be_there(key: str) -> None:
    content = {k: v for k, v in LEAST.items() if k != key}
    assert not loads(content)
    assert problems(content)


def test_a_printers_file_is_accepted() -> None:
    assert problems(with_key("printer", "printers/mine.yaml")) == []
    assert problems(with_key("printer", "printers/mine.txt"))


def test_a_resolved_job_is_accepted() -> None:
    resolved = load_job(LEAST, part="p.stl").resolved()
    assert resolved["materials"][0]["color"] == DEFAULT_COLORS[0]
    assert problems(resolved) == []


def test_making_the_schema_changes_no_model() -> None:
    assert "printer" in JobFile.model_json_schema()["required"]


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == SCHEMA
    assert captured.err == ""


def test_init_says_how_to_make_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "jobs").mkdir()
    assert cli.main(["init", "jobs/mine.yaml"]) == 0
    assert f"amslicer schema > jobs/{SCHEMA_FILE}" in capsys.readouterr().err
    assert (tmp_path / "jobs" / "mine.yaml").read_text(encoding="utf-8").startswith("# yaml-language-server: $schema=")
