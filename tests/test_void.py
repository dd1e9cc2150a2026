"""`void` among the materials: no bitmap, but counted, painted and verified like any other."""

from __future__ import annotations

import shutil
from pathlib import Path

import meshes
import numpy as np
import parts
import pytest
from PIL import Image

import amslicer
from amslicer.errors import JobError, StorageError
from amslicer.stackinfo import describe_folder

PRINTER = {"pitch_um": 80, "layer_um": 80}
POROUS = {"a": 0.3, "void": {"gradient": {"axis": "x", "from": 0.1, "to": 0.4}}, "b": "rest"}


@pytest.fixture
def job(tmp_path: Path) -> amslicer.Job:
    return parts.job(
        parts.stl(tmp_path, meshes.sphere(4.0, 4)), printer=PRINTER, materials=("a", "void", "b"), dimensions=3,
        period=0.8, ratio=POROUS,
    )  # fmt: skip


def test_nothing_is_written_for_it(tmp_path: Path, job: amslicer.Job) -> None:
    """The part's volume is the printed one and the void; labels are those of the same job with a third material."""
    result = amslicer.slice_job(job, tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()} == {"a", "b", "inputs"}
    stack = amslicer.open_stack(tmp_path / "out")
    assert stack.materials == ("a", "b")
    full = parts.labels(
        parts.job(
            job.part, printer=PRINTER, materials=("a", "c", "b"), dimensions=3, period=0.8,
            ratio={"c" if name == "void" else name: share for name, share in POROUS.items()},
        )
    )  # fmt: skip
    for layer, expected in zip(stack, full, strict=True):
        assert np.array_equal(layer.labels, np.array([0, 1, 0, 2])[expected])
    assert result.solid_pixels == np.count_nonzero(full)
    assert result.void is not None
    assert result.void.pixels == np.count_nonzero(full == 2)
    assert result.void.ratio == pytest.approx(0.25, abs=0.01)
    assert [m.pixels for m in result.materials] == [np.count_nonzero(full == 1), np.count_nonzero(full == 3)]
    assert [np.array_equal(a.labels, b.labels) for a, b in zip(amslicer.layers(job), stack, strict=True)]


def test_it_is_verified(tmp_path: Path, job: amslicer.Job) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(job, out)
    report = amslicer.verify(out)
    assert report.ok, [check for check in report.checks if not check.ok]
    assert report.materials["void"].expected == pytest.approx(0.25, abs=0.01)
    file = out / "a" / "00040.png"
    pixels = np.array(Image.open(file))
    pixels[0, 0] = True  # a corner of the box around a ball
    Image.fromarray(pixels).save(file)
    problems = [p for check in amslicer.verify(out).checks for p in check.problems]
    assert any("1 pixels lie outside the part" in p for p in problems)
    shutil.rmtree(out / "inputs")
    with pytest.raises(StorageError, match=r"part\.stl' is missing"):
        amslicer.verify(out)


def test_overwrite_takes_its_copy_of_the_part_along(tmp_path: Path, job: amslicer.Job) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(job, out, run=amslicer.Run(layers=(0, 2)))
    assert (out / "inputs" / "part.stl").read_bytes() == job.part.read_bytes()
    amslicer.slice_job(parts.job(job.part, printer=PRINTER), out, run=amslicer.Run(layers=(0, 2)), overwrite=True)
    assert not (out / "inputs").exists()


def test_a_stack_is_sliced_again_into_its_own_folder(tmp_path: Path, job: amslicer.Job) -> None:
    """From its own copies of job, field files and part, which --overwrite is about to remove."""
    out = tmp_path / "out"
    np.save(tmp_path / "v.npy", np.full((2, 2, 2), 0.3))
    ratio = {"a": {"volume": "v.npy"}, "void": 0.2, "b": "rest"}
    first = parts.job(job.part, printer=PRINTER, materials=("a", "void", "b"), ratio=ratio)
    amslicer.slice_job(first, out, run=amslicer.Run(layers=(30, 32)))
    before = [layer.labels for layer in amslicer.open_stack(out)]
    again = amslicer.load_job(out / "job.yaml", part=out / "inputs" / "part.stl")
    amslicer.slice_job(again, out, run=amslicer.Run(layers=(30, 32)), overwrite=True)
    assert (out / "inputs" / "part.stl").read_bytes() == job.part.read_bytes()
    assert (out / "inputs" / "v.npy").read_bytes() == (tmp_path / "v.npy").read_bytes()
    for layer, labels in zip(amslicer.open_stack(out), before, strict=True):
        assert np.array_equal(layer.labels, labels)


def test_it_is_in_the_table_of_info(tmp_path: Path, job: amslicer.Job) -> None:
    amslicer.slice_job(job, tmp_path / "out", run=amslicer.Run(layers=(40, 42)))
    shares = {m.name: m.ratio for m in describe_folder(tmp_path / "out").materials}
    assert list(shares) == ["a", "b", "void"]
    assert sum(shares.values()) == pytest.approx(1)


def test_other_fields_must_know_of_it(tmp_path: Path, job: amslicer.Job) -> None:
    amslicer.slice_job(job, tmp_path / "out", run=amslicer.Run(layers=(40, 42)))
    parts.job(job.part, printer=PRINTER, materials=("a", "b"))  # writes part.yaml
    with pytest.raises(JobError, match="the materials are a, b, but the stack has a, b, void"):
        amslicer.verify(tmp_path / "out", fields=tmp_path / "part.yaml")


def test_one_field_is_the_share_of_the_first_of_two_printed_materials(tmp_path: Path) -> None:
    part = parts.box(tmp_path, (6.0, 4.0, 0.08))
    plain = parts.labels(parts.job(part, printer=PRINTER, ratio=0.3))
    three = parts.job(part, printer=PRINTER, ratio=0.3, materials=("rigid", "flexible", "void"))
    assert np.array_equal(parts.labels(three), plain)
    porous = parts.labels(parts.job(part, printer=PRINTER, ratio=0.3, materials=("rigid", "void")))
    assert np.array_equal(porous, np.where(plain == 1, 1, 0))


def test_refused(tmp_path: Path) -> None:
    part = parts.box(tmp_path, (3.0, 3.0, 1.0))
    with pytest.raises(JobError, match="skin of void would print nothing"):
        parts.job(
            part, materials=("a", "void"), sections={"skin": {"material": "void", "thickness_mm": 0.2}},
        )  # fmt: skip
    with pytest.raises(JobError, match=r"(?s)no material 'void'") as raised:
        parts.job(part, sections={"bodies": {"1": {"material": "void"}}})
    assert "list it among the materials" in str(raised.value.hint)
