"""Gabor noise: its values are those of the theory, and so is the ratio; fields of any noise at any points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer import JobError, UsageError
from amslicer.levelspread import level_deviation
from amslicer.noise.gabor import Gabor
from amslicer.pipeline import prepare
from amslicer.profiles import PROFILES
from amslicer.spread import pixel_deviation

Floats = NDArray[np.float64]
SOLID = {"azimuth": 20.0, "elevation": 35.0}


def make(folder: Path, size: tuple[float, float, float], **settings: Any) -> amslicer.Job:
    defaults = {"noise": "gabor", "printer": {"pitch_um": 100, "layer_um": 100}, "ratio": 0.3}
    return parts.job(parts.box(folder, size), **{**defaults, **settings})


@pytest.mark.parametrize("impulses", [4.5, 17.0])
@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
def test_ratio_of_few_and_many_kernels(tmp_path: Path, ratio: float, impulses: float) -> None:
    """Within 0.5 % on 14 400 periods² of each of four seeds, 0.3 % on average."""
    errors = []
    for seed in (1, 2, 3, 4):
        labels = parts.bitmap(
            make(tmp_path, (120, 120, 0.1), ratio=ratio, impulses=impulses, orientation=23, seed=seed)
        )
        errors.append(np.mean(labels[labels > 0] == 1) - ratio)
    print(f"Λ {impulses:g}, ratio {ratio}: off by " + ", ".join(f"{e:+.4f}" for e in errors))
    assert np.all(np.abs(errors) <= 0.005)
    assert abs(np.mean(errors)) <= 0.003


@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
def test_ratio_in_space(tmp_path: Path, ratio: float) -> None:
    labels = parts.labels(make(tmp_path, (30, 30, 20), ratio=ratio, orientation=SOLID, dimensions=3))
    assert np.mean(labels[labels > 0] == 1) == pytest.approx(ratio, abs=0.01)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_values_have_the_moments_of_theory(dimensions: int, tmp_path: Path) -> None:
    """σ within 3 %, and the excess kurtosis of Λ = 4.5 kernels."""
    settings: dict[str, Any] = {"impulses": 4.5, "dimensions": dimensions}
    size = (150, 150, 0.1) if dimensions == 2 else (40, 40, 40)
    layers = [0] if dimensions == 2 else range(0, 400, 25)
    values = np.concatenate([
        amslicer.field(make(tmp_path, size, seed=seed, **settings), layer).real[::3, ::3].ravel()
        for seed in (1, 2) for layer in layers
    ]).astype(float)  # fmt: skip
    noise = Gabor((1.0, 1.0), 0.5, dimensions, 1, impulses=4.5)
    kurtosis = np.mean(values**4) / np.mean(values**2) ** 2 - 3
    found, expected = f"{values.std():.4f}, {kurtosis:.3f}", f"{noise.deviation:.4f}, {noise.kurtosis:.3f}"
    print(f"{dimensions}D: σ and excess kurtosis {found}; theory {expected}")
    assert values.std() == pytest.approx(noise.deviation, rel=0.03)
    assert kurtosis == pytest.approx(noise.kurtosis, abs=0.05)


def test_a_graded_period_keeps_the_variance(tmp_path: Path) -> None:
    period = {"gradient": {"axis": "x", "from": 0.5, "to": 4}}
    power = np.mean(
        [
            np.abs(amslicer.field(make(tmp_path, (60, 60, 0.1), period=period, seed=seed), 0).real) ** 2
            for seed in range(1, 9)
        ],
        axis=0,
    )
    bands = np.array([band.mean() for band in np.split(power, 4, axis=1)]) / Gabor((1, 1), 0.5, 2, 1).deviation ** 2
    print("variance over theory along the gradient: " + ", ".join(f"{v:.3f}" for v in bands))
    np.testing.assert_allclose(bands, 1, atol=0.12)


@pytest.mark.parametrize("evaluate", ["lattice", "exact"])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_nothing_about_the_run_changes_a_byte(tmp_path: Path, dimensions: int, evaluate: str) -> None:
    settings: dict[str, Any] = {"dimensions": dimensions, "evaluate": evaluate, "orientation": 30}
    ratio = {"a": {"gradient": {"axis": "x", "from": 0, "to": 0.6}}, "b": 0.3, "c": "rest"}
    printer = {"dpi": 600, "layer_um": 40}
    job = make(tmp_path, (9, 7, 2), printer=printer, ratio=ratio, materials=("a", "b", "c"), **settings)
    whole = parts.labels(job)
    assert {1, 2, 3} <= set(np.unique(whole))
    np.testing.assert_array_equal(parts.labels(job, 17, 19), whole[17:19])
    single = np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(jobs=1))])
    np.testing.assert_array_equal(single, whole)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_lattice_changes_few_pixels(tmp_path: Path, dimensions: int) -> None:
    labels = [
        parts.labels(make(tmp_path, (24, 20, 1.2), printer={"dpi": 600, "layer_um": 27}, dimensions=dimensions,
                          orientation=30, evaluate=how), 20, 22)
        for how in ("lattice", "exact")
    ]  # fmt: skip
    changed = np.mean(labels[0] != labels[1])
    print(f"{100 * changed:.4f} % differ")
    assert changed <= 5e-4


def test_plain_fills(tmp_path: Path) -> None:
    for ratio, material in ((0, 2), (1, 1)):
        labels = parts.bitmap(make(tmp_path, (9, 7, 0.1), ratio=ratio))
        assert np.all(labels == material)


@pytest.mark.parametrize("wrong", [{"profile": "cyclic"}, {"alignment": 5}], ids=["profile", "alignment"])
def test_what_needs_a_phase_is_refused(tmp_path: Path, wrong: dict[str, Any]) -> None:
    said = (
        "needs a phase, but gabor noise is read by its values" if "profile" in wrong else "means nothing to gabor noise"
    )
    with pytest.raises(JobError, match=said):
        make(tmp_path, (9, 7, 0.1), **wrong)


# --- any points -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", ["phasor", "gabor"])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_samples_are_the_field_of_a_job(tmp_path: Path, noise: str, dimensions: int) -> None:
    orientation = 30 if dimensions == 2 else {"azimuth": 30, "elevation": 20}
    job = make(tmp_path, (5, 4, 1), noise=noise, dimensions=dimensions, orientation=orientation, seed=7, period=0.8)
    grid, layer = prepare(job).grid, 4
    x, y, z = grid.x_mm()[None, :], grid.y_mm()[::-1, None], grid.z_mm(layer)
    got = amslicer.noise.sample(
        noise, x, y, z, period=0.8, orientation=30, elevation=0 if dimensions == 2 else 20, seed=7,
        dimensions=dimensions,
    )  # fmt: skip
    field = amslicer.field(job, layer)
    assert got.shape == field.shape
    assert np.abs(got - field).max() < 1e-4 * np.abs(field).max()


def test_samples_of_one_point_and_of_painted_parameters() -> None:
    assert amslicer.noise.sample("phasor", 1.0, 2.0).shape == ()
    turning = amslicer.noise.sample(
        "phasor", *np.meshgrid(np.arange(0, 8, 0.1), np.arange(0, 6, 0.1)), orientation=lambda p: 10 * p[:, 0],
        period=lambda p: 0.7 + 0.1 * p[:, 0], isotropy=lambda p: 0.05 * p[:, 1].clip(0, 20),
    )  # fmt: skip
    assert turning.shape == (60, 80)
    assert np.all(np.isfinite(turning))


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"name": "perlin"}, "there is no noise 'perlin'"),
        ({"period": 0.0}, "period is 0.0"),
        ({"period": lambda p: p[:, 0] - 5}, "period falls to"),
        ({"bandwidth": 3}, "bandwidth is 3"),
        ({"isotropy": -0.1}, "isotropy is -0.1"),
        ({"seed": -1}, "seed is -1"),
        ({"dimensions": 4}, "dimensions is 4"),
        ({"impulses": 0}, "impulses is 0"),
        ({"period": "fine"}, "period is 'fine'; it is greater than 0 mm"),
        ({"period": np.ones(3)}, "period is array"),
        ({"period": float("nan")}, "period is nan"),
        ({"orientation": float("inf")}, "orientation is inf; it is degrees"),
        ({"elevation": None}, "elevation is None"),
        ({"bandwidth": lambda p: p[:, 0]}, "bandwidth is <function"),
        ({"seed": 1.5}, "seed is 1.5; it is a whole number"),
        ({"seed": float("nan")}, "seed is nan; it is a whole number"),
        ({"seed": 2**64}, "seed is 18446744073709551616"),
        ({"name": "phacelle", "impulses": 4}, "impulses is 4, which means nothing to phacelle"),
        ({"name": "gabor-isotropic", "period": lambda p: 1 + 0 * p[:, 0]}, "that of gabor-isotropic is one number"),
    ],
)
def test_samples_that_are_refused(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        amslicer.noise.sample(**{"name": "phasor", "x": np.arange(3.0), "y": 0.0, **parameters})


# --- spread -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.2, 0.5])
@pytest.mark.parametrize("bandwidth", [0.25, 0.5, 1.0])
def test_shares_of_windows_scatter_as_theory_says(tmp_path: Path, bandwidth: float, ratio: float) -> None:
    """Standard deviations of 2D windows of 3 to 12 periods over those of the theory, at two directions."""
    quotients = []
    for angle in (0.0, 33.0):
        shares = np.concatenate([
            [parts.bitmap(make(tmp_path, (72, 72, 0.1), ratio=ratio, orientation=angle, bandwidth=bandwidth,
                               seed=seed))[:720, :720] == 1]
            for seed in range(1, 5)
        ])  # fmt: skip
        normal = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle)), 0.0])
        for side in (3, 6, 12):
            n = 72 // side
            windows = shares.reshape(-1, n, 10 * side, n, 10 * side).mean(axis=(2, 4))
            sigma = level_deviation(
                0.0,
                ratio,
                profile=PROFILES["pwm"],
                bandwidth=bandwidth,
                dimensions=2,
                window_periods=(side, side),
                normal=normal,
            )
            pixel = pixel_deviation(0.0, ratio, dimensions=2, pixels_per_period=10, pixels=(10 * side) ** 2)
            quotients.append(float(np.sqrt(np.mean((windows - ratio) ** 2)) / np.hypot(sigma, pixel)))
    print(f"B {bandwidth}, ratio {ratio}: measured over theory " + ", ".join(f"{q:.2f}" for q in quotients))
    assert min(quotients) > 0.5  # the law of pixels errs on the large side
    assert max(quotients) < 1.2


@pytest.mark.parametrize("dimensions", [2, 3])
def test_stacks_are_verified_and_wrong_ones_found(tmp_path: Path, dimensions: int) -> None:
    size, printer = ((40, 30, 0.2) if dimensions == 2 else (20, 14, 6)), {"pitch_um": 80, "layer_um": 80}
    settings: dict[str, Any] = {"printer": printer, "dimensions": dimensions, "orientation": 30}
    for seed in (1, 2):
        job = make(tmp_path, size, seed=seed, **settings)
        amslicer.slice_job(job, tmp_path / "out", overwrite=True)
        report = amslicer.verify(tmp_path / "out")
        assert report.ok, [c for c in report.checks if not c.ok]
        other = make(tmp_path, size, seed=seed, **{**settings, "ratio": 0.42})
        assert not amslicer.verify(tmp_path / "out", fields=tmp_path / "part.yaml").ok
        assert other.materials == job.materials
