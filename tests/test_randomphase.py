"""Random-phase textures: the laws of the paper (Galerne, Gousseau and Morel 2011), and what can be said exactly."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.ndimage import gaussian_filter

from amslicer import randomphase
from amslicer.exemplar import periodic_component
from amslicer.randomphase import (
    Frames,
    Kind,
    asymptotic_spot,
    extended_spot,
    quantiles,
    random_phase,
    sample_bilinear,
    uniform_phase,
)  # fmt: skip

Floats = NDArray[np.float64]
SIDES = [(16, 24), (15, 24), (16, 21), (15, 21)]
KINDS: tuple[Kind, Kind] = ("random-phase", "asymptotic-spot")
SIGNIFICANCE = 0.01


def grain(shape: tuple[int, ...], seed: int = 0, width: float = 1.2) -> Floats:
    """A piece of an isotropic texture that does not close at its borders."""
    large = np.random.default_rng(seed).standard_normal((shape[0] + 40, shape[1] + 40, *shape[2:]))
    smooth = gaussian_filter(large, (width, width, *(0,) * (len(shape) - 2)))[20:-20, 20:-20]
    return np.asarray(0.5 + 0.1 * smooth / smooth.std())


def spectrum(picture: Floats) -> NDArray[np.complex128]:
    return np.fft.fft2(picture, axes=(0, 1))


def own_conjugates(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    return list(product(*((0, n // 2) if n % 2 == 0 else (0,) for n in shape[:2])))


def one_of_each_pair(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Frequencies of which each stands for itself and its negative; none of them is its own."""
    rows, columns = np.indices(shape[:2])
    number, mirrored = rows * shape[1] + columns, (-rows % shape[0]) * shape[1] + (-columns % shape[1])
    return np.asarray(number < mirrored)


# Uniform random phase


@pytest.mark.parametrize("shape", [*SIDES, (8, 9), (2, 2), (1, 6)])
def test_a_uniform_phase_is_odd_and_that_of_a_real_picture(shape: tuple[int, int]) -> None:
    theta = uniform_phase(shape, 7)
    assert theta.shape == shape
    assert (theta > -np.pi).all()
    assert (theta <= np.pi).all()
    mirrored = np.roll(theta[::-1, ::-1], (1, 1), (0, 1))
    np.testing.assert_allclose(np.exp(1j * (theta + mirrored)), 1, rtol=0, atol=1e-12)
    assert all(theta[at] in (0, np.pi) for at in own_conjugates(shape))
    assert theta[0, 0] == 0
    picture = np.fft.ifft2(np.exp(1j * theta))
    assert np.abs(picture.imag).max() < 1e-12


def test_a_uniform_phase_is_uniform_and_each_draw_is_another() -> None:
    shape = (64, 63)
    chosen = one_of_each_pair(shape)
    which = ((1, 0), (2, 0), (1, 1), (1, -1), (2**64 - 1, 5))
    draws = [uniform_phase(shape, seed, frame)[chosen] for seed, frame in which]
    for theta in draws:
        p_value = stats.kstest(theta, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue
        print(f"uniform: p = {p_value:.3f}")
        assert p_value > SIGNIFICANCE
    for i, j in product(range(len(draws)), repeat=2):
        together = abs(np.exp(1j * (draws[i] - draws[j])).mean())
        assert together == 1 if i == j else together < 4 / np.sqrt(len(draws[0]))


def test_signs_of_frequencies_that_are_their_own_conjugates_are_even() -> None:
    """0 or π with probability ½: of 400 draws of three frequencies, 600 ± 4 standard deviations."""
    found = sum(uniform_phase((4, 4), seed)[at] == np.pi for seed in range(400) for at in ((0, 2), (2, 0), (2, 2)))
    assert abs(found - 600) < 4 * np.sqrt(300)


# Random-phase noise and asymptotic spot noise


@pytest.mark.parametrize("shape", SIDES)
@pytest.mark.parametrize("position", [0.0, 3.0, 0.3, 0.5, 0.999, -1.75])
def test_random_phase_keeps_the_modulus_of_every_frequency(shape: tuple[int, int], position: float) -> None:
    """At every height between two frames, too."""
    p = periodic_component(grain((*shape, 3), 1))
    found = Frames(p, "random-phase", 11).at(position)
    error = np.abs(np.abs(spectrum(found)) / np.abs(spectrum(p)) - 1).max()
    print(f"modulus: relative error {error:.1e}")
    assert error < 1e-5
    assert np.abs(found - p).max() > 0.05


@pytest.mark.parametrize("position", [0.0, 0.5])
def test_asymptotic_spot_noise_has_rayleigh_moduli_and_uniform_phases(position: float) -> None:
    """Section 4: the white noise's Fourier modulus is Rayleigh; E|Ŷ|² = MN makes its scale 1/√2. Of blends as well."""
    shape = (60, 64)
    p = periodic_component(grain(shape, 2))
    chosen = one_of_each_pair(shape)

    def moduli(kind: Kind) -> Floats:
        return np.abs(spectrum(Frames(p, kind, 5).at(position)) / spectrum(p))[chosen]

    factor = (spectrum(Frames(p, "asymptotic-spot", 5).at(position)) / spectrum(p))[chosen]
    modulus = stats.kstest(moduli("asymptotic-spot"), stats.rayleigh(scale=np.sqrt(0.5)).cdf).pvalue
    phase = stats.kstest(np.angle(factor), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue
    print(f"Rayleigh: p = {modulus:.3f}; uniform: p = {phase:.3f}; {len(factor)} frequencies")
    assert modulus > SIGNIFICANCE
    assert phase > SIGNIFICANCE
    assert stats.kstest(moduli("random-phase"), stats.rayleigh(scale=np.sqrt(0.5)).cdf).pvalue < 1e-9


@pytest.mark.parametrize("shape", [(6, 5), (7, 8)])
def test_asymptotic_spot_noise_is_a_convolution_with_white_noise(shape: tuple[int, int]) -> None:
    """Theorem 2, summed pixel by pixel; of a spot of one pixel the noise Y itself can be read, but for its mean."""
    pixels = shape[0] * shape[1]
    point = np.zeros(shape)
    point[0, 0] = 1.0
    y = np.sqrt(pixels) * (asymptotic_spot(point, 9) - point.mean())
    h = np.random.default_rng(4).uniform(0, 1, shape)
    expected = np.full(shape, h.mean())
    for at in np.ndindex(shape):
        for u in np.ndindex(shape):
            shifted = (at[0] - u[0]) % shape[0], (at[1] - u[1]) % shape[1]
            expected[at] += (h[shifted] - h.mean()) * y[u] / np.sqrt(pixels)
    np.testing.assert_allclose(asymptotic_spot(h, 9), expected, rtol=0, atol=1e-12)


def test_the_noise_is_gaussian_and_white() -> None:
    point = np.zeros((80, 81))
    point[0, 0] = 1.0
    y = np.sqrt(point.size) * (asymptotic_spot(point, 3) - point.mean())
    p_value = stats.kstest(y.ravel(), stats.norm.cdf).pvalue
    print(f"N(0, 1): p = {p_value:.3f}")
    assert p_value > SIGNIFICANCE
    for step in ((0, 1), (1, 0), (1, 1)):
        assert abs((y * np.roll(y, step, (0, 1))).mean()) < 4 / np.sqrt(y.size)


@pytest.mark.parametrize("kind", KINDS)
def test_the_covariance_is_the_spots_autocorrelation(kind: Kind) -> None:
    """Equation (1): over many seeds, at every pair of pixels, whichever the process."""
    h = periodic_component(grain((5, 6), 3))
    draws, d = 2000, h - h.mean()
    z = np.stack([(Frames(h, kind, seed).at(0) - h.mean()).ravel() for seed in range(draws)])
    found = z.T @ z / draws
    places = list(np.ndindex(h.shape))
    expected = np.array([
        [np.mean(d * np.roll(d, (b[0] - a[0], b[1] - a[1]), (0, 1))) for b in places] for a in places
    ])  # fmt: skip
    error = np.abs(found - expected).max() / d.var()
    print(f"{kind}: covariance within {error:.3f} of the variance, from {draws} textures")
    assert error < 5 * np.sqrt(2 / draws)  # five standard errors of a variance
    assert np.abs(expected - np.diag(np.diag(expected))).max() > 0.2 * d.var(), "white: nothing to find"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SIDES)
def test_the_mean_stays(kind: Kind, shape: tuple[int, int]) -> None:
    p = periodic_component(grain((*shape, 3), 4) + np.array([0.1, 0.2, 0.3]))
    for position in (0, 0.4):
        found = Frames(p, kind, 1).at(position)
        np.testing.assert_allclose(found.mean(axis=(0, 1)), p.mean(axis=(0, 1)), rtol=0, atol=1e-12)
        assert found.shape == p.shape


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("position", [0, 0.3])
def test_colours_keep_the_phase_differences_between_channels(kind: Kind, position: float) -> None:
    """Section 5.1: between every two channels at every frequency."""
    p = periodic_component(grain((20, 27, 3), 5))
    before, after = spectrum(p), spectrum(Frames(p, kind, 2).at(position))
    for a, b in ((0, 1), (1, 2), (0, 2)):
        cross = [s[..., a] * s[..., b].conj() for s in (before, after)]
        turned = np.abs(np.angle(cross[1] * cross[0].conj()))
        print(f"{kind}: phase differences change by up to {turned.max():.1e} rad")
        assert turned.max() < 1e-7
    assert np.abs(np.angle(after[..., 0] * before[..., 0].conj())).mean() > 1, "its own phases are new"


@pytest.mark.parametrize("kind", KINDS)
def test_no_colour_appears_that_the_exemplar_does_not_have(kind: Kind) -> None:
    """Of a picture whose colours lie on a line, the texture's do (figure 7: a "wrong" RPN leaves it)."""
    base = periodic_component(grain((18, 25), 6))
    p = np.stack([base, 0.2 + 0.5 * base, 0.9 - 2 * base], axis=-1)
    for picture in (random_phase(p, 3), Frames(p, kind, 3).at(1.5), Frames(extended_spot(p, (30, 41)), kind, 3).at(0)):
        np.testing.assert_allclose(picture[..., 1], 0.2 + 0.5 * picture[..., 0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(picture[..., 2], 0.9 - 2 * picture[..., 0], rtol=0, atol=1e-12)


# The sum of two oscillations: figure 6

SIDE = 64
WAVES = np.array([[3, 1], [-2, 7]])  # periods along rows and columns
AMPLITUDES = np.array([0.3, 0.2])


def bisinusoid(shift: Floats) -> Floats:
    """A sum of two waves over a square, moved by a shift in pixels."""
    place = np.stack(np.indices((SIDE, SIDE)), axis=-1) - shift
    return np.asarray(np.sin(2 * np.pi * place @ WAVES.T / SIDE) @ AMPLITUDES)


def fitted(picture: Floats) -> tuple[Floats, float]:
    """Amplitudes of the two waves, and how far the picture is from the translation that their phases speak for."""
    at = spectrum(picture)[tuple(WAVES.T)]
    shift = np.linalg.solve(WAVES, -(np.angle(at) + np.pi / 2) * SIDE / (2 * np.pi))
    return 2 * np.abs(at) / SIDE**2, float(np.abs(picture - bisinusoid(shift)).max())


@pytest.mark.parametrize("seed", range(6))
def test_random_phase_of_two_waves_is_a_translation_and_spot_noise_is_not(seed: int) -> None:
    h = bisinusoid(np.zeros(2))
    assert fitted(bisinusoid(np.array([5.25, -3.5])))[1] < 1e-9
    amplitudes, apart = fitted(random_phase(h, seed))
    np.testing.assert_allclose(amplitudes, AMPLITUDES, rtol=1e-9)
    assert apart < 1e-9
    assert np.abs(random_phase(h, seed) - h).max() > 0.1, "it has not moved"
    off = fitted(asymptotic_spot(h, seed))[1]
    print(
        f"seed {seed}: random phase is {apart:.1e} from a translation, spot noise {off:.2f} of {AMPLITUDES.sum():.1f}"
    )
    assert off > 0.02


def test_spot_noise_favours_one_of_two_waves() -> None:
    """Their ratio is that of two independent Rayleigh variables, so its square has the F distribution of 2 and 2."""
    h = bisinusoid(np.zeros(2))
    found = np.array([fitted(asymptotic_spot(h, seed))[0] for seed in range(300)]) / AMPLITUDES
    ratio = found[:, 0] / found[:, 1]
    p_value = stats.kstest(ratio**2, stats.f(2, 2).cdf).pvalue
    print(f"amplitudes' ratio: × {ratio.min():.2f} … {ratio.max():.2f}; F(2, 2): p = {p_value:.3f}")
    assert p_value > SIGNIFICANCE


# Larger textures


@pytest.mark.parametrize("own", [(24, 30), (25, 31)])
@pytest.mark.parametrize("shape", [(48, 64), (47, 65), (24, 64), (60, 31), (500, 33)])
def test_an_extended_spot_has_the_mean_and_the_variance_of_its_exemplar(
    own: tuple[int, int], shape: tuple[int, int]
) -> None:
    p = periodic_component(grain((*own, 3), 7) + np.array([0.1, 0.3, 0.2]) * grain((*own, 3), 8))
    spot = extended_spot(p, shape)
    assert spot.shape == (max(own[0], shape[0]), max(own[1], shape[1]), 3)
    for picture in (spot, random_phase(spot, 4)):
        mean = np.abs(picture.mean(axis=(0, 1)) - p.mean(axis=(0, 1))).max()
        variance = np.abs(picture.var(axis=(0, 1)) / p.var(axis=(0, 1)) - 1).max()
        print(f"{own} to {shape}: mean within {mean:.1e}, variance within {variance:.1e}")
        assert mean < 1e-6
        assert variance < 1e-3


def test_a_spot_lies_in_the_middle_and_fades_as_in_figure_9() -> None:
    """Gaussian flanks of α/4 over the first and last α = 0.2 of the side, flat between; constant around it."""
    own, shape = (40, 30), (80, 90)
    p = np.indices(own).sum(axis=0) % 2 - 0.5  # ± ½
    spot = extended_spot(p, shape)
    around = spot[0, 0]
    inside = np.zeros(shape, np.bool_)
    inside[20:60, 30:60] = True
    assert (spot[~inside] == around).all()
    found = np.abs(spot - around)[20:60, 30:60]

    def profile(count: int) -> Floats:
        t = (np.arange(count) + 0.5) / count
        depth = np.minimum(t, 1 - t)
        return np.where(depth < 0.2, np.exp(-((0.2 - depth) ** 2) / (2 * 0.05**2)), 1.0)

    expected = profile(40)[:, None] * profile(30)
    np.testing.assert_allclose(found / found.max(), expected, rtol=0, atol=1e-3)
    # The paper's factor √(M2 N2 / M1 N1), with φ of mean square 1: nothing else is needed here, for p - m is ± ½.
    factor = np.sqrt(80 * 90 / (40 * 30) / np.mean(expected**2))
    np.testing.assert_allclose(found.max(), 0.5 * factor, rtol=1e-3)


def test_a_spot_of_its_own_size_stays_and_a_smaller_one_is_not_cropped() -> None:
    p = periodic_component(grain((20, 26), 8))
    for shape in ((20, 26), (3, 26), (20, 1)):
        np.testing.assert_allclose(extended_spot(p, shape), p, rtol=0, atol=1e-12)
    taller = extended_spot(p, (45, 10))
    assert taller.shape == (45, 26)
    expected = np.abs(np.diff(p[10]))  # along the axis where it is periodic it does not fade: one row is one factor
    ratio = np.abs(np.diff(taller[12 + 10])) / expected
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_constant_channel_stays(channels: tuple[int, ...]) -> None:
    p = periodic_component(grain((16, 16, *channels), 9))
    if channels:
        p[..., 1] = 0.25
        np.testing.assert_allclose(random_phase(extended_spot(p, (30, 30)), 1)[..., 1], 0.25, rtol=0, atol=1e-12)
    assert extended_spot(p, (30, 30)).shape == (30, 30, *channels)


def test_extended_textures_look_like_the_exemplar_near_by() -> None:
    """Section 5.3: "the autocorrelation of both spots is close for small distances"."""
    p = periodic_component(grain((96, 96), 10, width=1.5))
    large = random_phase(extended_spot(p, (225, 243)), 6)

    def correlation(picture: Floats, step: tuple[int, int]) -> float:
        d = picture - picture.mean()
        return float((d * np.roll(d, step, (0, 1))).mean() / d.var())

    for step in ((0, 1), (1, 0), (2, 1), (0, 3), (3, 3)):
        one, other = correlation(p, step), correlation(large, step)
        print(f"step {step}: {one:.3f} and {other:.3f}")
        assert other == pytest.approx(one, abs=0.08)


# What does not close at its borders

LOW = 12  # frequencies that a picture's own large features may have


def cross(picture: Floats) -> float:
    """Energy at the frequencies along the two axes, relative to that of the lines beside them."""
    energy = np.abs(np.fft.fftshift(spectrum(picture - picture.mean()))) ** 2
    on = beside = 0.0
    for e in (energy, energy.T):
        row, column = e.shape[0] // 2, e.shape[1] // 2
        far = np.abs(np.arange(e.shape[1]) - column) > LOW
        on += e[row, far].mean()
        beside += np.concatenate([e[row - 10 : row - 3, far], e[row + 4 : row + 11, far]]).mean()
    return on / beside


@pytest.mark.parametrize("kind", KINDS)
def test_textures_have_no_cross_in_their_spectrum(kind: Kind) -> None:
    """Figure 8: light that falls from one side makes stripes, unless the periodic component is taken first.

    Means over several exemplars: the energy at a frequency is as uncertain as its mean, that of spot noise more.
    """
    found: dict[str, list[float]] = {"raw": [], "periodic": [], "extended": [], "blended": []}
    ramp = np.linspace(0, 1, 192)
    for seed in range(8):
        h = grain((192, 192), seed, width=0.5) + 0.3 * ramp + 0.2 * ramp[:, None]
        p = periodic_component(h)
        frames = Frames(extended_spot(p, (315, 297)), kind, seed)
        found["raw"].append(cross(Frames(h, kind, seed).at(0)))
        found["periodic"].append(cross(Frames(p, kind, seed).at(0)))
        found["extended"].append(cross(frames.at(0)))
        found["blended"].append(cross(frames.at(0.4)))
    means = {name: float(np.mean(values)) for name, values in found.items()}
    print(f"{kind}, energy on the cross: " + ", ".join(f"{name} {mean:.2f}" for name, mean in means.items()))
    assert min(found["raw"]) > 1.5
    assert max(means["periodic"], means["extended"], means["blended"]) < 1.5


# Frames


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_bytes_and_another_another_texture(kind: Kind) -> None:
    p = periodic_component(grain((33, 35), 11))
    make = random_phase if kind == "random-phase" else asymptotic_spot
    frames = Frames(p, kind, 8)
    visited = {position: frames.at(position) for position in (2, 2.5, 3, -1, -0.25, 0, 1, 0.75)}
    for frame in (-1, 0, 1, 2, 3):
        assert visited[frame].tobytes() == make(p, 8, frame).tobytes()
    for position, texture in visited.items():
        assert frames.at(position).tobytes() == texture.tobytes(), "whatever came before"
    d = p.std()
    alike = np.corrcoef([make(p, seed, frame).ravel() for seed, frame in ((8, 0), (9, 0), (8, 1), (8, -1))])
    assert np.abs(alike - np.eye(4)).max() < 0.5
    assert np.abs(make(p, 8) - make(p, 9)).max() > d


def test_the_words_are_the_published_ones() -> None:
    """Philox-4x64-10 of Salmon et al. 2011, counter and key 0: their known answer. NumPy counts up first."""
    bits = np.random.Philox(key=np.zeros(2, np.uint64), counter=np.full(4, 2**64 - 1, np.uint64))
    expected = [0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]
    assert [int(word) for word in bits.random_raw(4)] == expected


def test_no_two_uses_share_a_stream() -> None:
    """Seeds, frames and purposes: 64-bit words, so that even the first of them would hardly meet by chance."""
    uses = product((0, 1, 2**32, 2**64 - 1), (0, 1, -1, 2**32), (randomphase.PHASES, randomphase.NOISE))
    streams = [randomphase._uniform(9, *use) for use in uses]
    assert len(np.unique(streams)) == 32 * 9
    np.testing.assert_array_equal(streams[0], randomphase._uniform(12, 0, 0, randomphase.PHASES)[:9])


@pytest.mark.parametrize("kind", KINDS)
def test_frames_change_without_a_step_and_keep_their_contrast(kind: Kind) -> None:
    """Sides are odd: no frequency but 0 is its own conjugate."""
    p = periodic_component(grain((45, 45), 13))
    frames = Frames(p, kind, 4)
    for position in (0.0, 0.25, 0.5, 1.0, 1.5, -0.5):
        moved = np.abs(frames.at(position + 1e-7) - frames.at(position - 1e-7)).max()
        assert moved < 1e-5 * p.std(), position
    contrast = [frames.at(position).std() / p.std() for position in np.linspace(0, 3, 13)]
    print(f"{kind}: contrast {min(contrast):.4f} … {max(contrast):.4f}")
    if kind == "random-phase":
        np.testing.assert_allclose(contrast, 1, rtol=0, atol=1e-10)
    else:
        assert 0.85 < min(contrast) < max(contrast) < 1.15
    plain = 0.5 * (frames.at(0) + frames.at(1))
    assert plain.std() < 0.85 * p.std(), "what blending values would lose: √½"


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_blended_phases_are_uniform_and_go_the_shorter_way(share: float) -> None:
    shape = (61, 63)
    p = periodic_component(grain(shape, 14))
    frames, chosen = Frames(p, "random-phase", 6), one_of_each_pair(shape)
    start, between, end = (spectrum(frames.at(at))[chosen] / spectrum(p)[chosen] for at in (0, share, 1))
    assert stats.kstest(np.angle(between), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > SIGNIFICANCE
    np.testing.assert_allclose(np.angle(between / start), share * np.angle(end / start), rtol=0, atol=1e-7)


# Samples and quantiles

PICTURE = np.random.default_rng(15).uniform(0, 1, (5, 7, 2))


def bilinear(x: float, y: float) -> Floats:
    """The mean of all pixels, weighted by how near their centres, or those of their copies, are."""
    total = np.zeros(2)
    for r, c in np.ndindex(5, 7):
        near_x = max(max(0.0, 1 - abs(x - (c + 0.5) + copy)) for copy in (-14, -7, 0, 7, 14))
        near_y = max(max(0.0, 1 - abs(y - (r + 0.5) + copy)) for copy in (-10, -5, 0, 5, 10))
        total += near_x * near_y * PICTURE[r, c]
    return total


def test_samples_are_bilinear_and_periodic() -> None:
    places = np.random.default_rng(16).uniform(-6, 12, (200, 2))
    found = sample_bilinear(PICTURE, places[:, 0], places[:, 1])
    np.testing.assert_allclose(found, [bilinear(x, y) for x, y in places], rtol=0, atol=1e-12)
    again = sample_bilinear(PICTURE, places[:, 0] + 7 * 3, places[:, 1] - 5 * 4)
    np.testing.assert_allclose(again, found, rtol=0, atol=1e-12)


def test_pixel_centres_have_their_own_value() -> None:
    found = sample_bilinear(PICTURE, np.arange(7) + 0.5, np.arange(5)[:, None] + 0.5)
    np.testing.assert_array_equal(found, PICTURE)
    np.testing.assert_array_equal(sample_bilinear(PICTURE[..., 0], 2.5, 3.5), PICTURE[3, 2, 0])


@pytest.mark.parametrize("channels", [0, slice(None)])
def test_a_raster_is_its_points(channels: int | slice) -> None:
    picture = PICTURE[..., channels]
    x, y = np.linspace(-3, 9, 50)[None, :], np.linspace(-2, 11, 40)[:, None]
    points = sample_bilinear(picture, *(c.ravel() for c in np.broadcast_arrays(x, y)))
    raster = sample_bilinear(picture, x, y)
    assert raster.shape == (40, 50, *picture.shape[2:])
    np.testing.assert_array_equal(raster.reshape(points.shape), points)


SHARES = np.array([0.001, 0.01, 0.1, 0.25, 0.5, 0.7, 0.9, 0.99])


def test_quantiles_of_a_wave() -> None:
    """Of cos over its period, a share of arccos(v) / π lies above v."""
    wave = np.tile(np.cos(2 * np.pi * (np.arange(2048) + 0.5) / 2048), (8, 1))
    error = np.abs(np.arccos(quantiles(wave, SHARES)) / np.pi - SHARES).max()
    print(f"wave: shares within {error:.1e}")
    assert error < 1e-3


def test_quantiles_of_a_texture() -> None:
    """Against two million places of NumPy's own random numbers: ± 0.00035 at a half."""
    side = 40
    texture = random_phase(periodic_component(grain((side, side + 1), 17)), 2)
    x, y = np.random.default_rng(18).uniform(0, 1, (2, 2_000_000))
    values = np.sort(sample_bilinear(texture, x * (side + 1), y * side))
    levels = quantiles(texture, SHARES)
    above = 1 - np.searchsorted(values, levels, side="right") / len(values)
    print(f"texture: shares within {np.abs(above - SHARES).max():.1e}")
    assert np.abs(above - SHARES).max() < 1e-3
    pixels = 1 - np.searchsorted(np.sort(texture.ravel()), levels, side="right") / texture.size
    assert np.abs(pixels - SHARES).max() > 1e-3, "the pixels' own quantiles would do"


def test_quantiles_at_the_ends_leave_nothing_and_everything_above(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(randomphase, "PLACES", 1 << 12)
    texture = random_phase(periodic_component(grain((32, 32), 19)), 2)
    none, half, all_ = quantiles(texture, [[0.0, 0.5, 1.0]])[0]
    assert none == texture.max()
    assert all_ < texture.min() < half < none
    levels = quantiles(texture, np.linspace(0, 1, 101))
    assert (np.diff(levels) < 0).all()
