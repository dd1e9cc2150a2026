"""Meshes as users bring them, through the public functions: sliced to the volume that is known, or refused."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import parts
import pytest

import amslicer
from amslicer import AmslicerError, JobError, PartError

DATA = os.environ.get("AMSLICER_TEST_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="AMSLICER_TEST_DATA is not set")

# Half a pixel all over the surface is the bound, 2 to 23 % here; on all sides together most of it cancels.
VOLUME_SHARE = 0.005


@dataclass(frozen=True)
class Solid:
    """A file that slices.

    Attributes:
        volume_mm3: of what is solid, overlaps counted once, as the data folder's README says.
        pitch_mm: of pixels and layers; a whole number of them is as high as the plates.
        noted: what a note must say; None: nothing may be noted.
    """

    name: str
    volume_mm3: float
    pitch_mm: float
    noted: str | None = None


SOLIDS = (
    Solid("featuretype.STL", 11.628, 0.05),
    Solid("plate_holes.STL", 767_400, 0.508),
    Solid("pyramids.3mf", 195_000, 1.0),
    Solid("torus.3mf", 776.8, 0.1),
    Solid("negative_indices.obj", 8, 0.1),
    Solid("two_objects.obj", 1.0, 0.05, "the largest side is 1 mm"),
    Solid("shared.STL", 2.0, 0.05),
    Solid("Globo.3mf", 60_960, 0.5, "overlapping bodies count once"),
    Solid("large_block_obb.STL", math.nan, 10.0, "the largest side is"),
)
REFUSED: tuple[tuple[str, type[AmslicerError], tuple[str, ...]], ...] = (
    ("2ProductionBoxes.3mf", PartError, ("open edges", "of 25 triangles")),
    ("sphere_sliced.3mf", PartError, ("3MF extension slice",)),
    ("multibody.stl", PartError, ("body 0 of 2", "inside out")),
    ("sphereWithHole.stl", PartError, ("9 open edges", "between z = ")),
    ("soup.stl", PartError, ("open edges", "of 100 triangles")),
    ("large_block_obb.STL", JobError, ("the job is too large",)),
    ("stl_empty_bin.stl", PartError, ("no triangles",)),
)


def mesh_file(name: str) -> Path:
    return Path(DATA or "") / "meshes" / name


def job_of(name: str, pitch_mm: float, **settings: bool) -> amslicer.Job:
    content = {
        "materials": ["rigid", "flexible"],
        "printer": {"pitch_um": 1000 * pitch_mm, "layer_um": 1000 * pitch_mm},
        "part": settings,
        "pattern": {"period": 6 * pitch_mm},
        "fields": {"ratio": {"gradient": {"axis": "x", "from": 0.3, "to": 0.7}}},
    }
    return amslicer.load_job(content, part=mesh_file(name))


def test_every_file_is_in_the_table() -> None:
    named = {solid.name for solid in SOLIDS} | {name for name, _, _ in REFUSED}
    assert named == {file.name for file in mesh_file("").iterdir()}


@pytest.mark.parametrize("solid", SOLIDS, ids=[solid.name for solid in SOLIDS])
def test_slices_to_its_volume(tmp_path: Path, solid: Solid) -> None:
    result = amslicer.slice_job(job_of(solid.name, solid.pitch_mm), tmp_path / "out")
    volume_mm3 = result.solid_pixels * solid.pitch_mm**3
    print(solid.name, volume_mm3, result.notes)
    if math.isfinite(solid.volume_mm3):
        assert volume_mm3 == pytest.approx(solid.volume_mm3, rel=VOLUME_SHARE)
    else:
        assert result.solid_pixels > 0
    odd = [note for note in result.notes if " the bed: " not in note]
    assert (solid.noted is None) == (not odd), odd
    assert solid.noted is None or any(solid.noted in note for note in odd)
    assert amslicer.verify(tmp_path / "out").ok


def test_cubes_that_share_an_edge_have_two_square_units_in_every_layer() -> None:
    for layer in amslicer.layers(job_of("shared.STL", 1 / 32)):
        assert np.count_nonzero(layer.labels) == 2 * 32**2


@pytest.mark.parametrize(("name", "kind", "said"), REFUSED, ids=[name for name, _, _ in REFUSED])
def test_is_refused(tmp_path: Path, name: str, kind: type[AmslicerError], said: tuple[str, ...]) -> None:
    with pytest.raises(kind) as caught:
        amslicer.slice_job(job_of(name, 25.4 / 600), tmp_path / "out")
    assert [word for word in said if word not in caught.value.message] == []
    assert caught.value.hint
    assert not (tmp_path / "out").exists()


def test_a_hole_may_be_allowed(tmp_path: Path) -> None:
    """A sphere of radius 1.5 mm (by its size) without a few triangles at the bottom: almost all of it is left."""
    pitch_mm = 0.02
    job = job_of("sphereWithHole.stl", pitch_mm, allow_open=True)
    result = amslicer.slice_job(job, tmp_path / "out")
    (note,) = [note for note in result.notes if "open" in note]
    assert "9 open edges around 1 hole)" in note
    assert "stay empty" in note
    assert result.solid_pixels * pitch_mm**3 == pytest.approx(4 / 3 * math.pi * 1.5**3, rel=0.05)
    assert amslicer.verify(tmp_path / "out").ok


@pytest.mark.parametrize("name", ["tiles_line.png", "gradient_line.png"])
def test_painted_lines_slice(tmp_path: Path, name: str) -> None:
    """The pictures lie outside the job file's folder, which has to be allowed."""
    file = tmp_path / "fields.yaml"
    picture = Path(DATA or "") / "fields" / name
    file.write_text(
        "materials: [rigid, flexible]\nprinter: {pitch_um: 200, layer_um: 200}\npattern: {dimensions: 2}\n"
        f"fields: {{ratio: 0.5, orientation: {{image: '{picture}', range: [-90, 90]}}}}\n"
    )
    part = parts.box(tmp_path, (20.0, 20.0, 0.3))
    with pytest.raises(JobError, match="outside") as caught:
        amslicer.slice_job(amslicer.load_job(file, part), tmp_path / "out")
    assert "--allow-outside" in str(caught.value.hint)
    amslicer.slice_job(amslicer.load_job(file, part, allow_outside=True), tmp_path / "out")
    assert amslicer.verify(tmp_path / "out").ok
