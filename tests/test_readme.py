"""What the README shows works."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import parts
import pytest

import amslicer

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


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
