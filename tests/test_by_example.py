"""Wave noise by example: the spectrum of the picture, in the plane and in planes of space."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import amslicer
from amslicer.device import Device
from amslicer.exemplar import periodic_component
from amslicer.pipeline import prepare

Floats = NDArray[np.float64]

PIXEL, SIDE = 0.1, 128  # of the picture: 12.8 mm


def exemplar() -> NDArray[np.uint8]:
    """Grain that is coarse along 30° and fine across."""
    white = np.random.default_rng(3).normal(size=(SIDE, SIDE))
    f = np.fft.fftfreq(SIDE, PIXEL)
    along = f * np.cos(np.pi / 6) + f[:, None] * np.sin(np.pi / 6)
    across = -f * np.sin(np.pi / 6) + f[:, None] * np.cos(np.pi / 6)
    power = np.exp(-((np.abs(across) - 0.9) ** 2) / 0.08 - along**2 / 0.1)
    return parts.picture(np.fft.ifft2(np.fft.fft2(white) * np.sqrt(power)).real)


def smooth_power(values: Floats) -> Floats:
    """Power over frequencies of the picture's size, of blocks, smoothed over five by five of them, Σ 1."""
    count = values.shape[0] // SIDE, values.shape[1] // SIDE
    cut = values[: count[0] * SIDE, : count[1] * SIDE].reshape(count[0], SIDE, count[1], SIDE).swapaxes(1, 2)
    cut = cut - cut.mean(axis=(2, 3), keepdims=True)
    window = np.outer(*(np.hanning(SIDE + 1)[:-1],) * 2)
    power = np.mean(np.abs(np.fft.fft2(cut * window)) ** 2, axis=(0, 1))
    power = ndimage.uniform_filter(power, 5, mode="wrap")
    return np.asarray(power / power.sum())


def test_the_spectrum_is_the_pictures(tmp_path: Path) -> None:
    """L2 error over all frequencies; turned by 90° or mirrored it would be far off."""
    grey = exemplar()
    parts.paint(tmp_path, grey[::-1], "grain.png")
    found = []
    for seed in (1, 2):
        job = parts.job(
            parts.box(tmp_path, (76.8, 76.8, 0.1)), noise="wave-by-example", exemplar="grain.png", seed=seed,
            exemplar_pixel_mm=PIXEL, printer={"pitch_um": 1000 * PIXEL, "layer_um": 100},
        )  # fmt: skip
        found.append(smooth_power(amslicer.field(job, 0)[::-1].real))
    got = np.mean(found, axis=0)
    p = periodic_component(grey / 255)
    asked = ndimage.uniform_filter(np.abs(np.fft.fft2(p - p.mean())) ** 2, 5, mode="wrap")
    asked = asked / asked.sum()

    def error(other: Floats) -> float:
        return float(np.linalg.norm(other - asked) / np.linalg.norm(asked))

    mirrored = np.roll(got[:, ::-1], 1, axis=1)
    print(
        ", ".join(f"{100 * error(other):.0f} %" for other in (got, mirrored, got.T)), "off as it is, mirrored, turned"
    )
    assert error(got) <= 0.35
    assert error(mirrored) > 0.9
    assert error(got.T) > 0.6


@pytest.mark.parametrize("planes", [["xy"], ["xz"]])
def test_planes_of_space_show_the_picture(tmp_path: Path, device: Device, planes: list[str]) -> None:
    """The direction of the grain in a section, by its second moments of power: 120° from x, where the picture's is."""
    parts.paint(tmp_path, exemplar()[::-1], "grain.png")
    job = parts.job(
        parts.box(tmp_path, (12.8, 12.8, 12.8)), noise="wave-by-example", exemplar="grain.png", dimensions=3,
        exemplar_pixel_mm=PIXEL, planes=planes, printer={"pitch_um": 200, "layer_um": 200},
    )  # fmt: skip
    pattern = prepare(job).pattern(device)
    g = np.stack([pattern.field(layer) for layer in range(64)]).real
    section = g if planes == ["xy"] else g.transpose(1, 0, 2)  # (sections, up, x)
    power = np.mean(np.abs(np.fft.fft2(section - section.mean())) ** 2, axis=0)
    f = np.fft.fftfreq(64, 0.2)
    u, v = np.meshgrid(f, f)
    angle = np.rad2deg(np.angle(np.sum(power * (u + 1j * v) ** 2))) / 2 % 180
    print(f"{planes}: waves along {angle:.1f}°, of the picture 120°")
    assert abs(angle - 120) <= 8
