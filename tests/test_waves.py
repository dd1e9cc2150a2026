"""Wave noise: spectra as asked, constant variance, no repetition, time, painted directions and periods."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import amslicer
from amslicer import wavereference
from amslicer.device import Device
from amslicer.noise.spectra import make_spectrum
from amslicer.noise.waves import Wave, default_directions, half_circle, half_sphere
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex64]

STEP, SIDE, BLOCK = 0.2, 200.0, 100  # mm between samples, mm of a side, samples of a block: 20 periods
FREQUENCY = np.fft.fftfreq(BLOCK, STEP)
RADIUS = np.hypot(FREQUENCY[:, None], FREQUENCY)
WINDOW = np.hanning(BLOCK + 1)[:-1]


def wave_job(folder: Path, size: tuple[float, float, float] = (SIDE, SIDE, STEP), **pattern: Any) -> amslicer.Job:
    settings = {"isotropy": 1.0, "evaluate": "exact", "reads": "real", **pattern}
    printer = {"pitch_um": 1000 * STEP, "layer_um": 1000 * STEP}
    return parts.job(parts.box(folder, size), noise="wave", printer=printer, **settings)


def field(folder: Path, **pattern: Any) -> Complexes:
    return amslicer.field(wave_job(folder, **pattern), 0)


def power_of(g: NDArray[Any]) -> Floats:
    """Mean power of blocks under a Hann window, Σ 1."""
    count = g.shape[0] // BLOCK, g.shape[1] // BLOCK
    cut = g[: count[0] * BLOCK, : count[1] * BLOCK].reshape(count[0], BLOCK, count[1], BLOCK).swapaxes(1, 2)
    power = np.mean(np.abs(np.fft.fft2(cut * np.outer(WINDOW, WINDOW))) ** 2, axis=(0, 1))
    return np.asarray(power / power.sum())


def asked_power(spectrum: Any) -> Floats:
    """A² over the same frequencies, as wide as the window makes lines, Σ 1."""
    made = make_spectrum(spectrum)
    low, high = made.band(0.5)
    power = np.where((low <= RADIUS) & (high >= RADIUS), made.amplitude(RADIUS, 0.5) ** 2, 0.0)  # type: ignore[union-attr]
    line = np.abs(np.fft.fft(WINDOW)) ** 2
    blurred = np.fft.ifft2(np.fft.fft2(power) * np.fft.fft2(np.outer(line, line))).real
    return np.asarray(blurred / blurred.sum())


def spectrum_of(spec: Any) -> Any:
    return wave_pattern(spectrum=spec).spectrum


def wave_pattern(**pattern: Any) -> Any:
    from amslicer.specification import Pattern

    return Pattern.model_validate({"noise": "wave", **pattern})


MOMENTS = np.array([0.0, 0.05, 0.1, 0.4])
SPECTRA = {
    "gaussian": {"gaussian": 0.6, "width": 0.15},
    "laminate": "laminate",
    "table": {"table": [[0.2, 0.0], [0.5, 1.0], [0.8, 0.3], [1.2, 0.0]]},
}


@pytest.mark.parametrize("name", SPECTRA)
def test_the_spectrum_is_the_asked_one(tmp_path: Path, name: str) -> None:
    """Frequency by frequency, 100 directions: within 10 % of the peak. 600 blocks scatter by 4 %, three by three
    frequencies together by half of it."""
    spec = spectrum_of(SPECTRA[name])
    asked = asked_power(spec)
    got = np.mean(
        [power_of(field(tmp_path, seed=s, spectrum=SPECTRA[name], directions=100).real) for s in range(1, 7)], axis=0
    )
    got, asked = (ndimage.uniform_filter(power, 3, mode="wrap") for power in (got, asked))
    ring = np.rint(RADIUS * BLOCK * STEP).astype(int).ravel()
    count = np.bincount(ring)
    radial = np.abs(np.bincount(ring, (got - asked).ravel()) / count).max()
    worst = np.abs(got - asked).max() / asked.max()
    peak = (np.bincount(ring, asked.ravel()) / count).max()
    print(
        f"{name}: off by {100 * worst:.1f} % of the peak at most, around all directions by {100 * radial / peak:.1f} %"
    )
    assert worst <= 0.10
    assert radial / peak <= 0.05


def test_the_spectrums_error_falls_with_the_directions(tmp_path: Path) -> None:
    """As in Fig. 20: L2 error of the power over all frequencies."""
    asked = asked_power(spectrum_of(SPECTRA["gaussian"]))
    errors = []
    for directions in (10, 20, 50, 100):
        got = np.mean(
            [power_of(field(tmp_path, seed=s, spectrum=SPECTRA["gaussian"], directions=directions).real)
             for s in (1, 2, 3)], axis=0,
        )  # fmt: skip
        errors.append(float(np.linalg.norm(got - asked) / np.linalg.norm(asked)))
    print("10, 20, 50, 100 directions: " + ", ".join(f"{100 * e:.1f} %" for e in errors))
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 4 * errors[-1]


@pytest.mark.parametrize(("name", "exponent"), [("white", 0.0), ("blue", 1.0), ("brown", -2.0)])
def test_colours_of_noise(tmp_path: Path, name: str, exponent: float) -> None:
    """The slope of log power over log frequency, well within the band of three octaves."""
    power = np.mean([power_of(field(tmp_path, seed=s, spectrum=name, directions=60).real) for s in (1, 2, 3)], axis=0)
    inside = (RADIUS > 0.25) & (RADIUS < 0.9)
    slope = np.polyfit(np.log(RADIUS[inside]), np.log(power[inside]), 1)[0]
    outside = power[RADIUS > 1.15].sum()
    print(f"{name}: power goes as f^{slope:.2f}; {100 * outside:.2f} % beyond the highest frequency")
    assert slope == pytest.approx(exponent, abs=0.2)
    assert outside <= 0.01


def test_the_spectrum_in_space(tmp_path: Path, device: Device) -> None:
    """Rings of a volume of 20 periods a side, two seeds."""
    name = "gaussian"
    rings = []
    for seed in (1, 2):
        job = wave_job(tmp_path, (20, 20, 20), dimensions=3, seed=seed, spectrum=SPECTRA[name])
        pattern = prepare(job).pattern(device)
        g = np.stack([pattern.field(layer) for layer in range(BLOCK)]).real
        window = WINDOW[:, None, None] * WINDOW[:, None] * WINDOW
        power = np.abs(np.fft.fftn(g * window)) ** 2
        radius = np.sqrt(FREQUENCY[:, None, None] ** 2 + FREQUENCY[:, None] ** 2 + FREQUENCY**2)
        ring = np.rint(radius * BLOCK * STEP / 2).astype(int).ravel()  # two steps wide
        rings.append(np.bincount(ring, power.ravel()) / np.bincount(ring))
    got = np.mean(rings, axis=0)[:13]
    f = np.arange(len(got)) * 2 / (BLOCK * STEP)
    made: Any = make_spectrum(spectrum_of(SPECTRA[name]))
    asked = made.amplitude(f, 0.5) ** 2
    asked = np.convolve(np.interp(np.linspace(f[0], f[-1], 1201), f, asked), np.ones(101) / 101, "same")[::100]
    scale = (got @ asked) / (asked @ asked)
    worst = np.abs(got / scale - asked).max() / asked.max()
    print(f"off by {100 * worst:.1f} % of the peak at most")
    assert worst <= 0.10


def test_blending_slices_keeps_the_variance() -> None:
    """One wave alone, through its slices: |G|² where two are blended, and between; a plain mean would have 0.77."""
    wave = Wave((1.0, 1.0), 0.5, 2, 1, directions=1)
    blended, alone, halfway = [], [], []
    for seed in range(150):
        made = Wave((1.0, 1.0), 0.5, 2, seed, directions=1)
        found = made.waves(np.zeros(3), np.array([0.0, 600.0, 0.0]))
        y = np.arange(0.0, 600.0, 0.7)
        places = np.stack([np.zeros_like(y), y, np.zeros_like(y)], axis=-1)
        g = wavereference.wave(
            0.0, y, 0.0, period=1.0, bandwidth=0.5, dimensions=2, seed=seed,
            normal=lambda p: np.tile((0.6, 0.8, 0.0), (len(p), 1)), isotropy=1.0, directions=1,
            length_mm=wave.length_mm, samples=wave.samples, periods=wave.table_periods_mm,
            amplitude=lambda f: wave.spectrum.amplitude(f, 0.5), band=wave.spectrum.band(0.5),  # type: ignore[union-attr]
        )  # fmt: skip
        border = np.min(np.abs(places @ found.axis[0] - found.high_mm[:, None]), axis=0)
        blended.append(np.abs(g[border < wave.blend_mm]) ** 2)
        halfway.append(np.abs(g[border < 0.2 * wave.blend_mm]) ** 2)
        alone.append(np.abs(g[border > 1.2 * wave.blend_mm]) ** 2)
    means = [float(np.mean(np.concatenate(some))) for some in (blended, halfway, alone)]
    print(f"variance where slices are blended {means[0]:.3f}, half way {means[1]:.3f}, within slices {means[2]:.3f}")
    assert means[0] == pytest.approx(1.0, abs=0.03)
    assert means[1] == pytest.approx(1.0, abs=0.05)  # a fifth as many places
    assert means[2] == pytest.approx(1.0, abs=0.03)


def test_nothing_repeats() -> None:
    """Places a whole number of table lengths apart, along each wave and along the axes, up to 100: no correlation."""
    wave = Wave((1.0, 1.0), 0.5, 2, 3)
    count = 1500
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1000.0, (2, count))
    keys: dict[str, Any] = {"period": 1.0, "isotropy": 1.0, "seed": 3}
    g = amslicer.noise.sample("wave", x, y, **keys)
    directions = [*half_circle(wave.directions).directions(np.full((22, 2), 0.5), np.arange(22))[::5, :2], (1.0, 0.0)]
    worst = 0.0
    for direction in directions:
        for times in (1, 2, 100):
            dx, dy = wave.length_mm * times * np.asarray(direction)
            other = amslicer.noise.sample("wave", x + dx, y + dy, **keys)
            worst = max(worst, abs(np.mean(g * other.conj())) / np.mean(np.abs(g) ** 2))
    print(f"correlation at most {worst:.3f} (by chance up to about {3.5 / np.sqrt(count):.3f})")
    assert worst <= 4.5 / np.sqrt(count)


@pytest.mark.parametrize(
    ("key", "expected"),
    [("time", np.abs(np.cos(2 * np.pi * MOMENTS))), ("fourth", np.abs(np.sinc(2 * MOMENTS)))],
    ids=["time", "fourth"],
)
def test_a_series_keeps_its_spectrum_and_changes_steadily(tmp_path: Path, key: str, expected: Floats) -> None:
    """Waves that have moved by ±t, or by v t with v even in ±1: what is left alike is the mean of cos(2π v t)."""
    moments = (*MOMENTS, 3.3)
    spectra: list[Floats] = []
    means = np.zeros(len(moments))
    for seed in (1, 2, 3):
        series = [field(tmp_path, seed=seed, directions=40, spectrum="laminate", **{key: float(t)}) for t in moments]
        spectra.append(np.array([power_of(g.real) for g in series]))
        first = series[0]
        means += [abs(np.vdot(first, g)) / np.sqrt(np.vdot(first, first).real * np.vdot(g, g).real) for g in series]
    power = np.mean(spectra, axis=0)
    ring = np.rint(RADIUS * BLOCK * STEP / 2).astype(int).ravel()
    radial = np.array([np.bincount(ring, p.ravel()) / np.bincount(ring) for p in power])
    off = np.abs(radial - radial[0]).max(axis=1) / radial[0].max()
    alike = means / 3
    print(f"{key} {moments}: spectrum off by {np.round(100 * off, 1)} %, correlation {np.round(alike, 3)}")
    assert off.max() <= 0.05
    np.testing.assert_allclose(alike[:4], expected, atol=0.03)
    assert alike[4] < 0.1


@pytest.mark.parametrize(("isotropy", "low", "high"), [(0.0, 0.98, 1.0), (0.5, 0.53, 0.58), (1.0, 0.25, 0.31)])
def test_isotropy_spreads_directions(tmp_path: Path, isotropy: float, low: float, high: float) -> None:
    """Energy within ±25° of the normal: all at 0, 25/45 of what is even over ±45°, 25/90 of all directions."""
    shares = []
    for seed in range(1, 5):
        power = power_of(field(tmp_path, seed=seed, isotropy=isotropy, orientation=30.0).real)
        angle = np.rad2deg(np.arctan2(FREQUENCY[:, None], FREQUENCY)) * -1  # row 0 is the largest y
        off = np.abs((angle - 30 + 90) % 180 - 90)
        shares.append(power[off <= 25].sum())
    share = float(np.mean(shares))
    print(f"isotropy {isotropy}: {share:.3f} of the energy within ±25°")
    assert low <= share <= high


def test_directions_are_enough() -> None:
    """As many as the method asks for at bandwidth 0.5, and no further apart than a lobe is wide at any."""
    assert default_directions(0.5, 2) >= 22
    assert default_directions(0.5, 3) >= 300
    for bandwidth in (0.1, 0.25, 0.5):
        width = bandwidth / np.sqrt(4 * np.pi)
        assert np.pi / default_directions(bandwidth, 2) <= 1.02 * width
        assert 2 * np.pi / default_directions(bandwidth, 3) <= 1.1 * width**2


@pytest.mark.parametrize("count", [4, 5, 22, 37, 300, 301])
def test_parts_of_the_half_sphere_are_alike(count: int) -> None:
    """All of the same solid angle, and together even: the mean of n nᵀ is ⅓."""
    parts_of = half_sphere(count)
    assert len(parts_of.azimuth) == count
    np.testing.assert_allclose(parts_of.azimuth[:, 1] * parts_of.height[:, 1], 2 * np.pi / count, rtol=1e-12)
    share = np.random.default_rng(1).random((100_000, 2))
    n = parts_of.directions(share, np.arange(100_000) % count)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0)
    np.testing.assert_allclose(n.T @ n / len(n), np.eye(3) / 3, atol=0.01)


@pytest.mark.parametrize("reads", ["real", "modulus"])
@pytest.mark.parametrize("spectrum", ["laminate", "white", "brown"])
@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
def test_ratio_of_values(tmp_path: Path, reads: str, spectrum: str, ratio: float) -> None:
    job = wave_job(tmp_path, (400, 400, 0.2), reads=reads, spectrum=spectrum, ratio=ratio, evaluate="lattice")
    share = float(np.mean(parts.bitmap(job) == 1))
    print(f"{spectrum}, {reads}: {share:.4f} of {ratio}")
    assert share == pytest.approx(ratio, abs=0.01)


@pytest.mark.parametrize("spectrum", ["crystal", "web"])
@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_ratio_of_crystals_and_webs(tmp_path: Path, spectrum: str, ratio: float, dimensions: int) -> None:
    """Their values are far from Gaussian: levels follow from the law of a sum of independent waves."""
    size = (600, 600, 0.4) if dimensions == 2 else (130, 130, 60)
    job = parts.job(
        parts.box(tmp_path, size), noise="wave", spectrum=spectrum, ratio=ratio, dimensions=dimensions,
        printer={"pitch_um": 500, "layer_um": 500},
    )  # fmt: skip
    labels = parts.labels(job)
    share = float(np.mean(labels == 1))
    print(f"{spectrum} in {dimensions}D: {share:.4f} of {ratio}")
    assert share == pytest.approx(ratio, abs=0.01)


def test_sectors_have_their_directions_alone(tmp_path: Path) -> None:
    """Section 4.3: waves from 10° to 40°, and 100° to 110°."""
    spec = {"sectors": [[10, 40], [100, 110]], "of": {"gaussian": 0.6, "width": 0.1}}
    power = np.mean([power_of(field(tmp_path, seed=s, spectrum=spec, directions=90).real) for s in (1, 2)], axis=0)
    angle = (-np.rad2deg(np.arctan2(FREQUENCY[:, None], FREQUENCY))) % 180
    first = (angle >= 7) & (angle <= 43)
    second = (angle >= 96) & (angle <= 114)
    shares = power[first].sum(), power[second].sum()
    print(f"{shares[0]:.3f} and {shares[1]:.3f} of the power, of 0.75 and 0.25")
    assert shares[0] == pytest.approx(0.75, abs=0.06)
    assert shares[1] == pytest.approx(0.25, abs=0.06)


def test_spectra_along_axes_are_mixed(tmp_path: Path) -> None:
    """Coarse along x, fine along y: the mean frequency of waves along each."""
    spec = {"along": [{"gaussian": 0.3, "width": 0.05}, {"gaussian": 0.9, "width": 0.05}, "white"]}
    power = np.mean([power_of(field(tmp_path, seed=s, spectrum=spec, directions=60).real) for s in (1, 2)], axis=0)
    angle = np.abs((np.rad2deg(np.arctan2(FREQUENCY[:, None], FREQUENCY)) + 90) % 180 - 90)
    along_x, along_y = angle < 15, angle > 75
    means = [float((power * RADIUS)[some].sum() / power[some].sum()) for some in (along_x, along_y)]
    print(f"mean frequency along x {means[0]:.3f}, along y {means[1]:.3f} per period")
    assert means[0] < 0.45
    assert means[1] > 0.8


def test_a_painted_period_is_the_local_one(tmp_path: Path) -> None:
    """Centroid of the power in strips across a period from 0.8 to 2.4 mm."""
    job = wave_job(
        tmp_path, (160.0, 160.0, 0.2), isotropy=0.0, orientation=90.0, reads="phase",
        period={"gradient": {"axis": "x", "from": 0.8, "to": 2.4}},
    )  # fmt: skip
    g = amslicer.field(job, 0)
    for first in range(0, 800, 200):
        strip = g[:, first + 60 : first + 140]
        power = np.mean(np.abs(np.fft.fft(strip * np.hanning(800)[:, None], axis=0)) ** 2, axis=1)
        f = np.abs(np.fft.fftfreq(800, STEP))
        period = 0.8 + 1.6 * (first + 100) / 800
        near = np.abs(f * period - 1) < 0.6
        centroid = float((power * f)[near].sum() / power[near].sum())
        print(f"period {period:.2f} mm: centroid at {centroid * period:.3f}/p")
        assert centroid * period == pytest.approx(1.0, abs=0.06)


def test_waves_do_not_jump_where_the_direction_turns(tmp_path: Path) -> None:
    """At isotropy 1, where the direction goes round, G changes from pixel to pixel as where it is straight."""
    steepest = []
    for orientation in (0.0, {"expression": "9*x"}):
        job = wave_job(tmp_path, (40.0, 40.0, 0.2), orientation=orientation, reads="phase")
        g = amslicer.field(job, 0)
        steepest.append(max(float(np.abs(np.diff(g, axis=a)).max()) for a in (0, 1)))
    print(f"largest step {steepest[0]:.3f} where straight, {steepest[1]:.3f} where it turns")
    assert steepest[1] <= 1.35 * steepest[0]
