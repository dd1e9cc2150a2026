"""What the README shows works."""

from __future__ import annotations

import re
from pathlib import Path

import meshes
import numpy as np
import parts
import pytest
from pydantic import TypeAdapter

import amslicer
from amslicer.fields import FieldSpec
from amslicer.yamlfile import parse_yaml

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def block(language: str, number: int = 0) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    assert len(found) == {"yaml": 2, "python": 1}[language]
    return str(found[number])


def test_pictures_and_linked_files_are_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in target:
            assert (REPOSITORY / target).is_file(), target


def test_make_targets_exist() -> None:
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:`|    )make (\w+)", README):
        assert f"\n{target}:" in makefile, target


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    parts.box(tmp_path, (6.0, 4.0, 0.1))
    parts.paint(tmp_path, np.full((4, 6), 128, np.uint8), "angle.png")
    (tmp_path / "fields.yaml").write_text(block("yaml"), encoding="utf-8")
    exec(compile(block("python"), "README.md", "exec"), {"__name__": "readme"})
    assert amslicer.verify("out").layers == 4


def test_skins_bodies_void_and_relief_run(tmp_path: Path) -> None:
    part = tmp_path / "part.obj"
    boxes = (("grip", (3.0, 3.0, 3.0), (0.0, 0.0, 0.0)), ("core", (4.0, 3.0, 3.0), (2.0, 0.0, 0.0)))
    text, start = "", 1
    for name, size, corner in boxes:
        vertices, faces = meshes.box(size, corner)
        text += f"o {name}\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in vertices)
        text += "".join(f"f {a} {b} {c}\n" for a, b, c in faces + start)
        start += len(vertices)
    part.write_text(text)
    content, _ = parse_yaml(block("yaml", 1), "README")
    del content["displacement"]["at"]["gradient"]["start"], content["displacement"]["at"]["gradient"]["end"]
    content |= {"printer": {"pitch_um": 150, "layer_um": 150}, "fields": {"ratio": 0.3}}
    amslicer.slice_job(amslicer.load_job(content, part=part), tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, [check for check in report.checks if not check.ok]


def test_every_field_of_the_table_is_one() -> None:
    rows = [line for line in README.splitlines() if line.startswith("| `{")]
    fields = [found for row in rows for found in re.findall(r"`(\{.*?\})`", row)]
    assert len(fields) >= 20
    for text in fields:
        content, _ = parse_yaml("field: " + text.replace("FIELD", "0.3").replace("…", "x"), "README")
        TypeAdapter(FieldSpec).validate_python(content["field"])
