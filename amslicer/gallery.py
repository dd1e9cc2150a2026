"""Every noise with every profile, as pictures: fields, materials, what painting does to them, and spectra.

All of it is evaluated by `amslicer.noise.sample` in plain NumPy: no part, no device.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from amslicer.noise import NOISES, sample
from amslicer.pictures import BACKGROUND, GAP, INK, TEXT_HEIGHT
from amslicer.profiles import PROFILES
from amslicer.reference import cyclic_labels, symmetric_labels
from amslicer.specification import DEFAULT_COLORS

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Picture = NDArray[np.uint8]

PIXELS, PERIODS = 200, 10.0  # of a picture's side
BANDWIDTH, ORIENTATION, SEED = 0.5, 30.0, 1
TWO, THREE = (0.3,), (0.2, 0.55)  # cumulative ratios
SPECTRUM_PERIODS, SPECTRUM_REACH = 40.0, 2.5  # of the plane whose spectrum is shown; up to this many cycles a period
DECADES = 3.0  # of power that a spectrum shows


def pictures(noise: str) -> Iterator[tuple[str, Picture | None]]:
    """The pictures of a noise, (PIXELS, PIXELS, 3) with row 0 at the top; None where there is no such thing.

    The real part, two materials, three materials by each profile, painted fields, the spectrum of two.
    """
    g = sample(noise, *_plane(PERIODS), orientation=ORIENTATION, bandwidth=BANDWIDTH, seed=SEED)
    yield "value Re G", _grey(g.real)
    yield "pwm, 30 %", _colored(_labels(noise, g, TWO, "pwm"))
    for profile in ("symmetric", "cyclic"):
        built = NOISES[noise].reads == "phase" or not PROFILES[profile].arrows
        yield f"{profile}, three materials", _colored(_labels(noise, g, THREE, profile)) if built else None
    # Around the middle; ratio from 0.1 at the left to 0.9, isotropy from 0 below to 1.
    x, y = _plane(PERIODS)
    middle = PERIODS / 2
    painted = sample(
        noise, x, y, bandwidth=BANDWIDTH, seed=SEED,
        orientation=lambda p: np.rad2deg(np.arctan2(p[:, 1] - middle, p[:, 0] - middle)),
        isotropy=lambda p: np.clip(p[:, 1] / PERIODS, 0.0, 1.0),
    )  # fmt: skip
    yield "painted", _colored(_labels(noise, painted, (0.1 + 0.8 * np.clip(x / PERIODS, 0, 1),), "pwm"))
    yield "spectrum of pwm", _spectrum(noise)


def sheet(rows: Mapping[str, Sequence[tuple[str, Picture | None]]]) -> Image:
    """All pictures of all noises, with their names.

    Args:
        rows: the pictures of each noise.
    """
    from PIL import Image, ImageDraw, ImageFont

    columns = max(len(row) for row in rows.values())
    width, height = columns * (PIXELS + GAP) + GAP, len(rows) * (PIXELS + TEXT_HEIGHT + GAP) + TEXT_HEIGHT + 2 * GAP
    out = Image.new("RGB", (width, height), BACKGROUND)
    draw, font = ImageDraw.Draw(out), ImageFont.load_default(size=14)
    caption = (
        f"{PERIODS:g} periods a side, bandwidth {BANDWIDTH:g}; painted: direction from the middle, ratio from left to "
        "right, isotropy from bottom to top"
    )
    draw.text((GAP, GAP), caption, fill=INK, font=font)
    for r, (noise, row) in enumerate(rows.items()):
        top = 2 * GAP + TEXT_HEIGHT + r * (PIXELS + TEXT_HEIGHT + GAP)
        for c, (name, picture) in enumerate(row):
            left = GAP + c * (PIXELS + GAP)
            draw.text((left, top), f"{noise}: {name}" if c == 0 else name, fill=INK, font=font)
            if picture is None:
                draw.text((left + GAP, top + TEXT_HEIGHT + PIXELS // 2), "needs a phase", fill=INK, font=font)
            else:
                out.paste(Image.fromarray(picture), (left, top + TEXT_HEIGHT))
    return out


def _plane(periods: float) -> tuple[Floats, Floats]:
    """x and y of the pixels of a square, row 0 at the largest y; the period is 1."""
    at: Floats = (np.arange(PIXELS, dtype=np.float64) + 0.5) * (periods / PIXELS)
    return at[None, :], at[::-1, None]


def _labels(noise: str, g: Complexes, cumulative: tuple[float | Floats, ...], profile: str) -> NDArray[np.uint8]:
    maker = NOISES[noise]
    if maker.reads == "value":
        made = maker(periods_mm=(1.0, 1.0), bandwidth=BANDWIDTH, dimensions=2, seed=SEED)
        levels = [made.levels_of(np.asarray(c)) for c in cumulative]
        return np.asarray(1 + sum((g.real <= level).astype(np.uint8) for level in levels), np.uint8)
    label = cyclic_labels if PROFILES[profile].arrows else symmetric_labels
    return label(g, np.stack([np.broadcast_to(np.asarray(c, np.float64), g.shape) for c in cumulative]))


def _grey(values: Floats) -> Picture:
    most = np.quantile(np.abs(values), 0.99)
    return np.repeat((127.5 + 127.5 * np.clip(values / most, -1, 1)).astype(np.uint8)[..., None], 3, axis=-1)


def _colored(labels: NDArray[np.uint8]) -> Picture:
    palette = np.array([BACKGROUND, *(tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in DEFAULT_COLORS)])
    return palette[labels].astype(np.uint8)


def _spectrum(noise: str) -> Picture:
    """Power of two equal materials, on a logarithmic scale; the middle is frequency 0."""
    g = sample(noise, *_plane(SPECTRUM_PERIODS), orientation=ORIENTATION, bandwidth=BANDWIDTH, seed=SEED)
    signed = np.where(_labels(noise, g, (0.5,), "pwm") == 1, 1.0, -1.0)
    window = np.hanning(PIXELS)
    power = np.abs(np.fft.fftshift(np.fft.fft2(signed * window * window[:, None]))) ** 2
    reach = round(SPECTRUM_REACH * SPECTRUM_PERIODS)
    power = power[PIXELS // 2 - reach : PIXELS // 2 + reach, PIXELS // 2 - reach : PIXELS // 2 + reach]
    shade = np.clip(1 + np.log10(np.maximum(power / power.max(), 1e-12)) / DECADES, 0, 1)
    rows = np.arange(PIXELS) * (2 * reach) // PIXELS
    return np.repeat((255 * shade[rows][:, rows]).astype(np.uint8)[..., None], 3, axis=-1)
