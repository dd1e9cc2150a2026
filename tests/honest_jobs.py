"""Random jobs over everything that can be painted: does verification raise alarms about honest stacks?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import manifold3d
import meshes
import numpy as np
import parts
from numpy.random import Generator
from scipy import ndimage

import amslicer
from amslicer import Job

MAX_PIXELS = 4e6  # so that hundreds of jobs take minutes
LEAST_SHARE = 0.08  # of a material: a sheet of a pixel or so
SHAPES = ("box", "cylinder", "sphere", "tilted box")
RATIOS = ("constant", "gradient", "expression")
DIRECTIONS = ("constant", "gradient", "painted", "vector")


def honest_job(folder: Path, seed: int, max_pixels: float = MAX_PIXELS) -> tuple[Job, dict[str, Any]]:
    """A random job with its part and pictures in a folder, and the job file's content.

    Args:
        max_pixels: of the part's bounding box, all layers.
    """
    random = np.random.default_rng(seed)
    dimensions = int(random.choice([2, 3]))
    direction = str(random.choice(DIRECTIONS))
    materials = [f"m{i}" for i in range(int(random.integers(2, 6)))]
    low_mm = float(random.uniform(0.8, 1.5))
    high_mm = low_mm * float(random.uniform(1, 3)) if random.random() < 0.3 else low_mm
    axis = str(random.choice(["x", "y"]))
    pitch_um = random.uniform(70, 120, 2) if random.random() < 0.3 else np.full(2, random.uniform(70, 120))
    layer_um = float(random.uniform(80, 160))
    content = {
        "printer": {"pitch_um": pitch_um.tolist(), "layer_um": layer_um},
        "part": {"rotate": [0, 0, float(random.uniform(-90, 90))]} if random.random() < 0.3 else {},
        "materials": materials,
        "pattern": {
            "dimensions": dimensions,
            "period": low_mm if low_mm == high_mm else gradient(axis, low_mm, high_mm),
            "bandwidth": float(random.uniform(0.25, 1)),
            "profile": "cyclic" if direction != "painted" and random.random() < 0.3 else "symmetric",
            "edges": str(random.choice(["sharp", "dithered"])),
            "seed": seed,
        },
        "fields": {
            "ratio": ratio(random, materials),
            "orientation": orientation(random, direction, dimensions, folder),
            "isotropy": isotropy(random),
        },
    }
    solid = shape(random, (low_mm + high_mm) / 2, np.array([*pitch_um, layer_um]) / 1000, dimensions, max_pixels)
    file = folder / "fields.yaml"
    file.write_text(json.dumps(content), encoding="utf-8")
    return amslicer.load_job(file, parts.stl(folder, solid)), content


def gradient(axis: str, start: float, end: float) -> dict[str, Any]:
    return {"gradient": {"axis": axis, "from": start, "to": end}}


def shares(random: Generator, count: int) -> np.ndarray[Any, Any]:
    """Random shares that sum to 1, none below the least."""
    return np.asarray(LEAST_SHARE + (1 - count * LEAST_SHARE) * random.dirichlet(np.ones(count)))


def ratio(random: Generator, materials: list[str]) -> Any:
    kind, axis = str(random.choice(RATIOS)), str(random.choice(["x", "y", "z"]))
    start, end = shares(random, len(materials)), shares(random, len(materials))
    if kind == "constant":
        fields: list[Any] = start.tolist()
    elif kind == "gradient":
        fields = [gradient(axis, a, b) for a, b in zip(start.tolist(), end.tolist(), strict=True)]
    else:  # from one to the other and back, in waves
        wave = f"(0.5 + 0.5*sin(2*pi*(u*{random.uniform(0.5, 2):.3f} + v)))"
        fields = [{"expression": f"{a} + ({b - a})*{wave}"} for a, b in zip(start, end, strict=True)]
    named = dict(zip(materials, fields, strict=True))
    named[str(random.choice(materials))] = "rest"
    return named


def orientation(random: Generator, kind: str, dimensions: int, folder: Path) -> Any:
    azimuth, turn = float(random.uniform(-90, 90)), float(random.uniform(-60, 60))
    elevation = float(random.uniform(-90, 90))
    flat = dimensions == 2
    if kind == "constant":
        return azimuth if flat else {"azimuth": azimuth, "elevation": elevation}
    if kind == "gradient":
        field = gradient(str(random.choice(["x", "y"])), azimuth, azimuth + turn)
        return field if flat else {"azimuth": field, "elevation": gradient("z", elevation, elevation + turn / 2)}
    if kind == "vector":
        step = random.uniform(-0.5, 0.5, 2).tolist()
        base = random.normal(size=3)
        x, y, z = (base / np.linalg.norm(base if not flat else base[:2])).tolist()
        return {"vector": [gradient("x", x, x + step[0]), gradient("y", y, y + step[1]), 0 if flat else z]}
    coarse = random.uniform(0, 90, (3, 3))
    grey = np.clip(ndimage.zoom(coarse, 16, order=1) / 90 * 255, 0, 255).astype(np.uint8)
    field = {"image": parts.paint(folder, grey), "range": [azimuth, azimuth + 90]}
    return field if flat else {"azimuth": field, "elevation": elevation}


def isotropy(random: Generator) -> Any:
    if random.random() < 0.4:
        return 0
    start, end = random.uniform(0, 1, 2).tolist()
    return start if random.random() < 0.5 else gradient(str(random.choice(["x", "y"])), start, end)


def shape(
    random: Generator, period_mm: float, pitch_mm: np.ndarray[Any, Any], dimensions: int, max_pixels: float
) -> meshes.Solid:
    """A solid of 10 to 45 periods, thinner where that would be too many pixels."""
    kind = str(random.choice(SHAPES))
    size = np.exp(random.uniform(np.log(10), np.log(45), 3)) * period_mm
    if dimensions == 2 and kind != "sphere":
        size[2] = 4 * pitch_mm[2]
    excess = np.prod(size / pitch_mm) / max_pixels
    if excess > 1:  # lower first, then smaller as a whole
        size[2] /= min(excess, size[2] / (10 * period_mm)) if size[2] > 10 * period_mm else 1
        size *= min(1.0, (max_pixels / np.prod(size / pitch_mm)) ** (1 / 3))
    if kind == "sphere":
        return meshes.sphere(float(size.min()) / 2, 4)
    if kind == "cylinder":
        made = manifold3d.Manifold.cylinder(1, 0.5, -1, 96).scale(size.tolist())
        return meshes.from_manifold(made)
    solid = meshes.box(tuple(size))
    if kind == "box":
        return solid
    angles = random.uniform(-180, 180, 3) if dimensions == 3 else [0, 0, random.uniform(-180, 180)]
    return meshes.from_manifold(meshes.to_manifold(solid).rotate(list(angles)))
