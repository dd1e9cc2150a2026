"""Small parts, painted pictures and jobs for the tests, written into a test's own folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import meshes
import numpy as np
from meshes import Solid
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import amslicer
from amslicer import Job
from amslicer.noise import NOISES, Noise
from amslicer.noise.setting import Setting
from amslicer.specification import Pattern

Floats = NDArray[np.float64]
# 12.05 pixels per period of 1 mm: a whole number would let every period see the same pixels.
SQUARE = {"pitch_um": 83, "layer_um": 83}
OBLONG = {"dpi": [600, 300], "layer_mm": 0.083}


def stl(folder: Path, solid: Solid, name: str = "part.stl") -> Path:
    path = folder / name
    path.write_bytes(meshes.binary_stl(solid))
    return path


def box(folder: Path, size_mm: tuple[float, float, float], name: str = "part.stl") -> Path:
    """A box with its lowest corner at the file's origin."""
    return stl(folder, meshes.box(size_mm), name)


def plate(folder: Path, width_mm: float, depth_mm: float) -> Path:
    """A plate of one layer, for layers below 0.1 mm."""
    return box(folder, (width_mm, depth_mm, 0.05))


def paint(folder: Path, grey: NDArray[np.uint8 | np.uint16], name: str = "painted.png") -> str:
    """Writes a picture, its first row at the top, beside the job file; returns its name there."""
    Image.fromarray(grey).save(folder / name)
    return name


def job(
    part: Path, *, ratio: Any = 0.5, orientation: Any = 0.0, isotropy: Any = 0.0, printer: Mapping[str, Any] = SQUARE,
    settings: Mapping[str, Any] | None = None, materials: tuple[str, ...] = ("rigid", "flexible"),
    sections: Mapping[str, Any] | None = None, **pattern: Any,
) -> Job:  # fmt: skip
    """A job whose file lies beside the part (two materials, and 2D unless `dimensions` says otherwise).

    Args:
        settings: the job file's `part` section.
        sections: further sections of the job file.
        pattern: keys of its `pattern` section.
    """
    content = {
        "printer": dict(printer),
        "part": dict(settings or {}),
        "materials": list(materials),
        "pattern": {"dimensions": 2, **pattern},
        "fields": {"ratio": ratio, "orientation": orientation, "isotropy": isotropy},
        **(sections or {}),
    }
    if "exemplar" in NOISES[pattern.get("noise", "phasor")].keys and "exemplar" not in pattern:
        content["pattern"] |= {"exemplar": paint(part.parent, picture(grain())[::-1], "grain.png"), **EXEMPLAR}
    file = part.with_suffix(".yaml")
    file.write_text(json.dumps(content), encoding="utf-8")  # JSON is YAML
    return amslicer.load_job(file, part=part)


def labels(job: Job, first: int = 0, end: int | None = None) -> NDArray[np.uint8]:
    """(L, H, W) labels of some layers, all by default."""
    return np.stack([layer.labels for layer in amslicer.layers(job, amslicer.Run(layers=(first, end)))])


def grain(side: int = 64, seed: int = 7) -> Floats:
    """A periodic grain, about 6 pixels coarse and twice as long along y."""
    white = np.random.default_rng(seed).normal(size=(side, side))
    return ndimage.gaussian_filter(white, (4.0, 2.0), mode="wrap")


def picture(values: Floats) -> NDArray[np.uint8]:
    """Grey levels of values, the lowest black and the highest white; row 0 as it is."""
    return np.rint(255 * (values - values.min()) / np.ptp(values)).astype(np.uint8)


EXEMPLAR = {"exemplar_pixel_mm": 0.05}


def noise(name: str, bandwidth: float = 0.5, dimensions: int = 2, **pattern: Any) -> Noise:
    """A noise of 1 mm periods."""
    asked = {"noise": name, "bandwidth": bandwidth, "dimensions": dimensions, **pattern}
    return NOISES[name].of_pattern(Pattern.model_validate(asked), Setting((1.0, 1.0), exemplar=grain(), pixel_mm=0.05))


def bitmap(job: Job) -> NDArray[np.uint8]:
    """(H, W) labels of the first layer."""
    return labels(job, 0, 1)[0]


def pitch_mm(printer: Mapping[str, Any]) -> tuple[float, float, float]:
    """Pixel size along x and y, and layer height."""
    pair = printer.get("dpi", printer.get("pitch_um"))
    x, y = pair if isinstance(pair, list) else (pair, pair)
    height = printer["layer_mm"] if "layer_mm" in printer else printer["layer_um"] / 1000
    return (25.4 / x, 25.4 / y, height) if "dpi" in printer else (x / 1000, y / 1000, height)


def centres(shape: tuple[int, int], pitch: tuple[float, ...]) -> tuple[Floats, Floats]:
    """x (1, W) and y (H, 1) of a bitmap's pixel centres, mm from its lower left corner; row 0 is the largest y."""
    return (np.arange(shape[1])[None, :] + 0.5) * pitch[0], (shape[0] - np.arange(shape[0])[:, None] - 0.5) * pitch[1]


def painted_line(grey: NDArray[np.uint8], low_deg: float, high_deg: float, u: Floats, v: Floats) -> Floats:
    """Degrees that a picture paints at shares u, v (0 … 1, v up) of its box: bilinear as lines, clamped."""
    doubled = np.deg2rad(2 * (low_deg + grey.astype(np.float64) / 255 * (high_deg - low_deg)))
    u, v = np.broadcast_arrays(u, v)
    at = np.stack([(1 - v) * grey.shape[0] - 0.5, u * grey.shape[1] - 0.5])
    sine, cosine = (
        ndimage.map_coordinates(part, at, order=1, mode="nearest") for part in (np.sin(doubled), np.cos(doubled))
    )
    return np.rad2deg(0.5 * np.arctan2(sine, cosine)) % 180


def distance_to_jumps(grey: NDArray[np.uint8], low_deg: float, high_deg: float, jump_deg: float) -> Floats:
    """Distance, in texels, of each texel from where the painted line turns by more between two texels."""
    angle = low_deg + grey.astype(np.float64) / 255 * (high_deg - low_deg)
    jumps = np.zeros(grey.shape, bool)
    for axis in (0, 1):
        turned = np.abs((np.diff(angle, axis=axis) + 90) % 180 - 90) > jump_deg
        here = [slice(None), slice(None)]
        here[axis] = slice(0, -1)
        jumps[tuple(here)] |= turned
        here[axis] = slice(1, None)
        jumps[tuple(here)] |= turned
    return ndimage.distance_transform_edt(~jumps) if jumps.any() else np.full(grey.shape, np.inf)
