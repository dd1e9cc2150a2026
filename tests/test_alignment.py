"""Phase alignment: against its dense twin, by what it is for (fewer singularities), and by what it must not change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer import JobError, analysis, reference
from amslicer.device import Device
from amslicer.generator import DeviceGenerator
from amslicer.noise import alignment
from amslicer.noise.kernels import Kernels, join_kernels
from amslicer.pattern import make_noise
from amslicer.pipeline import prepare

COARSE_GRID = {"pitch_um": [100, 100], "layer_um": 100}
AROUND = {"vector": [{"expression": "x - 15"}, {"expression": "y - 15"}, 0]}
LINES = {"expression": "0.5 * atan2(y - 15, x - 15) * 180 / pi"}  # turns by 180° around a point: lines, not arrows
CASES: dict[str, dict[str, Any]] = {
    "straight": {"orientation": 23.0},
    "turning": {"orientation": {"gradient": {"axis": "x", "from": 0, "to": 90}}},
    "around a point": {"orientation": AROUND},
    "lines": {"orientation": LINES},
    "graded period": {"orientation": 10.0, "period": {"gradient": {"axis": "x", "from": 1, "to": 3.5}}},
    "isotropic": {"orientation": 40.0, "isotropy": 1},
    "solid": {"orientation": {"azimuth": 20, "elevation": {"gradient": {"axis": "y", "from": 0, "to": 60}}}},
}


def make(folder: Path, size: tuple[float, float, float], **settings: Any) -> amslicer.Job:
    return parts.job(parts.box(folder, size), **{"printer": COARSE_GRID, "ratio": 0.3, **settings})


def kernels_of(job: amslicer.Job, draw: DeviceGenerator) -> Kernels:
    prepared = prepare(job)
    noise, size = make_noise(job, prepared.painted), prepared.painted.placement.size_mm
    layers = noise.cell_layers(0, size[2])
    return join_kernels([noise.kernels(draw, n, np.zeros(2), size[:2], prepared.painted) for n in layers])


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_phases_are_the_twins(tmp_path: Path, case: dict[str, Any], device: Device) -> None:
    dimensions = 3 if isinstance(case["orientation"], dict) and "elevation" in case["orientation"] else 2
    size = (8.0, 7.0, 5.0) if dimensions == 3 else (30.0, 30.0, 0.1)
    draw = DeviceGenerator(device)
    kernels = kernels_of(make(tmp_path, size, dimensions=dimensions, **case), draw)
    assert 400 < len(kernels) < 3000
    expected = reference.aligned(
        kernels.centre_mm, kernels.wave, np.sqrt(kernels.decay / np.pi), kernels.phase, kernels.normal,
        sweeps=7, dimensions=dimensions,
    )  # fmt: skip
    got = alignment.aligned_phases(kernels, 7, dimensions, draw)
    error = np.abs(np.exp(1j * got) - np.exp(1j * expected))
    print(f"largest {error.max():.1e}, middle {np.median(error):.1e}")
    # float32; kernels that differ much in width overlap by little, and are left out where more than an octave apart.
    assert np.quantile(error, 0.99) < (0.1 if "period" in case else 1e-4)
    assert np.median(error) < (0.02 if "period" in case else 1e-5)
    np.testing.assert_array_equal(alignment.aligned_phases(kernels, 0, dimensions, draw), kernels.phase)


def singularities(g: NDArray[np.complex64]) -> float:
    """Per period²; pixels are a tenth of a period."""
    return analysis.singularities(g) / (g.size / 100)


@pytest.mark.parametrize(
    ("case", "sweeps", "most"), [("straight", 100, 0.015), ("straight", 5, 0.015), ("around a point", 100, 0.02)]
)
def test_singularities_of_flat_laminates_vanish(tmp_path: Path, case: str, sweeps: int, most: float) -> None:
    before, after = (
        np.mean([singularities(amslicer.field(make(tmp_path, (30, 30, 0.1), seed=seed, alignment=n, **CASES[case]), 0))
                 for seed in (1, 2, 3)])
        for n in (0, sweeps)
    )  # fmt: skip
    print(f"{case}: {before:.4f} -> {after:.4f} per period² in {sweeps} sweeps")
    assert before >= 0.10  # theory: b²/2 = 0.125 of a straight one
    assert after <= most


def test_singularities_of_solid_laminates_vanish(tmp_path: Path) -> None:
    case = {"orientation": {"azimuth": 23, "elevation": 30}, "dimensions": 3}
    before, after = (
        singularities(amslicer.field(make(tmp_path, (20, 20, 12), alignment=n, **case), 60)) for n in (0, 20)
    )
    print(f"{before:.4f} -> {after:.4f} per period² of a cut")
    assert before >= 0.10
    assert after <= 0.01


def test_a_turning_laminate_keeps_the_singularities_that_geometry_asks_for(tmp_path: Path) -> None:
    """|curl k|/2π of them: cos θ dθ/dx/p where k = (2π/p)(cos θ, sin θ), θ from 0 to 90° along x."""
    job = make(tmp_path, (40, 40, 0.1), alignment=50, **CASES["turning"])
    assert singularities(amslicer.field(job, 0)) == pytest.approx(1 / 40, rel=0.2)


@pytest.mark.parametrize("case", ["straight", "turning", "around a point"])
def test_the_ratio_stays(tmp_path: Path, case: str) -> None:
    errors, scatter = [], {0: [], 40: []}
    for seed in range(1, 5):
        for sweeps, windows in scatter.items():
            g = amslicer.field(make(tmp_path, (40, 40, 0.1), seed=seed, alignment=sweeps, **CASES[case]), 0)
            first = np.abs(np.angle(g)) < 0.3 * np.pi
            windows.append(first.reshape(8, 50, 8, 50).mean(axis=(1, 3)) - 0.3)
            if sweeps:
                errors.append(first.mean() - 0.3)
    before, after = (float(np.std(np.concatenate(scatter[n]))) for n in (0, 40))
    print(f"{case}: ratio {np.mean(errors):+.4f}, windows of 5 periods {before:.4f} -> {after:.4f}")
    assert abs(np.mean(errors)) <= 0.003
    if case == "straight":
        assert after <= 0.6 * before


@pytest.mark.parametrize("evaluate", ["lattice", "exact"])
def test_nothing_about_the_run_changes_a_byte(tmp_path: Path, evaluate: str) -> None:
    settings = {"alignment": 3, "dimensions": 3, "printer": {"dpi": 300, "layer_um": 60}, "evaluate": evaluate}
    job = make(tmp_path, (9, 7, 5), orientation={"azimuth": 20, "elevation": 50}, **settings)
    whole = parts.labels(job)
    for first, end in ((0, 1), (20, 41), (82, 84)):
        np.testing.assert_array_equal(parts.labels(job, first, end), whole[first:end])
    single = np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1))])
    np.testing.assert_array_equal(single, whole)
    assert np.any(parts.labels(make(tmp_path, (9, 7, 5), **{**settings, "alignment": 0})) != whole)


def test_tiles_do_not_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = make(tmp_path, (23, 19, 0.3), orientation=20, alignment=3, evaluate="exact")
    before = amslicer.field(job, 0)
    monkeypatch.setattr("amslicer.tiles.TILE_PIXELS", (8,))
    after = amslicer.field(job, 0)
    assert np.abs(after - before).max() < 1e-4 * np.abs(before).max()


def test_an_aligned_stack_is_verified(tmp_path: Path) -> None:
    for seed in range(1, 4):
        for angle in (0, 20, 45):
            job = make(tmp_path, (24, 20, 0.1), orientation=angle, period=0.983, alignment=20, seed=seed)
            amslicer.slice_job(job, tmp_path / "out", overwrite=True)
            report = amslicer.verify(tmp_path / "out")
            assert report.ok, (seed, angle, [c for c in report.checks if not c.ok])


def test_a_locked_grating_is_noted(tmp_path: Path) -> None:
    """Ten pixels a period, along x: without a wander of their own all sheets are rounded alike."""
    notes = {
        angle: [n for n in prepare(make(tmp_path, (30, 20, 0.1), ratio=0.25, orientation=angle, alignment=20)).notes()
                if "rounded alike" in n]
        for angle in (0, 20)
    }  # fmt: skip
    assert notes[0]
    assert not notes[20]


def test_too_many_kernels_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alignment, "MAX_KERNELS", 100)
    with pytest.raises(JobError, match=r"pattern.alignment: the part has \d+ kernels; at most 100"):
        parts.labels(make(tmp_path, (20, 20, 0.1), alignment=1))
