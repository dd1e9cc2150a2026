"""Every noise: the same field as its NumPy twin, its ratio, its lattice, its bytes, its stacks verified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

import amslicer
from amslicer.noise import NOISES
from amslicer.pipeline import prepare

FEW = 160  # directions by example in space: four times as fast as the default
COARSE = {"pitch_um": 100, "layer_um": 100}


def make(folder: Path, size: tuple[float, float, float], noise: str, dimensions: int, **settings: Any) -> amslicer.Job:
    defaults: dict[str, Any] = {"printer": COARSE, "ratio": 0.3, "orientation": 23}
    if noise == "wave-by-example" and dimensions == 3:
        defaults["directions"] = FEW
    return parts.job(parts.box(folder, size), **{**defaults, "noise": noise, "dimensions": dimensions, **settings})


@pytest.mark.parametrize("noise", list(NOISES))
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("bandwidth", [0.3, 0.5, 1.0])
def test_the_field_is_the_twins(tmp_path: Path, noise: str, dimensions: int, bandwidth: float) -> None:
    job = make(tmp_path, (4, 3, 1), noise, dimensions, seed=5, bandwidth=bandwidth, period=0.9)
    grid, layer = prepare(job).grid, 6
    got = amslicer.field(job, layer)
    given: dict[str, Any] = {}
    if "exemplar" in NOISES[noise].keys:
        given = {"exemplar": parts.picture(parts.grain()) / 255, **parts.EXEMPLAR}
    if noise == "wave-by-example" and dimensions == 3:
        given["directions"] = FEW
    expected = amslicer.noise.sample(
        noise, grid.x_mm()[None, :], grid.y_mm()[::-1, None], grid.z_mm(layer), period=0.9, orientation=23, seed=5,
        bandwidth=bandwidth, dimensions=dimensions, **given,
    )  # fmt: skip
    assert got.shape == expected.shape
    # The device interpolates envelopes from tables.
    assert np.sqrt(np.mean(np.abs(got - expected) ** 2)) < 2e-4 * np.sqrt(np.mean(np.abs(expected) ** 2))


@pytest.mark.parametrize("noise", list(NOISES))
@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_ratio(tmp_path: Path, noise: str, dimensions: int, ratio: float) -> None:
    size = (100, 100, 0.1) if dimensions == 2 else (24, 24, 6)
    settings: dict[str, Any] = {}
    if noise.startswith("wave-") and noise != "wave-by-example":  # of cells, shares of small parts scatter
        size = (400, 400, 0.25) if dimensions == 2 else (110, 110, 60)
        settings = {"printer": {"pitch_um": 250, "layer_um": 250}}
    labels = parts.labels(make(tmp_path, size, noise, dimensions, ratio=ratio, **settings))
    share = float(np.mean(labels[labels > 0] == 1))
    print(f"{noise} in {dimensions}D: {share:.4f} of {ratio}")
    assert share == pytest.approx(ratio, abs=0.01)


@pytest.mark.parametrize("noise", [name for name in NOISES if parts.noise(name).band is not None])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_lattice_changes_few_pixels(tmp_path: Path, noise: str, dimensions: int) -> None:
    printer = {"dpi": 600, "layer_um": 27}
    labels = [
        parts.labels(make(tmp_path, (20, 16, 1.2), noise, dimensions, printer=printer, evaluate=how), 20, 22)
        for how in ("lattice", "exact")
    ]
    changed = np.mean(labels[0] != labels[1])
    print(f"{noise} in {dimensions}D: {100 * changed:.4f} % differ")
    assert changed <= 5e-4


@pytest.mark.parametrize("noise", list(NOISES))
@pytest.mark.parametrize("evaluate", ["lattice", "exact"])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_nothing_about_the_run_changes_a_byte(tmp_path: Path, noise: str, dimensions: int, evaluate: str) -> None:
    ratio = {"a": {"gradient": {"axis": "x", "from": 0, "to": 0.6}}, "b": 0.3, "c": "rest"}
    job = make(
        tmp_path, (9, 7, 2), noise, dimensions, printer={"dpi": 600, "layer_um": 40}, ratio=ratio,
        materials=("a", "b", "c"), evaluate=evaluate,
    )  # fmt: skip
    whole = parts.labels(job)
    assert {1, 2, 3} <= set(np.unique(whole))
    np.testing.assert_array_equal(parts.labels(job, 17, 19), whole[17:19])
    single = np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1))])
    np.testing.assert_array_equal(single, whole)


@pytest.mark.parametrize("noise", list(NOISES))
def test_stacks_are_verified(tmp_path: Path, noise: str) -> None:
    for dimensions, size in ((2, (40, 30, 0.2)), (3, (16, 12, 8))):
        for seed in (1, 2, 3) if parts.noise(noise).directed else (1,):  # twenty times as slow
            job = make(tmp_path, size, noise, dimensions, seed=seed)
            amslicer.slice_job(job, tmp_path / "out", overwrite=True)
            report = amslicer.verify(tmp_path / "out")
            assert report.ok, [c for c in report.checks if not c.ok]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_quarter_of_phasor_noise_is_a_quarter(tmp_path: Path, seed: int) -> None:
    """On 22 500 periods²: 0.2 % are ten standard deviations (0.075 B sin(πρ)/√A = 0.02 %)."""
    labels = parts.bitmap(make(tmp_path, (150, 150, 0.1), "phasor", 2, ratio=0.25, seed=seed))
    share = float(np.mean(labels == 1))
    print(f"seed {seed}: {100 * share:.3f} %")
    assert share == pytest.approx(0.25, abs=0.002)
