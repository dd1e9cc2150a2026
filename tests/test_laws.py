"""Laws that hold for any job and any part: partition, bytes that nothing but the job changes, mistakes refused."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import meshes
import numpy as np
import pytest
import strategies
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from meshes import Solid
from PIL import Image

import amslicer
from amslicer import Job, JobError, Run
from amslicer.pipeline import prepare


def examples(count: int) -> settings:
    """The same few examples every time: a law is not a search. Nor is one shrunk that breaks it: that takes minutes."""
    phases = [Phase.explicit, Phase.generate]
    return settings(max_examples=count, derandomize=True, deadline=None, database=None, phases=phases)


@contextmanager
def workshop() -> Iterator[Path]:
    """A folder with the pictures that generated jobs name."""
    with tempfile.TemporaryDirectory() as name:
        strategies.write_pictures(Path(name))
        yield Path(name)


def load(folder: Path, content: dict[str, Any], solid: Solid | None = None) -> Job:
    file, part = folder / "fields.yaml", folder / "part.stl"
    text = json.dumps(content).replace("NaN", ".nan").replace("Infinity", ".inf")  # else JSON is YAML
    file.write_text(text, encoding="utf-8")
    if solid:
        part.write_bytes(meshes.binary_stl(solid))
    return amslicer.load_job(file, part)


def hashes(folder: Path, job: Job, run: Run) -> dict[int, dict[str, str]]:
    """What the manifest says of each written layer."""
    amslicer.slice_job(job, folder, run=run)
    layers = json.loads((folder / "manifest.json").read_text())["layers"]
    return {layer["index"]: layer["sha256"] for layer in layers}


@examples(30)
@given(strategies.jobs(), strategies.solids())
def test_every_solid_pixel_has_one_material_and_no_other_pixel_any(content: dict[str, Any], solid: Solid) -> None:
    """The written bitmaps, read by Pillow, against the mask."""
    with workshop() as folder:
        job = load(folder, content, solid)
        amslicer.slice_job(job, folder / "out")
        prepared = prepare(job)
        mask = prepared.slicer.runs(0, prepared.grid.layers).solid()[:, ::-1]
        margin = prepared.grid.margin_px
        inside = np.pad(mask, ((0, 0), (margin, margin), (margin, margin)))
        for layer, expected in enumerate(inside):
            bitmaps = [np.asarray(Image.open(folder / "out" / m / f"{layer:05d}.png")) for m in job.materials]
            np.testing.assert_array_equal(np.sum(bitmaps, axis=0), expected)
        report = amslicer.verify(folder / "out")
        assert report.ok, [problem for check in report.checks for problem in check.problems]


@examples(15)
@given(strategies.jobs(), strategies.solids(), st.data())
def test_nothing_about_the_run_changes_a_byte(content: dict[str, Any], solid: Solid, data: st.DataObject) -> None:
    """Threads, cuts into ranges of layers, and the order in which they are made."""
    with workshop() as folder:
        job = load(folder, content, solid)
        whole = hashes(folder / "whole", job, Run(jobs=1))
        cuts = data.draw(st.lists(st.integers(1, max(1, len(whole) - 1)), max_size=2, unique=True).map(sorted))
        bounds = [0, *(cut for cut in cuts if cut < len(whole)), len(whole)]
        ranges = data.draw(st.permutations(list(pairwise(bounds))))
        found: dict[int, dict[str, str]] = {}
        for first, end in ranges:
            found |= hashes(folder / f"from-{first}", job, Run(jobs=2, layers=(first, end)))
        assert found == whole


@examples(15)
@given(strategies.jobs(), strategies.solids(), strategies.MOVES)
def test_moving_the_part_changes_no_byte(content: dict[str, Any], solid: Solid, move: tuple[int, int, int]) -> None:
    """What is stretched over the part moves with it; only boxes in mm stay where they are."""
    with workshop() as folder:
        content = _over_the_box(content)
        moved = meshes.moved(solid, tuple(float(v) for v in move))
        np.testing.assert_array_equal(moved[0].astype(np.float32), moved[0])
        here = hashes(folder / "here", load(folder, content, solid), Run())
        there = hashes(folder / "there", load(folder, content, moved), Run())
        assert here == there


def _over_the_box(content: Any) -> Any:
    """The same content, no place in mm: all fields are stretched over the part's box."""
    if isinstance(content, list):
        return [_over_the_box(item) for item in content]
    if not isinstance(content, dict):
        return content
    kept = {key: _over_the_box(value) for key, value in content.items() if key not in ("box", "start", "end")}
    if "center" in kept:
        return {"axis": "x", "from": kept["from"], "to": kept["to"]}
    if "expression" in kept:
        shares = {"x": "u", "y": "v", "z": "w"}
        kept["expression"] = re.sub(r"\b[xyz]\b", lambda name: shares[name[0]], kept["expression"])
    return kept


@examples(60)
@given(strategies.jobs())
def test_the_resolved_job_is_the_same_job(content: dict[str, Any]) -> None:
    with workshop() as folder:
        job = load(folder, content)
        again = load(folder, job.resolved())
        assert again.spec == job.spec
        assert again.resolved() == job.resolved()
        assert again.digest("part", "device", "version") == job.digest("part", "device", "version")


@examples(15)
@given(strategies.jobs(), strategies.solids())
def test_the_written_job_makes_the_same_stack(content: dict[str, Any], solid: Solid) -> None:
    with workshop() as folder:
        first = hashes(folder / "first", load(folder, content, solid), Run())
        job = amslicer.load_job(folder / "first" / "job.yaml", folder / "part.stl")
        assert hashes(folder / "second", job, Run()) == first
        files = [(folder / name / "manifest.json").read_bytes() for name in ("first", "second")]
        assert files[0] == files[1]


@examples(300)
@given(strategies.mistakes())
def test_one_mistake_is_refused_by_its_name(mistake: tuple[dict[str, Any], strategies.KeyPath, str]) -> None:
    content, path, kind = mistake
    with workshop() as folder, pytest.raises(JobError) as caught:
        load(folder, content)
    key = str(path[-1])
    above = ".".join(str(step) for step in path[:-1])
    told = str(caught.value)
    assert "fields.yaml" in told
    assert key in told or (above and above in told), f"{kind} of {'.'.join(map(str, path))}"
