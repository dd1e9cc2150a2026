"""Proof: isotropy spreads directions from a laminate to none at all, and leaves the phase a phase.

Spectra of G on plates of 40 × 40 periods, laminate at 30°. A direction is a sector of the spectrum's half plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import parts
import pytest
from scipy import stats

import amslicer
from amslicer import analysis
from amslicer.device import Device
from amslicer.generator import DeviceGenerator
from amslicer.noise.turn import turned

SIDE_MM, ANGLE_DEG = 40.0, 30.0
PITCH = {"pitch_um": 100, "layer_um": 100}
PITCH_MM = (0.1, 0.1)
SECTORS, CAPS = 12, 20


def field(folder: Path, bandwidth: float, isotropy: float, seed: int) -> parts.Floats:
    part = parts.plate(folder, SIDE_MM, SIDE_MM)
    content = {
        "printer": PITCH, "materials": ["a", "b"],
        "pattern": {"dimensions": 2, "bandwidth": bandwidth, "seed": seed},
        "fields": {"ratio": 0.5, "orientation": ANGLE_DEG, "isotropy": isotropy},
    }  # fmt: skip
    return amslicer.field(amslicer.load_job(content, part=part), 0)


def directions(values: parts.Floats) -> tuple[parts.Floats, parts.Floats, parts.Floats]:
    """Power, frequency and angle (0 to 180°) of a bitmap's spectrum."""
    power, frequency = analysis.power(values, PITCH_MM)
    fy = -np.fft.fftfreq(values.shape[0], PITCH_MM[1])[:, None]  # rows run downwards
    fx = np.fft.rfftfreq(values.shape[1], PITCH_MM[0])[None, :]
    return power, frequency, np.rad2deg(np.arctan2(fy, fx)) % 180


def sector_shares(values: parts.Floats) -> parts.Floats:
    """Power in each of 12 sectors, over their mean."""
    power, frequency, angle = directions(values)
    inside = frequency > 0
    sums = np.bincount((angle[inside] * SECTORS / 180).astype(int) % SECTORS, power[inside], minlength=SECTORS)
    return sums / sums.mean()


def near_normal(values: parts.Floats) -> float:
    """Share of the power within ±25° of the normal."""
    power, frequency, angle = directions(values)
    near = (analysis.line_error(angle, ANGLE_DEG) <= 25) & (frequency > 0)
    return float(power[near].sum() / power[frequency > 0].sum())


def in_band(values: parts.Floats) -> float:
    power, frequency, _ = directions(values)
    return float(power[(frequency > 0.6) & (frequency < 1.4)].sum() / power.sum())


def signed(g: parts.Floats) -> parts.Floats:
    """±1: the labels at ratio ½."""
    return np.where(np.abs(np.angle(g)) < np.pi / 2, 1.0, -1.0)


@pytest.mark.parametrize("bandwidth", [0.25, 0.5])
def test_isotropy_1_has_no_direction(tmp_path: Path, bandwidth: float) -> None:
    """Eight seeds: none above 3.5 × the mean in any of 12 sectors, 1.6 × on average; the period stays."""
    fields = [field(tmp_path, bandwidth, 1.0, seed).real for seed in range(1, 9)]
    shares = np.array([sector_shares(values) for values in fields])
    bands = [in_band(values) for values in fields]
    mean = shares.mean(axis=0).max()
    print(
        f"bandwidth {bandwidth}: largest sector {shares.max():.2f} × the mean in one seed, {mean:.2f} × on average; "
        f"{min(bands):.4f} of the power within 0.6 to 1.4 carriers"
    )
    assert shares.max() <= 3.5
    assert mean <= 1.6
    assert min(bands) >= 0.95


@pytest.mark.parametrize("bandwidth", [0.25, 0.5])
def test_isotropy_0_is_a_laminate(tmp_path: Path, bandwidth: float) -> None:
    g = field(tmp_path, bandwidth, 0.0, 1)
    real, labels = near_normal(g.real), near_normal(signed(g))
    print(f"bandwidth {bandwidth}: {real:.4f} of Re G's power within ±25° of the normal, {labels:.4f} of the labels'")
    assert real >= 0.95
    assert labels >= 0.88
    with pytest.raises(AssertionError):  # the limit of isotropy 1 notices a laminate
        assert sector_shares(g.real).max() <= 3.5


def test_the_spread_grows_with_isotropy(tmp_path: Path) -> None:
    """Means of three seeds: less and less power lies along the normal."""
    shares = [
        np.mean([near_normal(field(tmp_path, 0.5, isotropy, seed).real) for seed in (1, 2, 3)])
        for isotropy in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    print("within ±25° at isotropy 0, 0.25, 0.5, 0.75, 1: " + ", ".join(f"{share:.3f}" for share in shares))
    assert np.all(np.diff(shares) < -0.02)
    assert shares[-1] == pytest.approx(50 / 180, abs=0.08)  # of 180° if all are alike


@pytest.mark.parametrize("isotropy", [0.0, 1.0])
@pytest.mark.parametrize(("bandwidth", "least_of_g"), [(0.25, 0.3), (0.5, 0.3), (1.0, 0.15)])
def test_spectrum_of_variance(tmp_path: Path, bandwidth: float, least_of_g: float, isotropy: float) -> None:
    """The phasor sine has no slow change of contrast, whatever its directions; Re G has."""
    g = field(tmp_path, bandwidth, isotropy, 1)
    sine = analysis.low_variance_share(analysis.phase_sine(g), PITCH_MM, 1.0)
    real = analysis.low_variance_share(g.real, PITCH_MM, 1.0)
    print(
        f"bandwidth {bandwidth}, isotropy {isotropy}: below half the carrier {sine:.4f} of sine², {real:.3f} of Re G²"
    )
    assert sine <= 0.01
    assert real >= least_of_g


# --- the turned directions themselves -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def draw() -> Iterator[DeviceGenerator]:
    with Device() as device:
        yield DeviceGenerator(device)


def apart(count: int, step_mm: float, dimensions: int) -> parts.Floats:
    """Places so far from each other that their fields have nothing in common (no point within reach of two)."""
    side = int(np.ceil(count ** (1 / dimensions)))
    place = np.stack(np.meshgrid(*[np.arange(side)] * dimensions), axis=-1).reshape(-1, dimensions)[:count]
    return np.pad(place * step_mm + 0.37, ((0, 0), (0, 3 - dimensions)))


@pytest.mark.parametrize("isotropy", [0.3, 1.0])
def test_flat_turns_are_uniform(draw: DeviceGenerator, isotropy: float) -> None:
    """Kolmogorov and Smirnov: angles about the normal over ±90° s; a level of 1e-3 and a fixed seed."""
    count, width = 2500, 0.5
    normal = np.tile([np.cos(1.1), np.sin(1.1), 0.0], (count, 1))
    found = turned(
        normal, np.full(count, isotropy), apart(count, 24.0, 2), np.full(count, width), 2, 5, draw
    )  # fmt: skip
    delta = np.arctan2(found[:, 1] * normal[:, 0] - found[:, 0] * normal[:, 1], np.sum(found * normal, axis=1))
    half = isotropy * np.pi / 2
    result = stats.kstest(delta, stats.uniform(-half, 2 * half).cdf)
    print(f"isotropy {isotropy}: KS distance {result.statistic:.4f}, p {result.pvalue:.3f}")
    assert result.pvalue > 1e-3
    assert np.abs(delta).max() <= half + 1e-9


@pytest.mark.parametrize("isotropy", [0.3, 1.0])
def test_turns_in_space_are_uniform_in_a_cap(draw: DeviceGenerator, isotropy: float) -> None:
    """Heights above the cap's rim are uniform (Archimedes), and so are azimuths about the normal."""
    count, width = 2744, 0.5
    n = np.array([0.48, -0.6, 0.64])
    found = turned(
        np.tile(n, (count, 1)), np.full(count, isotropy), apart(count, 24.0, 3), np.full(count, width), 3, 5, draw
    )  # fmt: skip
    height, rim = found @ n, np.cos(isotropy * np.pi / 2)
    aside = np.cross(n, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    azimuth = np.arctan2(found @ np.cross(n, aside), found @ aside)
    for name, values, law in (
        ("height", height, stats.uniform(rim, 1 - rim)), ("azimuth", azimuth, stats.uniform(-np.pi, 2 * np.pi)),
    ):  # fmt: skip
        result = stats.kstest(values, law.cdf)
        print(f"isotropy {isotropy}: {name} KS distance {result.statistic:.4f}, p {result.pvalue:.3f}")
        assert result.pvalue > 1e-3


def cap_shares(lines: parts.Floats, weights: parts.Floats) -> parts.Floats:
    """Weight in each of 20 equal-area sectors of the half sphere, over their mean."""
    line = lines * np.where(lines[:, 2:] < 0, -1, 1)
    level = np.minimum((line[:, 2] * 4).astype(int), 3)  # four bands of the same height, five sectors in each
    turn = (np.arctan2(line[:, 1], line[:, 0]) / (2 * np.pi) % 1 * 5).astype(int) % 5
    sums = np.bincount(5 * level + turn, weights, minlength=CAPS)
    return sums / sums.mean()


def solid_shares(folder: Path, isotropy: float, seed: int) -> parts.Floats:
    """Sectors of the spectrum of a block's labels, ±1 at ratio ½, where the noise's waves are: 0.6 to 1.4 / period."""
    content = {
        "printer": {"pitch_um": 250, "layer_um": 250}, "materials": ["a", "b"], "pattern": {"seed": seed},
        "fields": {"ratio": 0.5, "orientation": {"azimuth": 0, "elevation": 53}, "isotropy": isotropy},
    }  # fmt: skip
    job = amslicer.load_job(content, part=parts.box(folder, (SIDE_MM,) * 3))
    labels = np.stack([layer.labels[::-1] for layer in amslicer.layers(job)])
    assert labels.min() == 1  # solid all through
    window = np.hanning(labels.shape[0])
    window = window[:, None, None] * window[:, None] * window
    power = np.abs(np.fft.fftn(np.where(labels == 1, 1.0, -1.0) * window)) ** 2
    f = np.fft.fftfreq(labels.shape[0], 0.25)
    wave = np.stack(np.meshgrid(f, f, f, indexing="ij")[::-1], axis=-1)
    length = np.linalg.norm(wave, axis=-1)
    inside = (length > 0.6) & (length < 1.4)
    return cap_shares(wave[inside] / length[inside][:, None], power[inside])


def test_isotropy_1_in_space_has_no_direction(tmp_path: Path) -> None:
    """Eight blocks of 40 periods a side: none above 3.5 × the mean in any of 20 sectors, 1.6 × on average."""
    shares = np.array([solid_shares(tmp_path, 1.0, seed) for seed in range(1, 9)])
    mean = shares.mean(axis=0).max()
    print(f"largest of 20 sectors of the labels: {shares.max():.2f} × the mean in one seed, {mean:.2f} × on average")
    assert shares.max() <= 3.5
    assert mean <= 1.6
    assert solid_shares(tmp_path, 0.0, 1).max() > 3.5


def test_isotropy_1_in_space_is_uniform_over_the_sphere(draw: DeviceGenerator) -> None:
    """Kernels of a block of 40 periods, eight seeds: 20 equal-area sectors of the half sphere by the same limits."""
    shares = []
    for seed in range(1, 9):
        place = np.random.default_rng(seed).uniform(0, 40, (20_000, 3))
        count = len(place)
        found = turned(
            np.tile([0.6, 0.0, 0.8], (count, 1)), np.ones(count), place, np.full(count, 0.5), 3, seed, draw
        )  # fmt: skip
        shares.append(cap_shares(found, np.ones(count)))
    found_shares = np.array(shares)
    mean = found_shares.mean(axis=0).max()
    print(f"largest of 20 sectors: {found_shares.max():.2f} × the mean in one seed, {mean:.2f} × on average")
    assert found_shares.max() <= 3.5
    assert mean <= 1.6


def test_neighbours_turn_together(draw: DeviceGenerator) -> None:
    """A tenth of an envelope apart, directions differ by a few degrees; 30 envelopes apart by as much as chance."""
    count, width = 400, 0.5
    place = apart(count, 24.0, 2)
    args = np.tile([1.0, 0, 0], (count, 1)), np.ones(count)
    here, near, far = (
        turned(*args, place + np.array([shift, 0, 0]), np.full(count, width), 2, 5, draw) for shift in (0.0, 0.2, 60.0)
    )
    angle = [np.rad2deg(np.arccos(np.clip(np.abs(np.sum(here * other, axis=1)), 0, 1))) for other in (near, far)]
    print(f"median angle {np.median(angle[0]):.1f}° near by, {np.median(angle[1]):.1f}° far away")
    assert np.median(angle[0]) < 15
    assert np.median(angle[1]) == pytest.approx(45, abs=5)
