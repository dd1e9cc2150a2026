"""Several materials, painted by different sources: each gets its share in the whole part and in its windows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from PIL import Image

import amslicer

PRINTER = {"pitch_um": 97, "layer_um": 97}  # 10.3 pixels per period: in step with nothing
LIMIT = 0.01


def painted(folder: Path, name: str) -> Any:
    """A ratio for four materials."""
    if name == "map":
        colors = {"a": (200, 30, 30), "b": (30, 200, 30), "c": (30, 30, 200), "void": (255, 255, 255)}
        rows = np.array([[colors["a"], colors["b"]], [colors["c"], colors["void"]]], np.uint8)
        Image.fromarray(rows.repeat(6, axis=0).repeat(8, axis=1)).save(folder / "map.png")
        named = {material: "#{:02x}{:02x}{:02x}".format(*color) for material, color in colors.items()}
        return {"map": "map.png", "dominant": 0.7, "colors": named}
    ramp = np.linspace(0, 255, 16).astype(np.uint8)[None].repeat(4, axis=0)
    np.save(folder / "b.npy", 0.15 + 0.1 * np.random.default_rng(1).random((5, 6, 7)))
    return {
        "a": {"image": parts.paint(folder, ramp), "range": [0.1, 0.4]},
        "b": {"volume": "b.npy"},
        "c": {"points": [[0, 0, 0, 0.3], [20, 0, 0, 0.2], [0, 16, 2, 0.25], [20, 16, 6, 0.1]], "within": [0, 0.4]},
        "void": "rest",
    }


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("name", ["sources", "map"])
def test_each_gets_its_share(tmp_path: Path, name: str, dimensions: int) -> None:
    """Within 1 % in the whole part; windows within their statistical bound, as verification has it."""
    job = parts.job(
        parts.box(tmp_path, (26.0, 22.0, 6.0)), printer=PRINTER, materials=("a", "b", "c", "void"),
        ratio=painted(tmp_path, name), dimensions=dimensions, alignment=10,
        orientation={"azimuth": 27, "elevation": 30} if dimensions == 3 else 27,
    )  # fmt: skip
    result = amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, [check for check in report.checks if not check.ok]
    errors = {material: found.error for material, found in report.materials.items()}
    worst = max(float(np.abs(level.z).max()) for level in report.windows)
    print(f"{name}, {dimensions}D:", ", ".join(f"{m} {100 * e:+.2f} %" for m, e in errors.items()), f"z {worst:.1f}")
    assert set(errors) == {"a", "b", "c", "void"}
    assert max(abs(error) for error in errors.values()) <= LIMIT
    # Each pixel of the part has one material or none, and what is written adds up.
    assert result.void is not None
    assert sum(m.pixels for m in result.materials) + result.void.pixels == result.solid_pixels
