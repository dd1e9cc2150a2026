"""The job file: defaults, every refusal with its place, overrides, and what the digest covers."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from PIL import Image
from pydantic import ValidationError

from amslicer import AmslicerError, Job, JobError, UsageError, load_job
from amslicer.pipeline import prepare
from amslicer.starter import starter_file

LEAST = {"materials": ["rigid", "flexible"], "fields": {"ratio": 0.3}}
NAN, INF = math.nan, math.inf
GRADIENT = {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}


def with_key(key: str, value: Any) -> dict[str, Any]:
    """The shortest job file with one dotted key set."""
    content: dict[str, Any] = deepcopy(LEAST)
    node = content
    *parents, last = key.split(".")
    for parent in parents:
        if not isinstance(node.get(parent), dict):
            node[parent] = {}
        node = node[parent]
    node[last] = value
    return content


def load(content: Mapping[str, Any] = LEAST, **overrides: Any) -> Job:
    return load_job(content, part="part.stl", overrides=overrides)


def refusal(content: Mapping[str, Any]) -> JobError:
    with pytest.raises(JobError) as caught:
        load(content)
    assert caught.value.exit_code == 3
    assert "\n" not in caught.value.message
    return caught.value


def digest(job: Job, part: str = "p", device: str = "d", version: str = "v") -> str:
    return job.digest(part, device, version)


def write(file: Path, content: Mapping[str, Any]) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content), encoding="utf-8")  # JSON is YAML
    return file


def paint(file: Path, grey: int) -> None:
    Image.fromarray(np.full((2, 3), grey, np.uint8)).save(file)


# Defaults


def test_materials_and_ratio_are_enough() -> None:
    assert load().resolved() == {
        "printer": {
            "name": "generic-600dpi",
            "description": "600 × 600 dpi, 0.027 mm layers",
            "dpi": 600.0,
            "layer_mm": 0.027,
            "margin_px": 0,
        },
        "part": {"scale": 1.0, "rotate": [0.0, 0.0, 0.0], "on_bed": True, "allow_open": False},
        "materials": [{"name": "rigid", "color": "#2b6cb0"}, {"name": "flexible", "color": "#f6ad55"}],
        "pattern": {
            "noise": "phasor",
            "dimensions": 3,
            "period": 1.0,
            "bandwidth": 0.5,
            "alignment": 0,
            "lobes": [],
            "planes": ["xy"],
            "spectrum": "laminate",
            "time": 0.0,
            "fourth": 0.0,
            "evaluate": "lattice",
            "profile": "pwm",
            "edges": "sharp",
            "seed": 1,
        },
        "fields": {"ratio": 0.3, "orientation": 0.0, "isotropy": 0.0},
        "output": {"format": "png", "compression": "fast"},
    }


def test_the_grid_of_the_default_printer() -> None:
    printer = load().spec.printer
    assert printer.pitch_mm == (25.4 / 600, 25.4 / 600)
    assert printer.layer_height_mm == 0.027


def test_a_picture_is_0_to_1_over_the_part_unless_told_otherwise() -> None:
    ratio = load(with_key("fields.ratio", {"image": "ratio.png"})).resolved()["fields"]["ratio"]
    assert ratio == {"image": "ratio.png", "range": [0.0, 1.0], "plane": "xy"}


def test_materials_keep_what_is_said_and_get_distinct_colours() -> None:
    job = load(with_key("materials", ["a", {"name": "b", "density_g_cm3": 1.2, "color": "#012aBc"}]))
    assert job.materials == ("a", "b")
    assert job.resolved()["materials"][1] == {"name": "b", "density_g_cm3": 1.2, "color": "#012aBc"}
    first, second = load().spec.materials
    assert first.color != second.color


@pytest.mark.parametrize("missing", ["materials", "fields", "fields.ratio"])
def test_what_is_required(missing: str) -> None:
    content: dict[str, Any] = deepcopy(LEAST)
    *parents, last = missing.split(".")
    (content[parents[0]] if parents else content).pop(last)
    assert f"'{missing}' is missing" in refusal(content).message


def test_the_starter_file_is_a_job(tmp_path: Path) -> None:
    file = tmp_path / "fields.yaml"
    file.write_text(starter_file(file.name), encoding="utf-8")
    job = load_job(file, part="part.stl")
    shown = {"noise": "phasor", "dimensions": 3, "period": 1.0, "bandwidth": 0.5, "profile": "pwm", "seed": 1}
    assert job.resolved()["pattern"].items() >= shown.items()
    assert job.resolved()["fields"]["orientation"] == 30.0


# Values that are accepted


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("part.units", "inch", "inch"),
        ("part.scale", 2, 2.0),
        ("part.rotate", [90, -45.5, 720], [90.0, -45.5, 720.0]),
        ("part.on_bed", False, False),
        ("pattern.dimensions", 2, 2),
        ("pattern.period", 0.8, 0.8),
        ("pattern.bandwidth", 2, 2.0),
        ("pattern.impulses", 4, 4.0),
        ("pattern.evaluate", "exact", "exact"),
        ("pattern.profile", "symmetric", "symmetric"),
        ("pattern.seed", 0, 0),
        ("pattern.seed", 2**64 - 1, 2**64 - 1),
        ("pattern.noise", "phasor", "phasor"),  # the defaults of keys that are not built yet
        ("pattern.alignment", 0, 0),
        ("pattern.profile", "pwm", "pwm"),
        ("fields.isotropy", 0, 0.0),
        ("fields.ratio", 0, 0.0),
        ("fields.ratio", 1, 1.0),
        ("fields.ratio", GRADIENT, GRADIENT),
        ("fields.orientation", -270, -270.0),
        ("fields.orientation", {"elevation": 20}, {"azimuth": 0.0, "elevation": 20.0}),
        ("output.compression", "small", "small"),
        ("output.format", "png", "png"),
    ],
)
def test_accepted(key: str, value: Any, expected: Any) -> None:
    section, name = key.split(".")
    found = load(with_key(key, value)).resolved()[section][name]
    assert found == expected
    assert type(found) is type(expected)


# Values that are refused


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("printer", None, "printer: "),
        ("printer", 3, "printer: "),
        ("printer", ["generic-600dpi"], "printer: "),
        ("part", None, "part: "),
        ("part.units", "km", "part.units: "),
        ("part.units", 25.4, "part.units: "),
        ("part.scale", 0, "part.scale: "),
        ("part.scale", -1, "part.scale: "),
        ("part.scale", NAN, "part.scale: "),
        ("part.scale", INF, "part.scale: "),
        ("part.scale", True, "part.scale: "),
        ("part.scale", "2", "part.scale: "),
        ("part.scale", 10**400, "part.scale: "),
        ("part.rotate", 90, "part.rotate: "),
        ("part.rotate", [0, 0], "part.rotate"),
        ("part.rotate", [0, 0, 0, 0], "part.rotate: "),
        ("part.rotate", [0, 0, True], "part.rotate.2: "),
        ("part.rotate", [0, NAN, 0], "part.rotate.1: "),
        ("part.rotate", ["0", 0, 0], "part.rotate.0: "),
        ("part.on_bed", 1, "part.on_bed: "),
        ("part.on_bed", "yes", "part.on_bed: "),
        ("materials", None, "materials: "),
        ("materials", "rigid", "materials: "),
        ("materials", {"rigid": {}}, "materials: "),
        ("materials", [], "materials: "),
        ("materials", ["rigid"], "materials: "),
        ("materials", list("abcdefghi"), "materials: "),
        ("materials", ["rigid", "Rigid"], "materials: "),
        ("materials", ["rigid", 3], "materials.1: "),
        ("materials", ["rigid", True], "materials.1: "),
        ("materials", ["rigid", {}], "materials.1.name"),
        ("materials", ["rigid", ""], "materials.1"),
        ("materials", ["rigid", "../b"], "materials.1"),
        ("materials", ["rigid", "a/b"], "materials.1"),
        ("materials", ["rigid", ".."], "materials.1"),
        ("materials", ["rigid", "soft."], "materials.1"),
        ("materials", ["rigid", "soft\n"], "materials.1"),
        ("materials", ["rigid", "x" * 65], "materials.1"),
        ("materials", ["rigid", "inputs"], "materials.1"),
        ("materials", ["rigid", "Inputs"], "materials.1"),
        ("materials", ["rigid", "manifest.json"], "materials.1"),
        ("materials", ["rigid", {"name": "soft", "color": "red"}], "materials.1.color: "),
        ("materials", ["rigid", {"name": "soft", "color": "#12345"}], "materials.1.color: "),
        ("materials", ["rigid", {"name": "soft", "color": 3}], "materials.1.color: "),
        ("materials", ["rigid", {"name": "soft", "color": ""}], "materials.1.color: "),
        ("materials", ["rigid", {"name": "soft", "color": 0}], "materials.1.color: "),
        ("materials", ["rigid", {"name": "soft", "density_g_cm3": 0}], "materials.1.density_g_cm3: "),
        ("materials", ["rigid", {"name": "soft", "density_g_cm3": NAN}], "materials.1.density_g_cm3: "),
        ("materials", ["rigid", {"name": "soft", "density_g_cm3": True}], "materials.1.density_g_cm3: "),
        ("pattern", 3, "pattern: "),
        ("pattern.noise", "fasor", "pattern.noise: "),
        ("pattern.noise", 3, "pattern.noise: "),
        ("pattern.dimensions", 4, "pattern.dimensions: "),
        ("pattern.dimensions", 2.5, "pattern.dimensions: "),
        ("pattern.dimensions", True, "pattern.dimensions: "),
        ("pattern.dimensions", "3", "pattern.dimensions: "),
        ("pattern.period", 0, "pattern.period: "),
        ("pattern.period", -1, "pattern.period: "),
        ("pattern.period", NAN, "pattern.period: "),
        ("pattern.period", INF, "pattern.period: "),
        ("pattern.period", True, "pattern.period: "),
        ("pattern.period", "1", "pattern.period: "),
        ("pattern.period", None, "pattern.period: "),
        ("pattern.bandwidth", 0, "pattern.bandwidth: "),
        ("pattern.bandwidth", 2.5, "pattern.bandwidth: "),
        ("pattern.bandwidth", NAN, "pattern.bandwidth: "),
        ("pattern.bandwidth", True, "pattern.bandwidth: "),
        ("pattern.impulses", 0, "pattern.impulses: "),
        ("pattern.impulses", 101, "pattern.impulses: "),
        ("pattern.impulses", INF, "pattern.impulses: "),
        ("pattern.impulses", True, "pattern.impulses: "),
        ("pattern.alignment", -1, "pattern.alignment: "),
        ("pattern.alignment", 0.5, "pattern.alignment: "),
        ("pattern.alignment", False, "pattern.alignment: "),
        ("pattern.evaluate", "fast", "pattern.evaluate: "),
        ("pattern.profile", "pmw", "pattern.profile: "),
        ("pattern.seed", -1, "pattern.seed: "),
        ("pattern.seed", 2**64, "pattern.seed: "),
        ("pattern.seed", 1.5, "pattern.seed: "),
        ("pattern.seed", True, "pattern.seed: "),
        ("pattern.seed", "1", "pattern.seed: "),
        ("fields", None, "fields: "),
        ("fields", 0.3, "fields: "),
        ("fields.ratio", 1.5, "fields.ratio: "),
        ("fields.ratio", -0.1, "fields.ratio: "),
        ("fields.ratio", NAN, "fields.ratio: "),
        ("fields.ratio", INF, "fields.ratio: "),
        ("fields.ratio", True, "fields.ratio: true is not a field"),
        ("fields.ratio", "0.3", 'fields.ratio: "0.3" is not a field'),
        ("fields.ratio", None, "fields.ratio: null is not a field"),
        ("fields.ratio", [0.3], "fields.ratio: [0.3] is not a field"),
        ("fields.ratio", {}, "fields.ratio: {} is not a field"),
        ("fields.ratio.gradient", 3, "fields.ratio.gradient: "),
        ("fields.ratio.gradient", {}, "'fields.ratio.gradient.axis' is missing"),
        ("fields.ratio.gradient", {"axis": "x", "from": 0}, "'fields.ratio.gradient.to' is missing"),
        ("fields.ratio.gradient", {"axis": "q", "from": 0, "to": 1}, "fields.ratio.gradient.axis: "),
        ("fields.ratio.gradient", {"axis": "x", "from": NAN, "to": 1}, "fields.ratio.gradient.from: "),
        ("fields.ratio.gradient", {"axis": "x", "from": 0, "to": True}, "fields.ratio.gradient.to: "),
        ("fields.ratio.gradient", {"axis": "x", "from": 0, "to": 1, "end": "5"}, "fields.ratio.gradient.end: "),
        ("fields.ratio.gradient", {"axis": "x", "from": 0, "to": 1, "start": 2, "end": 2}, "fields.ratio.gradient: "),
        ("fields.ratio.gradient", {"axis": "x", "from_": 0, "to": 1}, "'fields.ratio.gradient.from_'"),
        ("fields.ratio.gradient", {"center": [0, 0], "from": 0, "to": 1}, "'fields.ratio.gradient.radius' is missing"),
        ("fields.ratio.gradient", {"radius": 2, "from": 0, "to": 1}, "'fields.ratio.gradient.center' is missing"),
        ("fields.ratio.gradient", {"center": [0, 0], "radius": 0, "from": 0, "to": 1}, "ratio.gradient.radius: "),
        ("fields.ratio.gradient", {"center": [0, 0], "radius": NAN, "from": 0, "to": 1}, "ratio.gradient.radius: "),
        ("fields.ratio.gradient", {"center": [0], "radius": 2, "from": 0, "to": 1}, "ratio.gradient.center: "),
        ("fields.ratio.gradient", {"center": [0] * 4, "radius": 2, "from": 0, "to": 1}, "ratio.gradient.center: "),
        ("fields.ratio.gradient", {"center": [0, True], "radius": 2, "from": 0, "to": 1}, "ratio.gradient.center"),
        ("fields.ratio.gradient", {"center": 3, "radius": 2, "from": 0, "to": 1}, "ratio.gradient.center: "),
        (
            "fields.ratio.gradient",
            {"axis": "x", "center": [0, 0], "radius": 2, "from": 0, "to": 1},
            "has axis together with center and radius; axis goes with start and end, center with radius",
        ),
        (
            "fields.ratio.gradient",
            {"start": 0, "end": 3, "radius": 2, "from": 0, "to": 1},
            "has start and end together with radius; axis goes with start and end, center with radius",
        ),
        ("fields.ratio", {"expression": 0.2}, "fields.ratio.expression: "),
        ("fields.ratio", {"expression": "0.2*"}, "fields.ratio.expression: "),
        ("fields.orientation", {"azimuth": {"expression": "sine(x)"}}, "fields.orientation.azimuth.expression: "),
        ("fields.ratio", {"image": 3}, "fields.ratio.image: "),
        ("fields.ratio", {"image": ""}, "fields.ratio.image: "),
        ("fields.ratio", {"image": "r.png", "range": 1}, "fields.ratio.range"),
        ("fields.ratio", {"image": "r.png", "range": [0]}, "fields.ratio.range"),
        ("fields.ratio", {"image": "r.png", "range": [0, NAN]}, "fields.ratio.range"),
        ("fields.ratio", {"image": "r.png", "range": [0, True]}, "fields.ratio.range"),
        ("fields.ratio", {"image": "r.png", "box": [0, 0, 0, 1]}, "fields.ratio.box"),
        ("fields.ratio", {"image": "r.png", "box": [0, 2, 1, 1]}, "fields.ratio.box"),
        ("fields.ratio", {"image": "r.png", "box": [0, 0, 1]}, "fields.ratio.box"),
        ("fields.ratio", {"image": "r.png", "plane": "yx"}, "fields.ratio.plane"),
        ("fields.ratio", {"image": "r.png", "plane": "yz", "box": [0, 1, 1, 0]}, "[y0, z0, y1, z1] with y0 < y1"),
        ("fields.ratio", {"image": "r.png", "plane": "xz", "box": [2, 0, 1, 1]}, "[x0, z0, x1, z1] with x0 < x1"),
        ("fields.orientation", NAN, "fields.orientation: "),
        ("fields.orientation", True, "fields.orientation: true is not a field"),
        ("fields.orientation", "30", 'fields.orientation: "30" is not a field'),
        ("fields.orientation", {"azimuth": 3, "elevation": True}, "fields.orientation.elevation: true is not a field"),
        ("fields.isotropy", NAN, "fields.isotropy: "),
        ("fields.isotropy", "0", 'fields.isotropy: "0" is not a field'),
        ("output.format", 3, "output.format: "),
        ("output.format", "gif", "output.format: "),
        ("output.compression", "none", "output.compression: "),
        ("output", [], "output: "),
    ],
)
def test_refused_with_its_key(key: str, value: Any, said: str) -> None:
    message = refusal(with_key(key, value)).message
    assert message.startswith("job: ")
    assert said in message


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("output.format", "tiff", "output.format"),
        ("output.format", "grabcad", "output.format"),
        ("pattern.exemplar", "grain.png", "pattern.exemplar"),
    ],
)
def test_other_keys_of_the_language_are_refused(key: str, value: Any, named: str) -> None:
    assert named in refusal(with_key(key, value)).message


def test_an_elevation_in_2d_is_refused() -> None:
    content = with_key("fields.orientation", {"azimuth": 30, "elevation": 20})
    assert load(content).spec.pattern.dimensions == 3
    content["pattern"] = {"dimensions": 2}
    error = refusal(content)
    assert "fields.orientation" in error.message
    assert "elevation" in error.message
    assert error.hint


def test_the_first_problem_counts_the_others() -> None:
    error = refusal({**LEAST, "pattern": {"bandwidth": 3, "seed": -1, "period": "x"}})
    assert error.hint == "2 more problems after this one"


# Typos


@pytest.mark.parametrize(
    ("text", "place", "said", "meant"),
    [
        ("patern:\n  period: 2\n", "line 1, column 1", "unknown key 'patern'", "pattern"),
        ("pattern:\n  perid: 2\n", "line 2, column 3", "unknown key 'pattern.perid'", "pattern.period"),
        ("pattern: {seed: 1, bandwith: 2}\n", "line 1, column 20", "'pattern.bandwith'", "pattern.bandwidth"),
        ("part:\n  scale: 1\n  unit: cm\n", "line 3, column 3", "'part.unit'", "part.units"),
        ("output: {compresion: small}\n", "line 1, column 10", "'output.compresion'", "output.compression"),
        ("printer: {dip: 300, layer_mm: 0.1}\n", "line 1, column 11", "'printer.dip'", "printer.dpi"),
        ("period: 2\n", "line 1, column 1", "'period'", "pattern.period"),
    ],
)
def test_typos_outside_the_fields(tmp_path: Path, text: str, place: str, said: str, meant: str) -> None:
    check_typo(tmp_path, f"{text}materials: [a, b]\nfields: {{ratio: 0.3}}\n", place, said, meant)


@pytest.mark.parametrize(
    ("text", "place", "said", "meant"),
    [
        ("{ratio: 0.3, orientaton: 3}", "line 2, column 22", "'fields.orientaton'", "fields.orientation"),
        ("{ratio: 0.3, azimuth: 3}", "line 2, column 22", "'fields.azimuth'", "fields.orientation.azimuth"),
        ("{ratio: {gradent: {axis: x, from: 0, to: 1}}}", "line 2, column", "gradent", "gradient"),
        ("{ratio: {imgae: ratio.png}}", "line 2, column", "imgae", "image"),
        ("{ratio: {image: r.png, rnage: [0, 1]}}", "line 2, column 32", "'fields.ratio.rnage'", "range"),
        ("{ratio: {gradient: {axes: x, axis: x, from: 0, to: 1}}}", "line 2, column 29", "gradient.axes'", "axis"),
        ("{ratio: {gradient: {centre: [1, 2], radius: 3, from: 0, to: 1}}}", "column 29", "gradient.centre'", "center"),
        ("{ratio: {gradient: {center: [1, 2], raduis: 3, from: 0, to: 1}}}", "column 45", "gradient.raduis'", "radius"),
        ("{ratio: {expresion: x}}", "line 2, column", "expresion", "expression"),
        ("{ratio: 0.3, orientation: {azimut: 3}}", "line 2, column", "azimut", "azimuth"),
        ("{ratio: 0.3, orientation: {azimuth: 3, elevaton: 4}}", "line 2, column 48", "elevaton'", "elevation"),
        (
            "{ratio: 0.3, orientation: {azimuth: {image: a.png, bx: [0, 0, 1, 1]}, elevation: 4}}",
            "line 2, column 60", "'fields.orientation.azimuth.bx'", "box",
        ),
    ],
)  # fmt: skip
def test_typos_in_the_fields(tmp_path: Path, text: str, place: str, said: str, meant: str) -> None:
    check_typo(tmp_path, f"materials: [a, b]\nfields: {text}\n", place, said, meant)


def check_typo(folder: Path, text: str, place: str, said: str, meant: str) -> None:
    file = folder / "job.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load_job(file, part="part.stl")
    assert str(file) in caught.value.message
    assert place in caught.value.message
    assert said in caught.value.message
    assert caught.value.hint is not None
    assert meant in caught.value.hint


def test_a_typo_in_a_material(tmp_path: Path) -> None:
    text = 'materials:\n  - {name: a}\n  - {name: b, colour: "#000000"}\nfields: {ratio: 0.3}\n'
    check_typo(tmp_path, text, "line 3, column 15", "unknown key 'materials.1.colour'", "color")


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("materials: [a, b]\nfields:\n  ratio: 1e400\n", "line 3, column 3", "fields.ratio"),
        ("materials: [a, b]\nfields:\n  ratio: .nan\n", "line 3, column 3", "fields.ratio"),
        ("materials: [a, b]\nfields:\n  ratio: no\n", "line 3, column 3", "fields.ratio"),
        ("pattern:\n  seed: 1.5\nmaterials: [a, b]\nfields: {ratio: 0.3}\n", "line 2, column 3", "pattern.seed"),
        ("part: {rotate: [0, 0, x]}\nmaterials: [a, b]\nfields: {ratio: 0.3}\n", "line 1, column 23", "part.rotate.2"),
        ("materials: [a, b]\nfields: {ratio: {image: a.png, range: [0, x]}}\n", "line 2, column 43", "ratio.range.1"),
        ("materials: [a, b]\nfields: {ratio: {image: a.png, box: [1, 0, 0, 1]}}\n", "line 2, column 32", "ratio.box"),
    ],
)
def test_wrong_values_have_a_place(tmp_path: Path, text: str, place: str, said: str) -> None:
    file = tmp_path / "job.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load_job(file, part="part.stl")
    assert place in caught.value.message
    assert said in caught.value.message


def test_two_sources_for_one_field_are_refused() -> None:
    """The message names both, whichever comes first."""
    for value in ({**GRADIENT, "image": "a.png"}, {"image": "a.png", **GRADIENT}):
        message = refusal(with_key("fields.ratio", value)).message
        assert "image" in message
        assert "gradient" in message


# Overrides


def test_overrides_replace_keys() -> None:
    job = load(
        with_key("fields.ratio", {"image": "ratio.png"}),
        **{"pattern.period": 0.8, "fields.ratio": 0.4, "part.units": "cm", "materials": ["a", "b"]},
    )
    assert job.spec.pattern.period == 0.8
    assert job.spec.fields.ratio == 0.4
    assert job.spec.part.units == "cm"
    assert job.materials == ("a", "b")
    assert job.input_paths() == ()


def test_an_override_reaches_into_a_field() -> None:
    content = with_key("fields.ratio", deepcopy(GRADIENT))
    job = load(content, **{"fields.ratio.gradient.to": 0.5})
    assert job.resolved()["fields"]["ratio"] == {"gradient": {"axis": "x", "from": 0.1, "to": 0.5}}
    assert content["fields"]["ratio"] == GRADIENT, "the caller's own content is untouched"


@pytest.mark.parametrize(
    ("key", "value", "pitch_mm", "layer_mm"),
    [
        ("printer.layer_um", 100, (25.4 / 600, 25.4 / 600), 0.1),
        ("printer.layer_mm", 0.05, (25.4 / 600, 25.4 / 600), 0.05),
        ("printer.dpi", [300, 150], (25.4 / 300, 25.4 / 150), 0.027),
        ("printer.pitch_um", 50, (0.05, 0.05), 0.027),
        ("printer", "generic-300dpi", (25.4 / 300, 25.4 / 300), 0.05),
        ("printer", {"pitch_um": [40, 80], "layer_um": 27}, (0.04, 0.08), 0.027),
    ],
)
def test_overrides_of_a_named_printer(key: str, value: Any, pitch_mm: tuple[float, float], layer_mm: float) -> None:
    printer = load(with_key("printer", "generic-600dpi"), **{key: value}).spec.printer
    assert printer.pitch_mm == pytest.approx(pitch_mm, rel=1e-15)
    assert printer.layer_height_mm == pytest.approx(layer_mm, rel=1e-15)


def test_a_printer_and_then_its_layer() -> None:
    printer = load(**{"printer": "generic-300dpi", "printer.layer_um": 100}).spec.printer
    assert (printer.dpi, printer.layer_height_mm) == (300, 0.1)


@pytest.mark.parametrize(
    ("key", "value", "kind", "said"),
    [
        ("patern.period", 2, UsageError, "'patern"),
        ("pattern.perid", 2, UsageError, "'pattern.perid'"),
        ("pattern.period", -1, UsageError, "pattern.period: "),
        ("pattern.period", "x", UsageError, "pattern.period: "),
        ("pattern.period.x", 2, UsageError, "pattern.period"),
        ("fields.ratio", 2, UsageError, "fields.ratio: "),
        ("fields.ratio.x", 1, UsageError, "fields.ratio"),
        ("materials.0.name", "c", UsageError, "materials"),
        ("printer.dip", 3, UsageError, "'printer.dip'"),
        ("printer.dpi", 0, UsageError, "printer.dpi"),
        ("printer", "generic-60dpi", JobError, "'generic-60dpi'"),  # a printer: exit 3
        ("a.b.c", 1, UsageError, "'a"),
        ("", 1, UsageError, "key"),
    ],
)
def test_overrides_that_are_refused(key: str, value: Any, kind: type[AmslicerError], said: str) -> None:
    content = {**LEAST, "pattern": {"period": 1.0}}
    with pytest.raises(kind) as caught:
        load(content, **{key: value})
    assert said in caught.value.message


def test_an_override_is_not_blamed_on_a_line_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_text("materials: [a, b]\nfields: {ratio: 0.3}\npattern:\n  seed: 1\n", encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        load_job(file, part="part.stl", overrides={"pattern.seed": -1})
    assert "line 4" not in caught.value.message
    assert "job.yaml" not in caught.value.message


# Frozen


def test_a_job_is_frozen() -> None:
    job = load()
    with pytest.raises(dataclasses.FrozenInstanceError):
        job.part = Path("other.stl")  # type: ignore[misc]
    for section in (job.spec, job.spec.pattern, job.spec.fields, job.spec.printer, job.spec.materials[0]):
        name = next(iter(type(section).model_fields))
        with pytest.raises(ValidationError, match="frozen"):
            setattr(section, name, None)


def test_a_job_keeps_nothing_of_the_callers() -> None:
    content = with_key("fields.ratio", deepcopy(GRADIENT))
    job = load(content)
    before = digest(job)
    content["fields"]["ratio"]["gradient"]["to"] = 0.2
    job.resolved()["fields"]["ratio"] = 0.9
    assert digest(job) == before


# Digest


def test_the_digest_is_sha256_in_hex() -> None:
    assert len(digest(load())) == 64
    int(digest(load()), 16)


@pytest.mark.parametrize(
    "content",
    [
        with_key("pattern.period", 1),
        with_key("pattern.seed", 1),
        with_key("pattern.noise", "phasor"),
        with_key("printer", "generic-600dpi"),
        with_key("fields.orientation", 0),
        with_key("materials", [{"name": "rigid"}, {"name": "flexible", "color": "#f6ad55"}]),
        {"fields": {"ratio": 0.3}, "materials": ["rigid", "flexible"]},
        {**LEAST, "part": {}, "pattern": {}, "output": {}},
    ],
)
def test_the_same_value_has_the_same_digest(content: dict[str, Any]) -> None:
    assert digest(load(content)) == digest(load())


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("pattern.seed", 2),
        ("pattern.period", 1.0000001),
        ("pattern.bandwidth", 0.4),
        ("pattern.dimensions", 2),
        ("pattern.impulses", 5),
        ("pattern.evaluate", "exact"),
        ("part.scale", 2),
        ("part.rotate", [0, 0, 90]),
        ("part.on_bed", False),
        ("part.units", "cm"),
        ("printer", "generic-300dpi"),
        ("printer", {"dpi": 600, "layer_mm": 0.027, "margin_px": 1}),
        ("materials", ["flexible", "rigid"]),
        ("fields.ratio", 0.31),
        ("fields.ratio", GRADIENT),
        ("fields.orientation", 1),
        ("output.compression", "small"),
    ],
)
def test_another_value_has_another_digest(key: str, value: Any) -> None:
    assert digest(load(with_key(key, value))) != digest(load())


@pytest.mark.parametrize("other", [{"part": "q"}, {"device": "e"}, {"version": "w"}])
def test_part_device_and_version_change_the_digest(other: dict[str, str]) -> None:
    assert digest(load(), **other) != digest(load())


def test_an_override_and_the_file_have_the_same_digest() -> None:
    assert digest(load(**{"pattern.seed": 7})) == digest(load(with_key("pattern.seed", 7)))


def painted_job(folder: Path, grey: int, picture: str = "ratio.png", name: str = "job.yaml") -> Job:
    file = write(folder / name, with_key("fields.ratio", {"image": picture, "range": [0, 1]}))
    (folder / picture).parent.mkdir(parents=True, exist_ok=True)
    paint(folder / picture, grey)
    return load_job(file, part="part.stl")


def test_the_pictures_content_is_in_the_digest_and_its_name_is_not(tmp_path: Path) -> None:
    first = digest(painted_job(tmp_path / "a", 51))
    assert digest(painted_job(tmp_path / "b", 52)) != first
    assert digest(painted_job(tmp_path / "c", 51, picture="other/name.png")) == first
    assert digest(painted_job(tmp_path / "d e", 51, name="another.yaml")) == first


def test_which_field_a_picture_paints_is_in_the_digest(tmp_path: Path) -> None:
    for name, grey in (("a.png", 50), ("b.png", 60)):
        paint(tmp_path / name, grey)
    digests = []
    for ratio, angle in (("a.png", "b.png"), ("b.png", "a.png"), ("a.png", "a.png")):
        fields = {"ratio": {"image": ratio}, "orientation": {"image": angle, "range": [0, 90]}}
        file = write(tmp_path / "job.yaml", {**LEAST, "fields": fields})
        digests.append(digest(load_job(file, part="part.stl")))
    assert len(set(digests)) == 3


def test_the_digest_is_the_same_in_another_process() -> None:
    code = (
        "import amslicer; print(amslicer.load_job({'materials': ['rigid', 'flexible'], 'fields': {'ratio': 0.3}}, "
        "part='part.stl').digest('p', 'd', 'v'))"
    )
    for seed in ("1", "2"):
        found = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )  # fmt: skip
        assert found.stdout.strip() == digest(load())


# Resolved


@pytest.mark.parametrize(
    "content",
    [
        LEAST,
        with_key("fields.ratio", GRADIENT),
        with_key("fields.ratio", {"gradient": {"axis": "y", "from": 0, "to": 1, "start": -3, "end": 4.5}}),
        with_key("fields.orientation", {"azimuth": GRADIENT, "elevation": 20}),
        with_key("printer", {"pitch_um": [42.3, 84.7], "layer_um": 27, "margin_px": 5}),
        with_key("pattern.impulses", 6.5),
        with_key("part", {"units": "inch", "scale": 0.1, "rotate": [1, 2, 3], "on_bed": False}),
        with_key("materials", ["a b", {"name": "c", "density_g_cm3": 0.1 + 0.2}]),
        with_key("pattern.seed", 2**64 - 1),
    ],
)
def test_the_resolved_job_is_the_same_job(tmp_path: Path, content: dict[str, Any]) -> None:
    job = load(content)
    again = load_job(write(tmp_path / "resolved.yaml", job.resolved()), part="part.stl")
    assert again.resolved() == job.resolved()
    assert digest(again) == digest(job)


def test_the_resolved_job_finds_moved_pictures(tmp_path: Path) -> None:
    job = painted_job(tmp_path / "a", 51, picture="deep/ratio.png")
    assert job.input_paths() == ("deep/ratio.png",)
    moved = job.resolved({"deep/ratio.png": "inputs/0.png"})
    assert moved["fields"]["ratio"]["image"] == "inputs/0.png"
    (tmp_path / "b" / "inputs").mkdir(parents=True)
    paint(tmp_path / "b" / "inputs" / "0.png", 51)
    again = load_job(write(tmp_path / "b" / "job.yaml", moved), part="part.stl")
    assert digest(again) == digest(job)


def test_a_material_named_like_a_picture_is_not_renamed(tmp_path: Path) -> None:
    paint(tmp_path / "a.png", 51)
    content = {"materials": ["a.png", "b"], "fields": {"ratio": {"image": "a.png"}}}
    job = load_job(write(tmp_path / "job.yaml", content), part="part.stl")
    assert job.resolved({"a.png": "inputs/a.png"})["materials"][0]["name"] == "a.png"


# Field files


def read_ratio(folder: Path, name: str) -> bytes:
    file = write(folder / "job.yaml", with_key("fields.ratio", {"image": name}))
    return load_job(file, part="part.stl").inputs.read(name)


def test_field_files_lie_beside_the_job_file(tmp_path: Path) -> None:
    (tmp_path / "jobs" / "paint").mkdir(parents=True)
    for name in ("ratio.png", "paint/ratio.png", "paint/../ratio.png"):
        (tmp_path / "jobs" / name).write_bytes(name.encode())
        assert read_ratio(tmp_path / "jobs", name) == name.encode()


def test_field_files_are_read_once(tmp_path: Path) -> None:
    job = painted_job(tmp_path, 51)
    before = digest(job)
    paint(tmp_path / "ratio.png", 52)
    assert digest(job) == before


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../ratio.png", "outside"),
        ("paint/../../ratio.png", "outside"),
        ("/etc/hostname", "outside"),
        ("/dev/zero", "outside"),
        ("link.png", "outside"),
        ("missing.png", "cannot be read"),
        ("http://example.org/ratio.png", "cannot be read"),
        ("ratio.png/x", "cannot be read"),
        ("x" * 300, "cannot be read"),
        ("folder", "not a regular file"),
        (".", "not a regular file"),
        ("pipe.png", "not a regular file"),
        ("loop.png", "loop.png"),
        ("a\0b.png", "b.png"),
        ("\ud800.png", ".png"),
    ],
    ids=[
        "parent", "parent of folder", "absolute", "device", "link outside", "missing", "url", "below a file",
        "too long", "folder", "own folder", "pipe", "link to itself", "zero byte", "surrogate",
    ],
)  # fmt: skip
def test_field_files_that_are_refused(tmp_path: Path, name: str, said: str) -> None:
    jobs = tmp_path / "jobs"
    (jobs / "folder").mkdir(parents=True)
    (jobs / "paint").mkdir()
    for folder in (tmp_path, jobs):
        (folder / "ratio.png").write_bytes(b"x")
    (jobs / "link.png").symlink_to(tmp_path / "ratio.png")
    (jobs / "loop.png").symlink_to("loop.png")
    os.mkfifo(jobs / "pipe.png")
    with pytest.raises(JobError) as caught:
        read_ratio(jobs, name)
    assert said in caught.value.message


# Job files


def test_job_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="No such file"):
        load_job(tmp_path / "none.yaml", part="part.stl")
    with pytest.raises(JobError, match=r"directory|regular"):
        load_job(tmp_path, part="part.stl")


def test_an_empty_job_file_says_what_is_missing(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_text("", encoding="utf-8")
    with pytest.raises(JobError, match=r"job\.yaml: the key 'materials' is missing"):
        load_job(file, part="part.stl")


def test_loading_reads_neither_part_nor_pictures() -> None:
    job = load_job(with_key("fields.ratio", {"image": "none.png"}), part="none.stl")
    assert job.part == Path("none.stl")
    assert not job.inputs.files


@pytest.mark.parametrize("scale", [1e30, 1e308])
def test_absurd_sizes_are_refused(tmp_path: Path, scale: float) -> None:
    part = tmp_path / "part.stl"
    part.write_bytes(meshes.binary_stl(meshes.box()))
    with pytest.raises(JobError, match="too large"):
        prepare(load_job(with_key("part.scale", scale), part=part))


# Noises of waves, cells and pictures


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ({"noise": "wave", "impulses": 4}, "pattern.impulses: 4.0 means nothing to wave noise"),
        ({"noise": "wave", "alignment": 2}, "pattern.alignment: 2 means nothing to wave noise"),
        ({"noise": "phasor", "spectrum": "white"}, "pattern.spectrum: \"white\" means nothing to phasor noise"),
        ({"noise": "wave-cellular", "time": 0.5}, "pattern.time: 0.5 means nothing to wave-cellular noise"),
        ({"noise": "wave", "reads": "real", "profile": "cyclic"}, "wave noise is read by its values"),
        ({"noise": "wave", "reads": "modulus", "profile": "square"}, "wave noise is read by its modulus"),
        ({"noise": "wave", "reads": "modulus", "edges": "dithered"}, "pattern.edges: dithered"),
        ({"noise": "wave", "spectrum": "web", "edges": "dithered"}, "pattern.edges: dithered"),
        ({"noise": "wave", "spectrum": "crystal", "reads": "phase"}, "waves of crystal are real"),
        ({"noise": "wave", "directions": 5}, "pattern.directions: 5 are too few"),
        ({"noise": "wave-by-example", "exemplar": "g.png", "directions": 40}, "pattern.directions: 40 are too few"),
        ({"noise": "wave", "bandwidth": 0.02}, "pattern.bandwidth: 0.02, but wave noise has 0.05 or more"),
        ({"noise": "wave-stit", "directions": 300}, "at most 256 families of walls"),
        ({"noise": "random-phase"}, "pattern.exemplar: random-phase noise imitates a picture, and none is named"),
        ({"noise": "wave", "spectrum": "pink"}, "pattern.spectrum: \"pink\" is not a spectrum"),
        ({"noise": "wave", "spectrum": {"power": -1, "low": 1, "high": 0.5}}, "low is below high"),
        ({"noise": "wave", "spectrum": {"table": [[0, 1], [0.5, -1]]}}, "needs amplitudes of at least 0"),
        ({"noise": "wave", "spectrum": {"sectors": [[40, 10]]}}, "the first is below the second"),
        ({"noise": "wave", "time": 1e300}, "pattern.time"),
        ({"noise": "asymptotic-spot", "exemplar": "g.png", "exemplar_pixel_mm": 1e-9}, "pattern.exemplar_pixel_mm"),
    ],
)  # fmt: skip
def test_what_means_nothing_to_a_noise_is_refused(pattern: dict[str, Any], said: str) -> None:
    assert said in refusal({**LEAST, "pattern": pattern}).message


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ({"noise": "wave", "spectrum": {"table": [[0, 1], [0.001, 0], [0.01, 0]]}}, "has an amplitude"),
        ({"noise": "wave-cellular", "period": {"gradient": {"axis": "x", "from": 1, "to": 2}}}, "they have one period"),
        ({"noise": "random-phase", "exemplar": "grain.png", "period": {"gradient": {"axis": "x", "from": 1, "to": 2}}},
         "renewed along z after one period"),
        ({"noise": "wave", "spectrum": "web", "period": {"gradient": {"axis": "x", "from": 1, "to": 2}}}, "one period"),
        ({"noise": "wave", "period": 1e-9}, "between 0.0001 and 1e+07 mm is sliced"),
        ({"noise": "wave-cellular", "period": 1e-4}, "the job is too large"),
        ({"noise": "wave", "isotropy": 1, "period": 0.3, "directions": 20_000}, "the job is too large"),
        ({"noise": "random-phase", "exemplar": "flat.png"}, "shows nothing"),
        ({"noise": "random-phase", "exemplar": "tiny.png"}, "8 or more a side"),
        ({"noise": "random-phase", "exemplar": "missing.png"}, "cannot be read"),
        ({"noise": "random-phase", "exemplar": "../grain.png"}, "lies outside the job file's folder"),
    ],
)  # fmt: skip
def test_noises_that_this_part_or_picture_cannot_have(tmp_path: Path, pattern: dict[str, Any], said: str) -> None:
    box = parts.box(tmp_path, (40.0, 40.0, 1.0))
    grey = parts.picture(parts.grain())
    for name, picture in (("grain", grey), ("flat", np.full((9, 9), 7, np.uint8)), ("tiny", grey[:7])):
        parts.paint(tmp_path, picture, f"{name}.png")
    isotropy = pattern.pop("isotropy", 0)
    with pytest.raises(JobError) as caught:
        prepare(parts.job(box, isotropy=isotropy, **pattern))
    assert said in caught.value.message
