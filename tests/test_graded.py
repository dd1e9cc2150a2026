"""Ratios that change with z: the device interpolates them and adds them up, as the host does elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshes
import numpy as np
import parts
import pytest

import amslicer
from amslicer.pattern import Pattern

PRINTER = {"pitch_um": [80, 90], "layer_um": 70, "margin_px": 3}
UP = {"gradient": {"axis": "z", "from": 0, "to": 1}}
THREE = {"a": {"expression": "0.3*w"}, "b": "rest", "c": {"expression": "0.2 + 0.1*sin(z + x)"}}
MOST_PPM = 50  # pixels whose phase is at the threshold to the rounding of float32


def sliced(folder: Path, ratio: Any, materials: tuple[str, ...], **pattern: Any) -> tuple[Any, Any]:
    """Labels, and what is asked of each material, of a ball."""
    job = parts.job(
        parts.stl(folder, meshes.sphere(4.0, 4)), printer=PRINTER, materials=materials, ratio=ratio, orientation=30,
        **{"dimensions": 3, **pattern},
    )  # fmt: skip
    result = amslicer.slice_job(job, folder / "out", overwrite=True)
    labels = np.stack([layer.labels for layer in amslicer.open_stack(folder / "out")])
    return labels, [m.asked for m in result.materials]


@pytest.mark.parametrize("pattern", [{}, {"profile": "cyclic"}, {"dimensions": 2}, {"edges": "dithered"}], ids=str)
@pytest.mark.parametrize("field", ["gradient", "volume", "three", "nodes"])
def test_device_and_host_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, pattern: dict[str, Any]
) -> None:
    ratio: Any = UP
    if field == "volume":
        np.save(tmp_path / "noise.npy", np.random.default_rng(3).integers(0, 2**16, (9, 14, 23), np.uint16))
        ratio = {"volume": "noise.npy"}
    if field == "nodes":
        ratio = {"points": [[-4, 0, -4, 0.2], [4, 1, 0, 0.7], [0, -4, 4, 0.4], [1, 2, 3, 0.5]], "within": [0, 1]}
    ratio, materials = (THREE, ("a", "b", "c")) if field == "three" else (ratio, ("a", "b"))
    on_device, asked = sliced(tmp_path, ratio, materials, **pattern)
    monkeypatch.setattr(Pattern, "_on_device", False)
    on_host, asked_of_host = sliced(tmp_path, ratio, materials, **pattern)
    assert np.array_equal(on_device > 0, on_host > 0)
    differ = 1e6 * np.count_nonzero(on_device != on_host) / np.count_nonzero(on_host)
    print(f"{field}, {pattern}: {differ:.1f} ppm of the pixels differ")
    assert differ <= MOST_PPM
    np.testing.assert_allclose(asked, asked_of_host, atol=1e-6)


def test_plain_fills_are_plain(tmp_path: Path) -> None:
    """A ratio of exactly 0 and 1 below and above a step: no pixel of the other material."""
    ratio = {"gradient": {"axis": "z", "from": 0, "to": 1, "start": -0.035, "end": 0.035}}
    labels, _ = sliced(tmp_path, ratio, ("a", "b"))
    half = len(labels) // 2
    assert set(np.unique(labels[: half - 1])) == {0, 2}
    assert set(np.unique(labels[half + 1 :])) == {0, 1}
