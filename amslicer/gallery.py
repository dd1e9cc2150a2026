"""Every noise with every profile, as pictures: fields, materials, what painting does to them, and spectra.

All of it is evaluated by `amslicer.noise.sample` in plain NumPy: no part, no device.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.analysis import DECADES, decades, power_map
from amslicer.exemplar import periodic_component
from amslicer.noise import NOISES, Noise, sample
from amslicer.noise.philox import words
from amslicer.noise.setting import Setting
from amslicer.pictures import BACKGROUND, GAP, INK, TEXT_HEIGHT
from amslicer.profiles import PROFILES, make_profile
from amslicer.profiles.waveforms import BlendShape, HarmonicsShape
from amslicer.reference import cyclic_labels, symmetric_labels
from amslicer.specification import DEFAULT_COLORS, Pattern

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

    from amslicer.profiles import ProfileSpec

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Picture = NDArray[np.uint8]

PIXELS, PERIODS = 200, 10.0  # of a picture's side
BANDWIDTH, ORIENTATION, SEED = 0.5, 30.0, 1
TWO, THREE = (0.3,), (0.2, 0.55)  # cumulative ratios
SPECTRUM_PERIODS, SPECTRUM_REACH = 40.0, 2.5  # of the plane whose spectrum is shown; up to this many cycles a period
SHEET_COLORS = 32  # of a sheet: greys and materials; a quarter of the bytes
HARMONICS = HarmonicsShape.model_validate({"harmonics": [0.4, 1]})
WAVEFORMS = {
    "harmonics, 40 %": HARMONICS,
    "sine to harmonics": BlendShape.model_validate({"blend": {"from": "sine", "to": HARMONICS, "by": 0.0}}),
}  # a blend goes from left to right here, whatever its field

# What is drawn: every noise, and wave noise of several spectra.
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in NOISES},
    "wave, modulus": ("wave", {"reads": "modulus"}),
    "wave, white": ("wave", {"spectrum": "white", "reads": "real"}),
    "wave, brown": ("wave", {"spectrum": "brown", "reads": "real"}),
    "wave, crystal": ("wave", {"spectrum": "crystal"}),
    "wave, web": ("wave", {"spectrum": "web"}),
}
GRAIN_PIXELS, GRAIN_PERIODS, GRAIN_FREQUENCY = (
    64,
    8.0,
    (1.2, 0.5),
)  # of the exemplar; its mean waves per period, x and y

CAPTION = (
    f"{PERIODS:g} periods a side, bandwidth {BANDWIDTH:g}; painted: direction from the middle, ratio from left to "
    "right, isotropy from bottom to top"
)


def pictures(row: str) -> Iterator[tuple[str, Picture | None]]:
    """The pictures of a row of ROWS, (PIXELS, PIXELS, 3) with row 0 at the top; None where there is no such thing.

    The real part, two materials, three materials by each profile, painted fields, the spectrum of two.
    """
    noise, keys = ROWS[row]
    made = _made(row)
    given = {key: value for key, value in keys.items() if key != "reads"}
    if "exemplar" in NOISES[noise].keys:
        given |= {"exemplar": grain(), "exemplar_pixel_mm": GRAIN_PERIODS / GRAIN_PIXELS}
    of_row: dict[str, Any] = {"bandwidth": BANDWIDTH, "seed": SEED, **given}
    # Waves of any spectrum are shown in all directions.
    turned: dict[str, Any] = {"orientation": ORIENTATION, "isotropy": 1.0 if "spectrum" in keys else 0.0}
    x, y = plane(PERIODS)
    g = sample(noise, x, y, **of_row, **turned)
    yield "value Re G", grey(g.real)
    yield "pwm, 30 %", _colored(labels(row, g, TWO, "pwm"))
    for profile in ("symmetric", "cyclic"):
        built = made.reads == "phase" or not PROFILES[profile].arrows
        yield f"{profile}, three materials", _colored(labels(row, g, THREE, profile)) if built else None
    # Around the middle; ratio from 0.1 at the left to 0.9, isotropy from 0 below to 1.
    middle = PERIODS / 2
    painted = sample(
        noise, x, y, **of_row,
        orientation=lambda p: np.rad2deg(np.arctan2(p[:, 1] - middle, p[:, 0] - middle)),
        isotropy=lambda p: np.clip(p[:, 1] / PERIODS, 0.0, 1.0),
    )  # fmt: skip
    yield "painted", _colored(labels(row, painted, (0.1 + 0.8 * np.clip(x / PERIODS, 0, 1),), "pwm"))
    for name, waveform in WAVEFORMS.items():
        waving = made.made_of in ("kernels", "waves") and made.reads != "power"
        yield name, _colored(labels(row, g, (0.4,), waveform)) if waving else None
    x, y = plane(SPECTRUM_PERIODS)
    far = sample(noise, x, y, **of_row, **turned)
    yield "spectrum of pwm", spectrum(np.where(labels(row, far, (0.5,), "pwm") == 1, 1.0, -1.0))


def grain() -> Floats:
    """(GRAIN_PIXELS, GRAIN_PIXELS) exemplar: a bundle of 60 waves that hashed numbers choose, periodic, 0…1."""
    shares = words(np.arange(60), 0, 0, 0, seed=SEED) / 2.0**32
    k = np.rint((shares[:, :2] - 0.5) * GRAIN_PERIODS + np.array(GRAIN_FREQUENCY) * GRAIN_PERIODS)
    at = np.arange(GRAIN_PIXELS) / GRAIN_PIXELS
    phase = k[:, 0, None, None] * at + k[:, 1, None, None] * at[:, None] + shares[:, 2, None, None]
    values: Floats = np.cos(2 * np.pi * phase).sum(axis=0)
    return np.asarray((values - values.min()) / np.ptp(values))


def sheet(rows: Mapping[str, Sequence[tuple[str, Picture | None]]], caption: str = CAPTION) -> Image:
    """All pictures of some rows, with their names.

    Args:
        rows: the pictures of each, by its name.
        caption: above all of them.
    """
    from PIL import Image, ImageDraw, ImageFont

    columns = max(len(row) for row in rows.values())
    high = PIXELS + 2 * TEXT_HEIGHT + GAP
    width, height = columns * (PIXELS + GAP) + GAP, len(rows) * high + TEXT_HEIGHT + 2 * GAP
    out = Image.new("RGB", (width, height), BACKGROUND)
    draw, font = ImageDraw.Draw(out), ImageFont.load_default(size=14)
    draw.text((GAP, GAP), caption, fill=INK, font=font)
    for r, (row_name, row) in enumerate(rows.items()):
        top = 2 * GAP + TEXT_HEIGHT + r * high
        draw.text((GAP, top), row_name, fill=INK, font=ImageFont.load_default(size=17))
        top += TEXT_HEIGHT
        for c, (name, picture) in enumerate(row):
            left = GAP + c * (PIXELS + GAP)
            draw.text((left, top), name, fill=INK, font=font)
            if picture is None:
                draw.text((left + GAP, top + TEXT_HEIGHT + PIXELS // 2), "needs a phase", fill=INK, font=font)
            else:
                out.paste(Image.fromarray(picture), (left, top + TEXT_HEIGHT))
    return out.quantize(SHEET_COLORS, dither=Image.Dither.NONE)


def plane(periods: float) -> tuple[Floats, Floats]:
    """x and y of the pixels of a square, row 0 at the largest y; the period is 1."""
    at: Floats = (np.arange(PIXELS, dtype=np.float64) + 0.5) * (periods / PIXELS)
    return at[None, :], at[::-1, None]


def labels(row: str, g: Complexes, cumulative: tuple[float | Floats, ...], profile: ProfileSpec) -> NDArray[np.uint8]:
    """Materials of a field with BANDWIDTH, from 1.

    Args:
        profile: a name, or a shape.
    """
    until = np.stack([np.broadcast_to(np.asarray(c, np.float64), g.shape) for c in cumulative])
    made = _made(row)
    if not isinstance(profile, str):
        table = make_profile(profile).rank_table(made)
        assert table is not None
        rank = table.look_up(g, np.linspace(0, 1, g.shape[1])[None, :])
        return np.asarray(1 + np.count_nonzero(rank >= until, axis=0), np.uint8)
    if made.reads != "phase":
        value = g.real if made.reads == "value" else np.abs(g) ** 2
        return np.asarray(1 + np.count_nonzero(value <= made.levels_of(until), axis=0), np.uint8)
    return (cyclic_labels if PROFILES[profile].arrows else symmetric_labels)(g, until)


@lru_cache
def _made(row: str) -> Noise:
    """The noise of a row, with as much of a texture as the larger pictures show."""
    noise, keys = ROWS[row]
    asked = {"noise": noise, "dimensions": 2, "bandwidth": BANDWIDTH, "seed": SEED, **keys}
    exemplar = periodic_component(grain()) if "exemplar" in NOISES[noise].keys else None
    setting = Setting(
        (1.0, 1.0), size_mm=(SPECTRUM_PERIODS,) * 2, exemplar=exemplar, pixel_mm=GRAIN_PERIODS / GRAIN_PIXELS
    )
    return NOISES[noise].of_pattern(Pattern.model_validate(asked), setting)


def grey(values: Floats, most: float | None = None) -> Picture:
    """Values as greys, 0 in the middle.

    Args:
        most: what is white; default: as far as 99 % of the values go.
    """
    most = float(np.quantile(np.abs(values), 0.99)) if most is None else most
    return np.repeat((127.5 + 127.5 * np.clip(values / most, -1, 1)).astype(np.uint8)[..., None], 3, axis=-1)


def _colored(labels: NDArray[np.uint8]) -> Picture:
    palette = np.array([BACKGROUND, *(tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in DEFAULT_COLORS)])
    return palette[labels].astype(np.uint8)


def spectrum(values: Floats) -> Picture:
    """Power of values on a plane of SPECTRUM_PERIODS, on a logarithmic scale; the middle is frequency 0."""
    power = power_map(values)
    reach = round(SPECTRUM_REACH * SPECTRUM_PERIODS)
    power = power[PIXELS // 2 - reach : PIXELS // 2 + reach, PIXELS // 2 - reach : PIXELS // 2 + reach]
    rows = np.arange(PIXELS) * (2 * reach) // PIXELS
    return shaded(power[rows][:, rows])


def shaded(power: Floats) -> Picture:
    """DECADES of power as greys, the most white."""
    shade = np.clip(1 + decades(power) / DECADES, 0, 1)
    return np.repeat((255 * shade).astype(np.uint8)[..., None], 3, axis=-1)
