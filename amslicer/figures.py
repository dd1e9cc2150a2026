"""Figures of the papers, made again by amslicer.noise, so that a reader who knows them can compare.

Numbers are the papers': Tricard et al. 2019 (phasor) and Lagae et al. 2011 (Gabor).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer import gallery
from amslicer.noise import GaborKernel, gabor_noise, sample, varying_gabor_noise
from amslicer.profiles.waveforms import sawtooth, sine, square, triangle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Picture = NDArray[np.uint8]
    Row = tuple[str, list[tuple[str, Picture | None]]]

LOBES = (3, 4, 6, 8)  # Fig. 11 has 32 too, which look like as many as one likes
SUMS = (1, 2, 3, 5, 8, 16)  # harmonics of Fig. 13
PANELS = 5  # of the strips of phasor Fig. 1 and Gabor Fig. 15
SEEN_ERROR = 4.0  # times as dark as the noise


def figures() -> Iterator[Row]:
    """Rows of pictures, (gallery.PIXELS, gallery.PIXELS, 3) each, with their captions."""
    for name, row in ROWS.items():
        yield name, list(row())


@cache
def _field(noise: str, periods: float, lobes: tuple[tuple[float, float], ...] = (), isotropy: float = 0.0) -> Complexes:
    return sample(
        noise, *gallery.plane(periods), orientation=gallery.ORIENTATION, bandwidth=gallery.BANDWIDTH,
        seed=gallery.SEED, lobes=lobes, isotropy=isotropy,
    )  # fmt: skip


def _phase(g: Complexes) -> Floats:
    """Share of a turn."""
    return np.asarray(np.angle(g) / (2 * np.pi) % 1)


def _sine(g: Complexes) -> Floats:
    return np.sin(np.angle(g))


def _of_variance(values: Floats) -> Picture:
    """Spectrum of variance: of the squared values."""
    return gallery.spectrum(values**2)


def _blended_strip() -> Iterator[tuple[str, Picture]]:
    """A rectangle of 20 %, a square, a triangle and a sine from left to right, while the direction turns."""
    width = PANELS * gallery.PERIODS
    x, y = gallery.plane(gallery.PERIODS)
    for panel in range(PANELS):
        across = x + panel * gallery.PERIODS
        g = sample(
            "phasor", across, y, bandwidth=gallery.BANDWIDTH, seed=gallery.SEED,
            orientation=lambda p: -30 + 90 * p[:, 0] / width,
        )  # fmt: skip
        t, at = _phase(g), 3 * across / width
        waves = np.stack([square(t, 0.2), square(t), triangle(t), sine(t)])
        below = np.broadcast_to(np.clip(at.astype(int), 0, 2), t.shape)
        low, high = (np.take_along_axis(waves, (below + i)[None], axis=0)[0] for i in (0, 1))
        value = low + (at - below) * (high - low)
        yield ("rectangle, square, triangle, sine" if panel == 0 else ""), gallery.grey(value)


def _gabor_and_phasor() -> Iterator[tuple[str, Picture]]:
    near, far = _field("phasor", gallery.PERIODS), _field("phasor", gallery.SPECTRUM_PERIODS)
    yield "Re G, of Gabor noise", gallery.grey(near.real)
    yield "its spectrum of variance", _of_variance(far.real)
    yield "phasor sine", gallery.grey(_sine(near))
    yield "its spectrum of variance", _of_variance(_sine(far))


def _two_lobes() -> Iterator[tuple[str, Picture]]:
    for angle in (45.0, 90.0):
        lobes = ((0.0, 1.0), (angle, 1.0))
        near, far = (_field("phasor", periods, lobes) for periods in (gallery.PERIODS, gallery.SPECTRUM_PERIODS))
        yield f"{angle:g}° apart", gallery.grey(_sine(near))
        yield "spectrum of variance", _of_variance(_sine(far))
        if angle == 45:
            yield "of Re G", _of_variance(far.real)
            one, other = (
                sample("phasor", *gallery.plane(gallery.SPECTRUM_PERIODS), orientation=gallery.ORIENTATION + turn,
                       bandwidth=gallery.BANDWIDTH, seed=seed)
                for seed, turn in ((1, 0), (2, angle))
            )  # fmt: skip
            yield "pointing apart", _of_variance(_sine(one + other.conj()))


def _many_lobes() -> Iterator[tuple[str, Picture]]:
    for count in LOBES:
        lobes = tuple((180.0 * i / count, 1.0) for i in range(count))
        yield f"{count} lobes", gallery.grey(_sine(_field("phasor", gallery.PERIODS, lobes)))
        yield "spectrum of variance", _of_variance(_sine(_field("phasor", gallery.SPECTRUM_PERIODS, lobes)))


def _isotropy() -> Iterator[tuple[str, Picture]]:
    lobes = tuple((180.0 * i / LOBES[-1], 1.0) for i in range(LOBES[-1]))
    yield "directions at random", gallery.grey(_sine(_field("phasor", gallery.PERIODS, lobes)))
    yield "spectrum of variance", _of_variance(_sine(_field("phasor", gallery.SPECTRUM_PERIODS, lobes)))
    yield "locally coherent: isotropy 1", gallery.grey(_sine(_field("phasor", gallery.PERIODS, (), 1.0)))
    yield "spectrum of variance", _of_variance(_sine(_field("phasor", gallery.SPECTRUM_PERIODS, (), 1.0)))


def _additive_synthesis() -> Iterator[tuple[str, Picture]]:
    phase = np.angle(_field("phasor", gallery.PERIODS))
    for count in SUMS:
        total = sum(np.sin(h * phase) / h for h in range(1, count + 1))
        yield f"{count} harmonic{'s' if count > 1 else ''}", gallery.grey(np.asarray(total))
    yield "sawtooth", gallery.grey(sawtooth(phase / (2 * np.pi)))


def _controls() -> Iterator[tuple[str, Picture]]:
    x, y = gallery.plane(gallery.PERIODS)
    side = gallery.PERIODS
    ratio = np.broadcast_to(0.1 + 0.8 * x / side, (gallery.PIXELS, gallery.PIXELS))
    period = {"period": lambda p: 0.5 + np.clip(p[:, 1] / side, 0, 1)}
    turned = {"orientation": lambda p: np.rad2deg(np.arctan2(p[:, 1] - side / 2, p[:, 0] - side / 2))}
    for caption, share, settings in (
        ("frequency", 0.5, {"orientation": gallery.ORIENTATION, **period}),
        ("PWM width", ratio, {"orientation": gallery.ORIENTATION}),
        ("orientation", 0.5, turned),
        ("all together", ratio, {**period, **turned}),
    ):
        given: dict[str, Any] = settings
        g = sample("phasor", x, y, bandwidth=gallery.BANDWIDTH, seed=gallery.SEED, **given)
        yield caption, gallery.grey(np.where(np.abs(np.angle(g)) < np.pi * np.asarray(share), 1.0, -1.0))


def _quarters() -> Iterator[tuple[str, Picture]]:
    """The paper's, on its small picture: 25.007 % and 25.902 %, the latter by a threshold set by hand."""
    for noise in ("phasor", "gabor"):
        g = _field(noise, gallery.SPECTRUM_PERIODS)
        labels = gallery.labels(noise, g, (0.25,), "pwm")
        yield f"{noise}, 25 %: {100 * np.mean(labels == 1):.2f} %", gallery.grey(np.where(labels == 1, 1.0, -1.0))


def _profiled(periods: float) -> Iterator[tuple[str, Floats]]:
    g = _field("phasor", periods)
    yield "Re G, of Gabor noise", g.real
    for wave in (sine, square, triangle, sawtooth):
        yield wave.__name__, wave(_phase(g))


def _profiles() -> Iterator[tuple[str, Picture]]:
    yield from ((name, gallery.grey(values)) for name, values in _profiled(gallery.PERIODS))


def _profile_spectra() -> Iterator[tuple[str, Picture]]:
    yield from ((name, gallery.spectrum(values)) for name, values in _profiled(gallery.SPECTRUM_PERIODS))


def _profile_variance_spectra() -> Iterator[tuple[str, Picture]]:
    """A square's is 0 everywhere: its values are all 1 or -1."""
    for name, values in _profiled(gallery.SPECTRUM_PERIODS):
        if name != "square":
            yield name, _of_variance(values)


def _isotropic_gabor() -> Iterator[tuple[str, Picture]]:
    near, far = (_field("gabor-isotropic", p).real for p in (gallery.PERIODS, gallery.SPECTRUM_PERIODS))
    yield "isotropic Gabor noise", gallery.grey(near)
    yield "estimated power", gallery.spectrum(far)
    kernel = GaborKernel(1.0, gallery.BANDWIDTH, 1.0, 2)
    reach = gallery.SPECTRUM_REACH * (2 * (np.arange(gallery.PIXELS) + 0.5) / gallery.PIXELS - 1)
    yield "expected power", gallery.shaded(kernel.radial_power(np.hypot(reach, reach[:, None])))


def _truncation() -> Iterator[tuple[str, Picture]]:
    kernel = GaborKernel(0.7096, 0.0443528, 0.0625, 2)  # lengths in pixels
    at = np.arange(gallery.PIXELS) + 0.5
    points = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)

    def noise(error: float) -> Floats:
        values = gabor_noise(kernel, points, density=0.0233224, seed=1, radius=kernel.radius_of_error(error))
        return values.reshape(gallery.PIXELS, gallery.PIXELS)

    whole = noise(1e-4)
    most = float(np.quantile(np.abs(whole), 0.99))
    yield "not cut", gallery.grey(whole)
    for error in (0.25, 0.01):
        cut = noise(error)
        got = np.sqrt(np.mean((cut - whole) ** 2) / np.mean(whole**2))
        yield f"cut at {100 * error:g} %", gallery.grey(cut)
        yield f"error: {100 * got:.2f} %", gallery.grey(SEEN_ERROR * (cut - whole), most)


def _varying() -> Iterator[tuple[str, Picture]]:
    at = np.arange(gallery.PIXELS) + 0.5
    for panel in range(PANELS):
        points = np.stack(np.meshgrid(at + panel * gallery.PIXELS, at), axis=-1).reshape(-1, 2)
        octave = 3 * points[:, 0] / (PANELS * gallery.PIXELS)
        values = varying_gabor_noise(
            points, magnitude=0.7096, width=0.02218 * 2**octave, frequency=0.03125 * 2**octave, impulses=32, seed=1
        ) / 2**octave  # fmt: skip
        picture = gallery.grey(values.reshape(gallery.PIXELS, gallery.PIXELS), most=0.3)
        yield ("F0 from 0.031 to 0.25 a pixel" if panel == 0 else ""), picture


ROWS: dict[str, Callable[[], Iterator[tuple[str, Picture]]]] = {
    "phasor Fig. 1": _blended_strip,
    "phasor Fig. 4": _gabor_and_phasor,
    "phasor Figs 7 and 9": _two_lobes,
    "phasor Fig. 11": _many_lobes,
    "phasor Fig. 12": _isotropy,
    "phasor Fig. 13": _additive_synthesis,
    "phasor Fig. 15": _controls,
    "phasor Fig. 16": _quarters,
    "phasor Fig. 23": _profiles,
    "phasor Fig. 23: spectra": _profile_spectra,
    "phasor Fig. 23: spectra of variance": _profile_variance_spectra,
    "Gabor Fig. 4": _isotropic_gabor,
    "Gabor Fig. 10": _truncation,
    "Gabor Fig. 15": _varying,
}
FIGURES = len(ROWS)
