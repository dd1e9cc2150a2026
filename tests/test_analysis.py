"""The tools of the proofs, on fields whose answer is known, and that a wrong field does not pass them."""

from __future__ import annotations

import analysis
import numpy as np
import pytest
from analysis import Floats, Pitch

SQUARE, OBLONG = (0.083, 0.083), (25.4 / 600, 25.4 / 300)
BLOCK_PITCH = (0.083, 0.1, 0.12)


def phase(pitch: Pitch, angle_deg: float, period_mm: float = 1.0, size_mm: float = 24.0) -> Floats:
    """Phase of a plane wave over a square, row 0 at the largest y."""
    columns, rows = round(size_mm / pitch[0]), round(size_mm / pitch[1])
    x, y = np.arange(columns) * pitch[0], np.arange(rows)[::-1] * pitch[1]
    angle = np.deg2rad(angle_deg)
    return 2 * np.pi / period_mm * (x[None, :] * np.cos(angle) + y[:, None] * np.sin(angle))


def laminate(phase: Floats, ratio: float = 0.5) -> Floats:
    """A perfect grating's labels, as +1 and -1."""
    return np.where(np.cos(phase) > np.cos(np.pi * ratio), 1.0, -1.0)


def block(normal: Floats, ratio: float = 0.5) -> Floats:
    """A perfect laminate in space, (L, H, W), 10 periods wide and deep and 7 high."""
    counts = [round(s / p) for s, p in zip((10, 10, 7), BLOCK_PITCH, strict=True)]
    x, y, z = (np.arange(n) * p for n, p in zip(counts, BLOCK_PITCH, strict=True))
    along = z[:, None, None] * normal[2] + y[::-1][None, :, None] * normal[1] + x[None, None, :] * normal[0]
    return laminate(2 * np.pi * along, ratio)


def core(field: Floats) -> Floats:
    weights = np.zeros(field.shape)
    weights[8:-8, 8:-8, 8:-8] = 1
    return weights


@pytest.mark.parametrize(
    ("a", "b", "error"), [(0, 180, 0), (-90, 90, 0), (10, 190, 0), (5, 175, 10), (0, 90, 90), (30, -30, 60)]
)
def test_line_error(a: float, b: float, error: float) -> None:
    assert analysis.line_error(a, b) == pytest.approx(error)
    assert analysis.line_error(b, a) == pytest.approx(error)


@pytest.mark.parametrize("pitch", [SQUARE, OBLONG])
@pytest.mark.parametrize("angle", [0, 17, 45, 63.4, 90, 121, 160])
def test_directions_of_gratings(pitch: Pitch, angle: float) -> None:
    waves = phase(pitch, angle)
    part = analysis.inner(waves.shape, pitch, 4)
    for field in (np.sin(waves), laminate(waves), laminate(waves, 0.2)):
        error = analysis.line_error(analysis.directions(field, pitch, 1.0)[part], angle)
        assert error.mean() < 0.5
        assert error.max() < 1.5
        assert analysis.line_error(analysis.mean_direction(field, pitch, 1.0), angle) < 0.5


@pytest.mark.parametrize("turn", [np.flipud, np.fliplr, np.transpose])
def test_directions_see_a_mirrored_bitmap(turn: object) -> None:
    field = turn(laminate(phase(SQUARE, 20)))  # type: ignore[operator]
    assert analysis.line_error(analysis.directions(field, SQUARE, 1.0), 20).mean() > 35


def test_directions_see_wrong_pixels() -> None:
    """A 600 x 300 dpi bitmap taken for square pixels has another direction: atan(tan 45° / 2)."""
    field = laminate(phase(OBLONG, 45))
    assert analysis.mean_direction(field, (0.1, 0.1), 1.0) == pytest.approx(63.43, abs=0.5)


def test_directions_of_white_noise_miss_by_45_on_average() -> None:
    field = np.random.default_rng(1).normal(size=(600, 600))
    error = analysis.line_error(analysis.directions(field, SQUARE, 1.0), 30)
    assert 40 < error.mean() < 50


@pytest.mark.parametrize("pitch", [SQUARE, OBLONG])
@pytest.mark.parametrize("period", [0.8, 0.95, 1.0, 1.05, 1.25])
def test_period_of_gratings(pitch: Pitch, period: float) -> None:
    """A period that is 5 % off is measured as such, so a limit of 4 % can fail."""
    waves = phase(pitch, 27, period, size_mm=40)
    for field in (np.sin(waves), laminate(waves), laminate(waves, 0.2)):
        assert analysis.measured_period(field, pitch, 1.0) == pytest.approx(period, rel=0.01)


def test_spectrum_of_variance() -> None:
    """m sin with m = 1 + cos: m²/2 has the energy 2.125 / 4, the rest m²/2 cos has 4.375 / 8: a share of 0.493."""
    waves = phase(SQUARE, 27, size_mm=60)
    swell = 1 + np.cos(phase(SQUARE, 70, 8, size_mm=60))
    assert analysis.low_variance_share(np.sin(waves), SQUARE, 1.0) < 1e-4
    assert analysis.low_variance_share(swell * np.sin(waves), SQUARE, 1.0) == pytest.approx(0.493, abs=0.02)


def test_contrast() -> None:
    random = np.random.default_rng(1)
    gaussian = random.normal(size=(400, 400)) + 1j * random.normal(size=(400, 400))
    assert analysis.contrast(gaussian.astype(np.complex64)) == pytest.approx(np.sqrt(4 / np.pi - 1), abs=0.005)
    grating = np.exp(1j * phase(SQUARE, 27)).astype(np.complex64)
    assert analysis.contrast(grating) < 1e-5


def test_singularities() -> None:
    y, x = np.mgrid[-20:20, -20:20] + 0.3
    plain = np.exp(1j * (0.7 * x + 0.3 * y))
    vortices = ((x - 5) + 1j * y) * ((x + 5) - 1j * (y - 2)) * (x - 0.4 + 1j * (y + 9))
    assert analysis.singularities(plain.astype(np.complex64)) == 0
    assert analysis.singularities((plain * vortices).astype(np.complex64)) == 3


@pytest.mark.parametrize(("azimuth", "elevation"), [(27, 35), (110, 65), (150, 10), (-60, 45), (0, 90), (90, 0)])
def test_normals_of_blocks(azimuth: float, elevation: float) -> None:
    n = analysis.normal(azimuth, elevation)
    for ratio in (0.5, 0.25):
        field = block(n, ratio)
        assert analysis.normal_error(analysis.normal_of_block(field, core(field), BLOCK_PITCH, 1.0), n) < 1
        assert analysis.normal_error(analysis.normal_from_cuts(field, BLOCK_PITCH, 1.0), n) < 2


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_normals_see_a_mirrored_block(axis: int) -> None:
    n = analysis.normal(50, 35)
    field = np.flip(block(n), axis)
    mirrored = n * np.where(np.arange(3) == 2 - axis, -1, 1)
    for measured in (
        analysis.normal_of_block(field, core(field), BLOCK_PITCH, 1.0),
        analysis.normal_from_cuts(field, BLOCK_PITCH, 1.0),
    ):
        assert analysis.normal_error(measured, mirrored) < 2
        assert analysis.normal_error(measured, n) > 50


def test_line_mean_does_not_mind_signs() -> None:
    normals = np.array([analysis.normal(10, 0), -analysis.normal(30, 0)])
    assert analysis.normal_error(analysis.line_mean(normals, np.ones(2)), analysis.normal(20, 0)) < 1e-3
