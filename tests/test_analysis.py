"""The tools of the proofs, on fields whose answer is known, and that a wrong field does not pass them."""

from __future__ import annotations

import numpy as np
import pytest

from amslicer import analysis
from amslicer.analysis import Floats, Pitch

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


def wave(angle: float, period: float, pitch: tuple[float, float], shape: tuple[int, int] = (300, 400)) -> Floats:
    """A cosine of a direction, row 0 at the largest y."""
    x, y = (np.arange(shape[1]) + 0.5) * pitch[0], (np.arange(shape[0])[::-1] + 0.5) * pitch[1]
    a = np.deg2rad(angle)
    return np.asarray(np.cos(2 * np.pi / period * (np.cos(a) * x[None, :] + np.sin(a) * y[:, None])))


@pytest.mark.parametrize("pitch", [(0.1, 0.1), (0.1, 0.15)])
def test_radial_power_peaks_at_the_carrier_and_holds_the_variance(pitch: tuple[float, float]) -> None:
    frequency, density = analysis.radial_power(wave(35, 1.25, pitch), pitch)
    assert frequency[np.argmax(density)] == pytest.approx(0.8, abs=frequency[1] - frequency[0])
    rings = 2 * np.pi * frequency * (frequency[1] - frequency[0])
    assert np.sum(density * rings) == pytest.approx(0.5, rel=0.1)
    noise = np.random.default_rng(0).normal(size=(300, 400))
    flat = analysis.radial_power(noise, pitch, bins=8)[1]
    np.testing.assert_allclose(flat, pitch[0] * pitch[1], rtol=0.1)


@pytest.mark.parametrize("angle", [10.0, 63.0, 120.0, 171.0])
def test_angular_power_is_in_the_sector_of_the_normal(angle: float) -> None:
    middles, shares = analysis.angular_power(wave(angle, 1.0, (0.1, 0.12)), (0.1, 0.12), 1.0)
    assert shares.sum() == pytest.approx(1)
    assert analysis.line_error(middles[np.argmax(shares)], angle) <= 2.6
    assert shares.max() > 0.6


def test_autocovariance_of_a_wave_is_half_its_cosine() -> None:
    field = wave(0, 1.0, (0.1, 0.1), (60, 400))
    found = analysis.autocovariance(field)
    assert found.shape == (119, 799)
    shift = np.arange(-100, 101)
    np.testing.assert_allclose(found[59, 399 + shift], 0.5 * np.cos(2 * np.pi * shift / 10), atol=0.01)
    values = np.random.default_rng(1).normal(size=(7, 9))
    values -= values.mean()
    assert analysis.autocovariance(values)[6 + 2, 8 - 3] == pytest.approx(np.mean(values[2:, :-3] * values[:-2, 3:]))


def test_local_ratio_counts_the_solid_alone() -> None:
    labels = np.zeros((40, 60), np.uint8)
    labels[:, 10:30], labels[:, 30:50] = 1, 2
    share = analysis.local_ratio(labels, (0.1, 0.1), 0.5)
    assert np.isnan(share[20, 0])
    assert share[20, 12] == 1
    assert share[20, 45] == 0
    assert share[20, 29] == pytest.approx(3 / 5)
    assert analysis.local_ratio(labels, (0.1, 0.1), 0.5, material=2)[20, 29] == pytest.approx(2 / 5)
