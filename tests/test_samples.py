"""The samples are what their script makes, what their page says, and closed solids."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import manifold3d
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from amslicer import Job, load_job
from amslicer.pipeline import prepare

SAMPLES = Path(__file__).parents[1] / "samples"
PARTS = ("cross_plate", "insole")
PICTURES = (
    "cross_plate/ratio.png", "cross_plate/orientation.png", "cross_plate/isotropy.png",
    "insole/ratio.png", "insole/azimuth.png",
)  # fmt: skip
STEP_MM = 1e-4
"""Far below a pixel; cos and exp of two C libraries differ by 1e-14 mm, which float32 STL may round to 1e-5 mm."""
LEVELS = 1
"""A value on the border between two grey levels may fall on either side with another C library."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The samples, made anew."""
    out = tmp_path_factory.mktemp("samples")
    subprocess.run(
        [sys.executable, SAMPLES / "make_samples.py", "--out", out], check=True, capture_output=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    return out


def soup(file: Path) -> trimesh.Trimesh:
    mesh = trimesh.load_mesh(file)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def pixels(file: Path) -> NDArray[np.int64]:
    with Image.open(file) as picture:
        return np.asarray(picture).astype(np.int64)


def sample_job(name: str, folder: Path = SAMPLES) -> Job:
    return load_job(folder / name / "fields.yaml", part=folder / name / f"{name}.stl")


def test_the_script_makes_these_files_and_no_others(made: Path) -> None:
    def names(folder: Path) -> set[str]:
        return {str(f.relative_to(folder)) for part in PARTS for f in (folder / part).rglob("*")}

    pictures = {f"{part}/laminate.png" for part in PARTS}  # made by make_pictures.py, with amslicer itself
    assert names(made) == names(SAMPLES) - pictures
    assert sorted(f.name for f in made.iterdir()) == sorted(PARTS)


@pytest.mark.parametrize("name", PARTS)
def test_the_job_files_are_made_again(made: Path, name: str) -> None:
    assert (made / name / "fields.yaml").read_bytes() == (SAMPLES / name / "fields.yaml").read_bytes()


@pytest.mark.parametrize("file", PICTURES)
def test_the_pictures_are_made_again(made: Path, file: str) -> None:
    new, committed = pixels(made / file), pixels(SAMPLES / file)
    assert new.shape == committed.shape
    assert np.abs(new - committed).max() <= LEVELS
    assert (made / file).read_bytes()[:26] == (SAMPLES / file).read_bytes()[:26]  # size, bits and colour type


@pytest.mark.parametrize("name", PARTS)
def test_the_parts_are_made_again(made: Path, name: str) -> None:
    new, committed = (soup(folder / name / f"{name}.stl") for folder in (made, SAMPLES))
    assert len(new.faces) == len(committed.faces)
    np.testing.assert_allclose(new.bounds, committed.bounds, rtol=0, atol=STEP_MM)
    assert new.volume == pytest.approx(committed.volume, rel=1e-5)
    for some, others in ((new, committed), (committed, new)):
        assert cKDTree(others.vertices).query(some.vertices)[0].max() <= STEP_MM


@pytest.mark.parametrize("name", PARTS)
def test_the_parts_are_closed(name: str) -> None:
    mesh = soup(SAMPLES / name / f"{name}.stl")
    solid = manifold3d.Manifold(
        manifold3d.Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    )
    assert solid.status() == manifold3d.Error.NoError
    assert len(solid.decompose()) == 1
    assert solid.volume() == pytest.approx(mesh.volume, rel=1e-5)
    assert solid.volume() > 0


@pytest.mark.parametrize(
    ("name", "size_mm", "within_mm"),
    [
        ("cross_plate", (60.0, 60.0, 3.0), 1e-4),  # a CAD shape
        ("insole", (120.0, 45.0, 12.0), 0.75),  # a foot, in whole millimetres
    ],
)
def test_sizes_are_those_of_the_page(name: str, size_mm: tuple[float, float, float], within_mm: float) -> None:
    np.testing.assert_allclose(soup(SAMPLES / name / f"{name}.stl").extents, size_mm, rtol=0, atol=within_mm)


def test_the_plates_volume_is_that_of_a_rounded_cross() -> None:
    """Two bars of 60 x 18 mm, 8 outer corners rounded by 2.5 mm, 4 inner corners filled by 6 mm; 3 mm thick."""
    corner = 1 - np.pi / 4  # area that a quarter circle leaves of its square
    area = 2 * 60 * 18 - 18**2 - 8 * corner * 2.5**2 + 4 * corner * 6.0**2
    # 16 chords per quarter: each loses or adds about r² angle³ / 12.
    chords = 16 * (np.pi / 32) ** 3 / 12 * (8 * 2.5**2 + 4 * 6.0**2)
    volume = soup(SAMPLES / "cross_plate" / "cross_plate.stl").volume
    assert abs(volume - 3 * area) <= 3 * chords * 1.1


def test_the_insole_is_3_to_8_mm_thick() -> None:
    mesh = soup(SAMPLES / "insole" / "insole.stl")
    low, high = mesh.bounds
    rng = np.random.default_rng(3)
    starts = np.column_stack([rng.uniform(low[i], high[i], 400) for i in (0, 1)] + [np.full(400, low[2] - 1)])
    triangles = mesh.triangles
    thickness = []
    for x, y, _ in starts:
        heights = crossings(triangles, x, y)
        if len(heights) == 2:
            thickness.append(heights[1] - heights[0])
    assert len(thickness) > 200
    assert min(thickness) == pytest.approx(3.0, abs=0.1)
    assert 7.0 <= max(thickness) <= 8.0


def crossings(triangles: NDArray[np.float64], x: float, y: float) -> NDArray[np.float64]:
    """Heights at which an upright line meets the triangles."""
    a, b, c = (triangles[:, i] for i in range(3))
    e, f, to = (b - a)[:, :2], (c - a)[:, :2], np.array([x, y]) - a[:, :2]
    area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    upright = np.abs(area) < 1e-12
    area = np.where(upright, 1.0, area)
    u = (to[:, 0] * f[:, 1] - to[:, 1] * f[:, 0]) / area
    v = (e[:, 0] * to[:, 1] - e[:, 1] * to[:, 0]) / area
    hit = ~upright & (u >= 0) & (v >= 0) & (u + v <= 1)
    heights = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
    return np.unique(np.round(heights[hit], 9))


@pytest.mark.parametrize(
    ("file", "bits", "white", "black", "low", "high"),
    [
        ("cross_plate/ratio.png", 16, 0.80, 0.15, 0.15, 0.79),
        ("cross_plate/orientation.png", 8, 90.0, -90.0, -87.0, 74.0),
        ("cross_plate/isotropy.png", 8, 0.9, 0.0, 0.0, 0.9),
        ("insole/ratio.png", 16, 0.75, 0.15, 0.15, 0.75),
        ("insole/azimuth.png", 8, 90.0, -90.0, -78.0, 69.0),
    ],
)
def test_the_pictures_paint_what_the_page_says(
    file: str, bits: int, white: float, black: float, low: float, high: float
) -> None:
    part = Path(file).parent.name
    grey = pixels(SAMPLES / file)
    if part == "insole":  # its corners lie outside the foot: what its vertices see
        mesh = soup(SAMPLES / part / f"{part}.stl")
        share = (mesh.vertices - mesh.bounds[0])[:, :2] / mesh.extents[:2]
        rows, columns = grey.shape
        row = np.clip((1 - share[:, 1]) * rows, 0, rows - 1).astype(int)
        grey = grey[row, np.clip(share[:, 0] * columns, 0, columns - 1).astype(int)]
    values = black + grey / (2**bits - 1) * (white - black)
    last_digit = 0.01 if high < 1 else 1.0
    assert values.min() == pytest.approx(low, abs=last_digit)
    assert values.max() == pytest.approx(high, abs=last_digit)


def test_the_plates_job() -> None:
    assert sample_job("cross_plate").resolved() | {"printer": None} == {
        "printer": None,
        "part": {"scale": 1.0, "rotate": [0.0, 0.0, 0.0], "on_bed": True, "allow_open": False},
        "materials": [
            {"name": "rigid", "color": "#2b6cb0", "density_g_cm3": 1.18},
            {"name": "flexible", "color": "#f6ad55", "density_g_cm3": 1.12},
        ],
        "pattern": {
            "noise": "phasor", "dimensions": 2, "period": 1.0, "bandwidth": 0.5, "alignment": 0, "lobes": [],
            "planes": ["xy"], "spectrum": "laminate", "time": 0.0, "fourth": 0.0,
            "evaluate": "lattice", "profile": "pwm", "edges": "sharp", "seed": 1,
        },
        "fields": {
            "ratio": {"image": "ratio.png", "range": [0.15, 0.8], "plane": "xy"},
            "orientation": {"image": "orientation.png", "range": [-90.0, 90.0], "plane": "xy"},
            "isotropy": {"image": "isotropy.png", "range": [0.0, 0.9], "plane": "xy"},
        },
        "output": {"format": "png", "compression": "fast"},
    }  # fmt: skip


def test_the_insoles_fields() -> None:
    resolved = sample_job("insole").resolved()
    assert resolved["pattern"]["dimensions"] == 3
    assert resolved["fields"] == {
        "ratio": {"image": "ratio.png", "range": [0.15, 0.75], "plane": "xy"},
        "orientation": {
            "azimuth": {"image": "azimuth.png", "range": [-90.0, 90.0], "plane": "xy"},
            "elevation": {"gradient": {"axis": "x", "from": 20.0, "to": 70.0}},
        },
        "isotropy": 0.0,
    }


def test_the_plate_at_its_printer() -> None:
    """3 mm are 111.1 layers of 0.027 mm, 60 mm are 1417.3 pixels at 600 dpi."""
    prepared = prepare(sample_job("cross_plate"))
    assert prepared.notes() == []
    assert (prepared.grid.width_px, prepared.grid.height_px, prepared.grid.layers) == (1418, 1418, 112)


def test_the_insole_at_its_printer() -> None:
    """Nothing to remark but the way to the bed: its heel and toe are rolled up."""
    prepared = prepare(sample_job("insole"))
    assert [note for note in prepared.notes() if "bed" not in note] == []
