"""The example jobs of configs/examples: each loads, and its fields mean what its comments say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import pytest
from numpy.typing import NDArray

from amslicer import Job, load_job
from amslicer.errors import JobError
from amslicer.fields import Frame, open_field, open_orientation
from amslicer.fields.materialmap import MaterialMap
from amslicer.fields.source import Inputs, Part
from amslicer.mesh import read_mesh
from amslicer.meshfiles import READERS
from amslicer.pipeline import prepare
from amslicer.placement import place

Floats = NDArray[np.float64]

EXAMPLES = Path(__file__).parents[1] / "configs" / "examples"
# A part around the file's origin, as most are drawn.
FRAME = Frame(np.array([-10.0, -10.0, 0.0]), np.array([20.0, 20.0, 5.0]))


def example(name: str) -> Job:
    return load_job(EXAMPLES / f"{name}.yaml", part="part.stl")


def at(spec: Any, job: Job, *places: tuple[float, float, float]) -> list[float]:
    """Values at places of the file."""
    points = np.array(places, np.float64) - FRAME.minimum_mm
    field = open_field(spec, FRAME, Inputs(job.inputs.folder))
    return np.broadcast_to(field.scalar(*points.T), len(points)).tolist()


def part_of(example: Path, folder: Path) -> Path:
    """The part that an example brings, or a box around the file's origin."""
    own = [file for suffix in READERS for file in [example.with_suffix(f".{suffix}")] if file.is_file()]
    if own:
        return own[0]
    part = folder / "part.stl"
    part.write_bytes(meshes.binary_stl(meshes.box((20.0, 20.0, 5.0), (-10.0, -10.0, 0.0))))
    return part


def test_there_is_an_example_of_each() -> None:
    assert {file.stem for file in EXAMPLES.glob("*.yaml")} >= {
        "cells", "expression", "grain", "planes", "radial", "texture", "waves",
    }  # fmt: skip


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_example_loads_and_opens(file: Path, tmp_path: Path) -> None:
    job = load_job(file, part=part_of(file, tmp_path))
    assert list(job.sources())
    mesh = read_mesh(job.part)
    placement, _ = place(mesh)
    frame = Frame(mesh.minimum_mm, mesh.size_mm, placement, lambda: Part(job.part, mesh))
    points = np.random.default_rng(0).uniform(0, 1, (500, 3)) * mesh.size_mm
    for source in job.sources():
        if isinstance(source, MaterialMap):  # shares of all materials: looked at below
            continue
        try:
            sampler = open_field(source, frame, job.inputs)
        except JobError:  # a source of directions alone
            normals = open_orientation(source, frame, job.inputs).normals(*points.T)
            np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
            assert np.ptp(normals, axis=0).max() > 0.1
            continue
        found = np.broadcast_to(sampler.scalar(*points.T), 500)
        assert np.isfinite(found).all()
        assert sampler.bounds[0] <= found.min() < found.max() <= sampler.bounds[1]
    prepared = prepare(job)
    for layer in {0, prepared.grid.layers // 2, prepared.grid.layers - 1}:
        ratio = prepared.painted.ratio_map(prepared.grid, layer)
        assert 0 <= ratio.min() <= ratio.max() <= 1


def test_expression() -> None:
    job = example("expression")
    fields: Any = job.spec.fields
    assert at(fields.ratio, job, (-5, 3, 1), (0, 0, 0), (5, -2, 4)) == pytest.approx([0.1, 0.5, 0.9])
    around = at(fields.orientation.azimuth, job, (5, 0, 0), (5, 5, 1), (0, 5, 2), (-5, 5, 3), (5, -5, 4))
    assert around == pytest.approx([0, 45, 90, 135, -45])
    assert at(fields.orientation.elevation, job, (1, 2, 0), (1, 2, 2.5), (1, 2, 5)) == pytest.approx([0, 20, 60])


def test_radial() -> None:
    job = example("radial")
    fields: Any = job.spec.fields
    assert at(fields.ratio, job, (0, 0, 0), (4, 0, 0), (0, 0, 4), (8, 0, 0), (9, 9, 5)) == pytest.approx(
        [0.15, 0.5, 0.5, 0.85, 0.85]
    )
    assert at(fields.orientation, job, (0, 0, 5), (3, 4, 0), (3, 4, 5), (0, -10, 1)) == pytest.approx([0, 45, 45, 90])


def test_planes() -> None:
    """side.png is 0 … 255 from left to right in its top row, and black in its bottom row."""
    job = example("planes")
    fields: Any = job.spec.fields
    left, right = (-9.999, 0, 4.999), (9.999, 0, 4.999)
    assert at(fields.ratio, job, left, right, (9.999, 7, 0.001)) == pytest.approx([0.2, 0.8, 0.2])
    angles = at(fields.orientation, job, (3, -9.999, 4.999), (3, 9.999, 4.999), (3, 9.999, 0.001), (3, 0, 5))
    assert angles == pytest.approx([-45, 45, -45, 0])


def test_texture() -> None:
    job = example("texture")
    fields: Any = job.spec.fields
    ratio = open_field(fields.ratio, FRAME, Inputs(job.inputs.folder))
    orientation = open_field(fields.orientation, FRAME, Inputs(job.inputs.folder))
    assert ratio.bounds == pytest.approx((0.1, 0.7))
    assert orientation.bounds == pytest.approx((6, 54))
    assert ratio.varies == (True, True, False)
    assert orientation.varies == (True, True, True)
    points = np.random.default_rng(0).uniform(0, 1, (5000, 3)) * FRAME.size_mm
    for sampler, mean, spread in ((ratio, 0.4, 0.1), (orientation, 30, 8)):
        found = sampler.scalar(*points.T)
        assert found.mean() == pytest.approx(mean, abs=0.25 * spread)
        assert found.std() == pytest.approx(spread, rel=0.2)


def test_profiles() -> None:
    profile: Any = example("profiles").spec.pattern.profile
    first, second = profile.waves()
    turn = np.linspace(0, 1, 9)
    np.testing.assert_allclose(first(turn), np.cos(2 * np.pi * turn))
    np.testing.assert_allclose(second(turn), 0.4 * np.cos(2 * np.pi * turn) + np.cos(4 * np.pi * turn), atol=1e-12)
    assert at(profile.blend.by, example("profiles"), (-10, 0, 0), (0, 0, 0), (10, 0, 0)) == [0, 0.5, 1]
