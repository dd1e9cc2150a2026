"""Noises whose kernels are no products along the axes: Phacelle and isotropic Gabor, against their NumPy twins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_noises import make

import amslicer
from amslicer import JobError, analysis
from amslicer.noise.gabor import IsotropicGabor
from amslicer.noise.phacelle import REACH_CELLS, Phacelle
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]


# --- Phacelle ---------------------------------------------------------------------------------------------


def test_the_weight_is_the_articles_and_reaches_0() -> None:
    w = Phacelle((1.0, 1.0), 0.5, 2, 1).envelope
    assert w is not None
    d = np.sqrt(np.linspace(0, 1, len(w))) * REACH_CELLS
    np.testing.assert_allclose(w, np.exp(-2 * d**2) - np.exp(-4.5), atol=1e-7)
    assert w[-1] == 0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_nothing_jumps_where_the_window_moves_on(dimensions: int) -> None:
    """The largest step of G across lines where the window of 4 × 4 cells moves, against steps elsewhere."""
    side = Phacelle((1.0, 1.0), 0.5, dimensions, 1).side_mm
    fine = 1e-4
    lines = (np.arange(200) + 0.5) * side
    rng = np.random.default_rng(0)
    y, z = rng.uniform(0, 50, (2, 200))
    steps = []
    for x in (lines, lines + 0.37 * side):
        values = [
            amslicer.noise.sample("phacelle", x + s * fine, y, z, orientation=30, dimensions=dimensions)
            for s in (-1, 1)
        ]
        steps.append(np.abs(values[1] - values[0]).max())
    print(f"{dimensions}D: largest step across a line {steps[0]:.2e}, elsewhere {steps[1]:.2e}")
    assert steps[0] <= 1.2 * steps[1]


def test_phacelle_is_a_laminate(tmp_path: Path) -> None:
    g = amslicer.field(make(tmp_path, (60, 60, 0.1), "phacelle", 2), 0)
    sine = analysis.phase_sine(g)
    assert analysis.line_error(analysis.mean_direction(sine, (0.1, 0.1), 1.0), 23) <= 1.5
    assert analysis.measured_period(sine, (0.1, 0.1), 1.0) == pytest.approx(1, rel=0.03)
    assert analysis.low_variance_share(sine, (0.1, 0.1), 1.0) <= 0.01


def test_impulses_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="one splat in each"):
        make(tmp_path, (4, 3, 1), "phacelle", 2, impulses=4)


# --- simple Phacelle --------------------------------------------------------------------------------------


def sampled(job: amslicer.Job, noise: str, layer: int, dimensions: int, **settings: Any) -> NDArray[np.complex128]:
    grid = prepare(job).grid
    x, y, z = grid.x_mm()[None, :], grid.y_mm()[::-1, None], grid.z_mm(layer)
    return amslicer.noise.sample(noise, x, y, z, dimensions=dimensions, **settings)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_simple_is_sampled_where_nothing_turns(tmp_path: Path, dimensions: int) -> None:
    simple, other = (
        amslicer.field(make(tmp_path, (4, 3, 1), noise, dimensions), 4) for noise in ("phacelle-simple", "phacelle")
    )
    assert np.abs(simple - other).max() < 1e-3


@pytest.mark.parametrize("dimensions", [2, 3])
def test_simple_reads_direction_isotropy_and_period_at_each_pixel(tmp_path: Path, dimensions: int) -> None:
    job = make(
        tmp_path, (5, 4, 2), "phacelle-simple", dimensions, seed=8,
        orientation={"gradient": {"axis": "x", "from": 0, "to": 120}},
        isotropy={"gradient": {"axis": "y", "from": 0, "to": 0.6}},
        period={"gradient": {"axis": "y", "from": 0.8, "to": 1.2}},
    )  # fmt: skip
    got = amslicer.field(job, 3)
    periods = dict(zip(("shortest", "longest"), prepare(job).painted.period_bounds_mm, strict=True))
    assert periods == {"shortest": 0.8, "longest": 1.2}
    expected = amslicer.reference.phacelle(
        *(prepare(job).grid.x_mm()[None, :], prepare(job).grid.y_mm()[::-1, None], prepare(job).grid.z_mm(3)),
        period=lambda p: 0.8 + 0.4 * np.clip(p[:, 1] / 4, 0, 1), dimensions=dimensions, seed=8, simple=True,
        side_mm=Phacelle((0.8, 1.2), 0.5, dimensions, 8).side_mm,
        normal=lambda p: analysis.normal(120 * np.clip(p[:, 0] / 5, 0, 1), 0.0),
        isotropy=lambda p: 0.6 * np.clip(p[:, 1] / 4, 0, 1),
    )  # fmt: skip
    # Beside a place where a splat's normal is across the pixel's, rounding decides its sign.
    off = np.abs(got - expected) > 2e-3 * np.abs(expected).max()
    print(f"{dimensions}D: {np.mean(off):.5f} of the pixels differ")
    assert np.mean(off) < 1e-3
    other = sampled(job, "phacelle", 3, dimensions, seed=8)
    assert np.mean(np.abs(got - other) > 2e-3 * np.abs(expected).max()) > 0.5


def test_a_line_and_its_opposite_are_one_laminate(tmp_path: Path) -> None:
    """Where n becomes -n, G becomes its conjugate: the largest step of Re G and |Im G| is as elsewhere."""
    half = {"expression": "where(x < 3, 20, 200)"}
    job = make(
        tmp_path, (6, 40, 0.02), "phacelle-simple", 2, orientation=half, printer={"pitch_um": 20, "layer_um": 20}
    )
    g = amslicer.field(job, 0)
    for part in (g.real, np.abs(g.imag)):
        steps = np.abs(np.diff(part, axis=1)).max(axis=0)
        assert steps[149] < 1.05 * np.delete(steps, 149).max()
    assert np.abs(np.diff(g.imag, axis=1)).max(axis=0)[149] > 3 * steps.max()


def test_simple_keeps_the_painted_direction_to_the_pixel(tmp_path: Path) -> None:
    """Within half a period of a step in direction: the wave is ∇arg G, from neighbours on the same side."""
    step = {"expression": "where(x < 10, 0, 60)"}
    error = []
    for noise in ("phacelle", "phacelle-simple"):
        job = make(tmp_path, (20, 60, 0.02), noise, 2, orientation=step, printer={"pitch_um": 20, "layer_um": 20})
        g = amslicer.field(job, 0)[:, 501:525].astype(complex)
        across, up = (g[:-1, 1:] * g[:-1, :-1].conj()).imag, -(g[1:, :-1] * g[:-1, :-1].conj()).imag
        angle = np.rad2deg(np.arctan2(up.sum(), across.sum()))
        error.append(float(analysis.line_error(angle, 60.0)))
    print(f"0 to 0.5 periods beside a step to 60°: sampled {error[0]:.1f}° off, simple {error[1]:.1f}° off")
    assert error[1] < 5 < error[0]


# --- isotropic Gabor --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimensions", [2, 3])
def test_values_have_the_deviation_of_theory(tmp_path: Path, dimensions: int) -> None:
    size = (150, 150, 0.1) if dimensions == 2 else (30, 30, 30)
    layers = [0] if dimensions == 2 else range(0, 300, 20)
    job = make(tmp_path, size, "gabor-isotropic", dimensions)
    values = np.concatenate([amslicer.field(job, layer).real[::3, ::3].ravel() for layer in layers]).astype(float)
    expected = IsotropicGabor((1.0, 1.0), 0.5, dimensions, 1).deviation
    print(f"{dimensions}D: σ {values.std():.4f} of {expected:.4f}")
    assert values.std() == pytest.approx(expected, rel=0.03)


def test_no_direction_stands_out(tmp_path: Path) -> None:
    """Power at the carrier in 12 sectors, of a plane of 150 periods."""
    g = amslicer.field(make(tmp_path, (150, 150, 0.1), "gabor-isotropic", 2), 0).real
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(g))) ** 2
    f = np.fft.fftshift(np.fft.fftfreq(len(g), 0.1))
    angle, radius = np.rad2deg(np.arctan2(f[:, None], f[None, :])) % 180, np.hypot(f[:, None], f[None, :])
    ring = (radius > 0.6) & (radius < 1.4)
    assert spectrum[ring].sum() > 0.9 * spectrum.sum()
    sectors = np.histogram(angle[ring], bins=12, range=(0, 180), weights=spectrum[ring])[0]
    print("sectors over their mean: " + ", ".join(f"{s:.2f}" for s in sectors / sectors.mean()))
    assert sectors.max() / sectors.min() < 1.25
