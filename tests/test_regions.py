"""Bodies with materials of their own: cavities, overlaps by priority, skins around them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest

import amslicer
from amslicer.errors import JobError

PRINTER = {"pitch_um": 100, "layer_um": 100}
NAMES = ("a", "b", "hard")
RATIO = {"a": 0.4, "b": "rest", "hard": 0}


def sliced(folder: Path, solid: meshes.Solid, **keys: Any) -> Any:
    """(L, H, W) labels, row 0 = lowest y, of a solid part in two materials and what `keys` asks for."""
    materials = keys.pop("materials", NAMES)
    ratio = keys.pop("ratio", RATIO)
    job = parts.job(
        parts.stl(folder, solid), printer=PRINTER, materials=materials, ratio=ratio, dimensions=3, sections=keys
    )
    amslicer.slice_job(job, folder / "out", overwrite=True)
    report = amslicer.verify(folder / "out")
    assert report.ok, [check for check in report.checks if not check.ok]
    written = np.stack([layer.labels[::-1] for layer in amslicer.open_stack(folder / "out")])
    assert np.array_equal(written, parts.labels(job)[:, ::-1])
    return written


# Two boxes that overlap where x is from 3 to 4 mm.
LEFT, RIGHT = meshes.box((4.0, 3.0, 2.0)), meshes.box((4.0, 3.0, 2.0), (3.0, 0.0, 0.0))


def test_a_body_of_its_own_material(tmp_path: Path) -> None:
    """Of equal priority the later body counts: the second is hard all over, the rest of the first has the pattern."""
    labels = sliced(tmp_path, meshes.joined(LEFT, RIGHT), bodies={"2": {"material": "hard"}})
    assert (labels[:, :, 30:] == 3).all()
    assert set(np.unique(labels[:, :, :30])) == {1, 2}
    plain = sliced(tmp_path, meshes.joined(LEFT, RIGHT))
    assert np.array_equal(plain[:, :, :30], labels[:, :, :30])


@pytest.mark.parametrize(("first", "second", "border"), [(0, 0, 30), (1, 0, 40), (1, 1, 30), (0, -2, 40)])
def test_overlaps_go_by_priority(tmp_path: Path, first: int, second: int, border: int) -> None:
    bodies = {"1": {"material": "a", "priority": first}, "2": {"material": "hard", "priority": second}}
    labels = sliced(tmp_path, meshes.joined(LEFT, RIGHT), bodies=bodies)
    assert (labels[:, :, :border] == 1).all()
    assert (labels[:, :, border:] == 3).all()


def test_a_body_of_nothing_is_a_cavity_and_has_a_skin_too(tmp_path: Path) -> None:
    """A hole of 1 mm through a box of 3 mm: skins of 0.3 mm stand outside and around it."""
    block, hole = meshes.box((3.0, 3.0, 1.0)), meshes.box((1.0, 1.0, 1.0), (1.0, 1.0, 0.0))
    labels = sliced(
        tmp_path, meshes.joined(block, hole),
        materials=("a", "hard", "b", "void"), ratio={"a": 0.5, "b": "rest", "hard": 0},
        bodies={"2": {"material": "void"}}, skin={"material": "hard", "thickness_mm": 0.3, "top_mm": 0, "bottom_mm": 0},
    )  # fmt: skip
    assert (labels[:, 10:20, 10:20] == 0).all()
    wall = np.zeros((30, 30), bool)
    wall[:3], wall[-3:], wall[:, :3], wall[:, -3:], wall[7:23, 7:23], wall[10:20, 10:20] = (True,) * 5 + (False,)
    around = (labels == 2).all(axis=0)
    rounded = np.abs(np.add.outer(np.arange(30), np.zeros(30)) - 14.5) > 6.5  # corners of the hole's skin are rounded
    corners = rounded & rounded.T & (np.abs(np.arange(30) - 14.5) < 8)[:, None] & (np.abs(np.arange(30) - 14.5) < 8)
    assert np.array_equal(around | corners, wall | corners)
    assert set(np.unique(labels[:, 4:6, 4:6])) <= {1, 3}


def test_two_dimensional_patterns_and_margins(tmp_path: Path) -> None:
    part = parts.stl(tmp_path, meshes.joined(LEFT, RIGHT))
    job = parts.job(
        part, printer={**PRINTER, "margin_px": 5}, materials=NAMES, ratio=RATIO,
        sections={"bodies": {"1": {"material": "hard", "priority": 1}}},
    )  # fmt: skip
    labels = parts.labels(job)
    assert (labels[:, 5:-5, 5:45] == 3).all()
    assert set(np.unique(labels[:, 5:-5, 45:-5])) == {1, 2}
    edge = np.ones(labels.shape[1:], bool)
    edge[5:-5, 5:-5] = False
    assert not labels[:, edge].any()


def test_a_graded_ratio_is_asked_where_the_pattern_is(tmp_path: Path) -> None:
    """What is asked for counts own materials as such: 30 of 70 columns have the pattern, from 0.2 to 0.6 upwards."""
    job = parts.job(
        parts.stl(tmp_path, meshes.joined(LEFT, RIGHT)), printer=PRINTER, materials=("a", "b"), dimensions=3,
        ratio={"gradient": {"axis": "z", "from": 0.2, "to": 0.6}}, sections={"bodies": {"2": {"material": "a"}}},
    )  # fmt: skip
    result = amslicer.slice_job(job, tmp_path / "out")
    assert result.materials[0].asked == pytest.approx((30 * 0.4 + 40) / 70, abs=1e-6)
    assert amslicer.verify(tmp_path / "out").ok


def test_refused(tmp_path: Path) -> None:
    part = parts.stl(tmp_path, meshes.joined(LEFT, RIGHT))
    with pytest.raises(JobError, match="no material 'c'"):
        parts.job(part, sections={"bodies": {"1": {"material": "c"}}})
    job = parts.job(part, sections={"bodies": {"3": {"material": "rigid"}}})
    with pytest.raises(JobError, match="the part has no body '3'") as raised:
        parts.labels(job)
    assert "'1', '2'" in str(raised.value.hint)


def test_what_a_relief_raises_belongs_to_its_body(tmp_path: Path) -> None:
    """Two boxes 2 mm apart, raised by 0.5 mm all over: each is of its own material to its new surface, or a cavity."""
    apart = meshes.joined(meshes.box((3.0, 3.0, 2.0)), meshes.box((3.0, 3.0, 2.0), (5.0, 0.0, 0.0)))
    raised = {"displacement": {"amplitude_mm": 0.5, "field": 1, "resolution_mm": 0.5}}
    labels = sliced(
        tmp_path, apart, materials=("a", "b", "void"), ratio={"a": 0.0, "b": "rest"},
        bodies={"1": {"material": "a"}, "2": {"material": "void"}}, **raised,
    )  # fmt: skip
    assert labels.shape == (30, 40, 90)
    assert np.count_nonzero(labels == 1) == pytest.approx(4 * 4 * 3 * 1000, rel=0.02)
    assert not (labels == 2).any()
    assert not labels[:, :, 45:].any()
