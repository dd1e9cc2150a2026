"""The equations of "Improving Gabor Noise" (Lagae et al. 2011): published numbers, integrals, and noise of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer import analysis
from amslicer.noise import GaborKernel, KernelNoise, gabor_noise, varying_gabor_noise

Floats = NDArray[np.float64]
# Of section III-C: K, a, F₀.
PAPER = {"magnitude": 0.709645, "width": 0.0443528, "frequency": 0.0625}
ANISOTROPIC, ISOTROPIC = GaborKernel(**PAPER, dimensions=2, direction=(1.0, 0.0)), GaborKernel(**PAPER, dimensions=2)
# Of the paper: kernel, radius and impulses per kernel at a density, cut at 5 % of the envelope.
CUT_AT_LEVEL = [(ANISOTROPIC, 0.05 * 0.709645, 22.0169, 63.1386),
                (ISOTROPIC, 0.05 * 2 * math.pi * 0.0625 * 0.709645 * 0.0625 / 0.0443528, 15.6741, 32)]  # fmt: skip
CUT_AT_ERROR = [(ANISOTROPIC, 25.25, 46.7139), (ISOTROPIC, 20.8984, 32)]  # at 2 %
SPHERE = {1: 2.0, 2: 2 * math.pi, 3: 4 * math.pi, 4: 2 * math.pi**2}
KERNELS = {
    f"{n}D {kind}": GaborKernel(1.3, 0.05, 0.0625, n, None if kind == "isotropic" else tuple(np.eye(n)[-1].tolist()))
    for n in (1, 2, 3, 4)
    for kind in ("isotropic", "anisotropic")
}


@pytest.mark.parametrize(("kernel", "level", "radius", "impulses"), CUT_AT_LEVEL, ids=["anisotropic", "isotropic"])
def test_published_radii_by_the_envelope(kernel: GaborKernel, level: float, radius: float, impulses: float) -> None:
    found = kernel.envelope_radius(level)
    print(f"radius {found:.4f} of {radius}, {kernel.impulses_per_kernel(0.0414605, found):.4f} impulses of {impulses}")
    assert found == pytest.approx(radius, rel=0.005)
    assert kernel.impulses_per_kernel(0.0414605, found) == pytest.approx(impulses, rel=0.005)


@pytest.mark.parametrize(("kernel", "radius", "impulses"), CUT_AT_ERROR, ids=["anisotropic", "isotropic"])
def test_published_radii_by_the_error(kernel: GaborKernel, radius: float, impulses: float) -> None:
    found = kernel.radius_of_error(0.02)
    print(f"radius {found:.4f} of {radius}, {kernel.impulses_per_kernel(0.0233224, found):.4f} impulses of {impulses}")
    assert found == pytest.approx(radius, rel=0.005)
    assert kernel.impulses_per_kernel(0.0233224, found) == pytest.approx(impulses, rel=0.005)
    assert kernel.error_of_radius(found) == pytest.approx(0.02, rel=1e-3)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_energies_in_closed_form(n: int) -> None:
    """(43)-(46) against the integral of (35)-(38), and of (39)-(42): Parseval."""
    kernel = GaborKernel(**PAPER, dimensions=n)
    r = np.linspace(0, 6 / kernel.width, 100_001)
    f = np.linspace(1e-6, kernel.frequency + 6 * kernel.width, 100_001)
    in_space = SPHERE[n] * np.trapezoid(kernel.radial(r) ** 2 * r ** (n - 1), r)
    in_frequency = SPHERE[n] * np.trapezoid(kernel.radial_power(f) * f ** (n - 1), f)
    assert kernel.energy == pytest.approx(in_space, rel=1e-5)
    assert kernel.energy == pytest.approx(in_frequency, rel=1e-5)


@pytest.mark.parametrize("n", [1, 2])
def test_energy_of_anisotropic_kernels(n: int) -> None:
    kernel = KERNELS[f"{n}D anisotropic"]
    at = np.linspace(-100, 100, 1001)
    points = np.stack(np.meshgrid(*[at] * n, indexing="ij"), axis=-1)
    assert kernel.energy == pytest.approx(float((kernel.at(points) ** 2).sum() * 0.2**n), rel=1e-6)
    frequency = np.stack(np.meshgrid(*[at / 200] * n, indexing="ij"), axis=-1)
    assert kernel.energy == pytest.approx(float(kernel.power(frequency).sum() * 0.001**n), rel=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_an_isotropic_kernel_is_the_mean_of_anisotropic_ones(n: int) -> None:
    """Section III-A: over directions, times what makes its wave at 0 that of (35)-(38)."""
    rng = np.random.default_rng(n)
    directions = rng.normal(size=(200_000, n))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    kernel = GaborKernel(**PAPER, dimensions=n)
    for r in (3.0, 9.0, 17.0):
        waves = np.cos(2 * np.pi * 0.0625 * r * directions[:, 0]).mean()
        mean = kernel.magnitude * math.exp(-math.pi * (kernel.width * r) ** 2) * waves
        expected = float(kernel.radial(np.array(r)))
        scale = float(kernel.radial(np.array(0.0))) / kernel.magnitude
        assert mean * scale == pytest.approx(expected, abs=0.01 * scale)


def spread_points(n: int, count: int, seed: int) -> Floats:
    """Far enough apart to see independent noise, nearly all of them."""
    return np.random.default_rng(seed).uniform(0, {1: 400_000.0, 2: 4000.0, 3: 600.0, 4: 200.0}[n], (count, n))


@pytest.mark.parametrize("name", [name for name in KERNELS if not name.startswith("4D")])
def test_measured_variance_is_that_of_the_closed_form(name: str) -> None:
    kernel = KERNELS[name]
    n = kernel.dimensions
    density = {1: 0.4, 2: 0.02, 3: 0.002}[n]
    values = gabor_noise(
        kernel, spread_points(n, 20_000, 1), density=density, seed=3, radius=kernel.radius_of_error(0.01)
    )
    print(f"{name}: variance {values.var() / kernel.variance(density):.4f} of the closed form")
    assert values.var() == pytest.approx(kernel.variance(density), rel=0.03)
    assert abs(values.mean()) < 0.05 * values.std()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["4D isotropic", "4D anisotropic"])
def test_measured_variance_in_four_dimensions(name: str) -> None:
    kernel = KERNELS[name]
    radius = kernel.radius_of_error(0.02)
    values = gabor_noise(kernel, spread_points(4, 20_000, 1), density=1e-4, seed=3, radius=radius)
    print(f"{name}: variance {values.var() / kernel.variance(1e-4):.4f} of the closed form")
    assert values.var() == pytest.approx(kernel.variance(1e-4), rel=0.03)


@pytest.mark.parametrize("error", [0.01, 0.02, 0.05, 0.1, 0.25])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_measured_truncation_error_is_the_predicted_one(n: int, error: float) -> None:
    """Figs 9 and 10: the same impulses, their kernels cut where (23) says, against hardly cut ones."""
    kernel = KERNELS[f"{n}D isotropic"]
    points, density = spread_points(n, 6_000, 2), {1: 0.4, 2: 0.02, 3: 0.002}[n]
    whole = gabor_noise(kernel, points, density=density, seed=5, radius=kernel.radius_of_error(1e-4))
    cut = gabor_noise(kernel, points, density=density, seed=5, radius=kernel.radius_of_error(error))
    measured = np.sqrt(np.mean((cut - whole) ** 2) / np.mean(whole**2))
    print(f"{n}D: relative error {measured:.4f}, predicted {error}")
    assert measured == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_relative_errors_fall_with_the_radius(n: int) -> None:
    """Figs 11 and 12: and at the same radius the isotropic kernel's is the smaller one in the plane."""
    kernel = GaborKernel(**PAPER, dimensions=n)
    radii = np.linspace(4, 40, 10)
    errors = np.array([kernel.error_of_radius(r) for r in radii])
    assert np.all(np.diff(errors) < 0)
    if n == 2:
        assert np.all(errors < [ANISOTROPIC.error_of_radius(r) for r in radii])


@pytest.mark.parametrize("noise", ["gabor", "gabor-isotropic"])
def test_radial_power_is_the_expected_one(tmp_path: Path, noise: str) -> None:
    """Fig. 4: of what a job makes – unit weights, random phases – within 5 % of the peak."""
    period, bandwidth = 1.0, 0.5
    parts.job(parts.plate(tmp_path, 96, 96), noise=noise, bandwidth=bandwidth, period=period, orientation=31)
    measured = []
    for seed in range(1, 5):
        one = amslicer.load_job(tmp_path / "part.yaml", part=tmp_path / "part.stl", overrides={"pattern.seed": seed})
        frequency, density = analysis.radial_power(amslicer.field(one, 0).real, (0.083, 0.083), bins=120)
        measured.append(density)
    width, wave = bandwidth / period, 1 / period
    direction = (math.cos(math.radians(31)), math.sin(math.radians(31)))
    impulses = cast(KernelNoise, parts.noise(noise)).impulses
    turn = np.arange(720) / 720 * 2 * np.pi
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    if noise == "gabor":
        kernel = GaborKernel(1.0, width, wave, 2, direction)
        expected = np.array([kernel.power(f * around).mean() for f in frequency])
    else:
        kernel = GaborKernel(1 / (2 * math.pi * wave), width, wave, 2)
        expected = kernel.radial_power(frequency)
    # λ kernels per mm². Random phases: times cos²φ, ½, of isotropic kernels; of others the wave itself is turned.
    expected = impulses * width**2 * expected * (1.0 if noise == "gabor" else 0.5)
    if noise == "gabor":
        assert kernel.energy == pytest.approx(1 / (4 * width**2), rel=1e-6)
    off = np.abs(np.mean(measured, axis=0) - expected).max() / expected.max()
    print(f"{noise}: within {100 * off:.1f} % of the peak")
    assert off < 0.05
    assert np.abs(np.mean(measured, axis=0) - np.roll(expected, 3)).max() / expected.max() > 0.05


@pytest.mark.parametrize("even", [True, False], ids=["even", "paper"])
def test_varying_noise_keeps_its_variance_with_even_weights(even: bool) -> None:
    """Section V: all points of one α; the paper's weights let the variance fall to ½ at α = ⅓."""
    found = []
    for alpha in (0.0, 1 / 3, 2 / 3):
        radius = 16 * (1 + alpha)
        width = math.sqrt(-math.log(0.05) / math.pi) / radius
        points = spread_points(2, 12_000, 4)
        kernel = GaborKernel(1.0, width, 1.4 * width, 2)
        values = varying_gabor_noise(
            points, magnitude=1.0, width=np.full(len(points), width), frequency=np.full(len(points), 1.4 * width),
            impulses=32, seed=2, even=even,
        )  # fmt: skip
        found.append(values.var() / kernel.variance(32 / (math.pi * radius**2)))
    expected = [1.0, 1.0, 1.0] if even else [1.0, 0.5, 0.68]
    print(f"variance at α = 0, ⅓, ⅔: {', '.join(f'{v:.3f}' for v in found)} of the one of N impulses per kernel")
    np.testing.assert_allclose(found, expected, rtol=0.07)


def test_varying_noise_follows_its_parameters() -> None:
    """Fig. 15: four octaves from left to right; the period halves from one band to the next."""
    x, y = np.meshgrid(np.arange(0.5, 512, 2), np.arange(0.5, 128, 2))
    octave = 3 * x.ravel() / 512
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    values = varying_gabor_noise(
        points, magnitude=0.7096, width=0.02218 * 2**octave, frequency=0.03125 * 2**octave, impulses=32, seed=1
    ).reshape(x.shape)
    periods = []
    for left in (0, 64, 128):
        band = values[:, left : left + 64]
        f, density = analysis.radial_power(band, (2.0, 2.0), bins=32)
        periods.append(float((density * f).sum() / (density * f**2).sum()))
    print("period of thirds:", [round(p, 1) for p in periods])
    assert periods[0] / periods[1] == pytest.approx(2 ** (3 / 4), rel=0.25)
    assert periods[1] / periods[2] == pytest.approx(2 ** (3 / 4), rel=0.25)


def test_the_same_impulses_for_every_box_and_radius() -> None:
    kernel = KERNELS["2D isotropic"]
    points = spread_points(2, 300, 9)
    one = gabor_noise(kernel, points, density=0.02, seed=4, radius=60.0)
    pieces = [points[i : i + 50] for i in range(0, 300, 50)]
    other = np.concatenate([gabor_noise(kernel, some, density=0.02, seed=4, radius=60.0) for some in pieces])
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert np.abs(one - gabor_noise(kernel, points, density=0.02, seed=5, radius=60.0)).max() > 0.1


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"dimensions": 5}, "dimensions is 5"),
        ({"width": 0.0}, "width is 0"),
        ({"direction": (1.0, 1.0)}, "unit vector"),
        ({"direction": (1.0,)}, "unit vector of 2"),
    ],
)
def test_wrong_kernels_are_refused(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(amslicer.UsageError, match=said):
        GaborKernel(**{**PAPER, "dimensions": 2, **changed})
    with pytest.raises(amslicer.UsageError, match="between 1e-06 and 1"):
        ISOTROPIC.radius_of_error(1.0)


@pytest.mark.parametrize("wrong", [{"density": 0}, {"density": -1}, {"seed": -1}, {"seed": 2**70}, {"radius": 0.0},
                                   {"points": np.zeros((4, 3))}, {"points": np.zeros((0, 2))}], ids=str)  # fmt: skip
def test_wrong_arguments_are_refused(wrong: dict[str, Any]) -> None:
    good: dict[str, Any] = {"points": np.zeros((4, 2)), "density": 0.02, "seed": 1, "radius": 20.0}
    assert gabor_noise(ISOTROPIC, **good).shape == (4,)
    with pytest.raises(amslicer.UsageError):
        gabor_noise(ISOTROPIC, **{**good, **wrong})


def test_parameters_that_fit_no_points_are_refused() -> None:
    with pytest.raises(amslicer.UsageError, match=r"width has the shape \(3,\)"):
        varying_gabor_noise(
            np.zeros((4, 2)), magnitude=1.0, width=np.ones(3), frequency=np.ones(4), impulses=32, seed=1
        )


def test_power_at_no_frequency_is_its_limit() -> None:
    for n in (1, 2, 3, 4):
        near, at = GaborKernel(**PAPER, dimensions=n).radial_power(np.array([1e-4, 0.0]))
        assert at == pytest.approx(near, rel=0.01)
