"""Changes to a written stack by a forger who knows what verification looks at: hashes and counts agree afterwards."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import amslicer
from amslicer.writers.png import encode_png

Labels = np.ndarray[Any, Any]


def forge(out: Path, change: Callable[[Labels], Labels]) -> None:
    """Puts changed labels in every layer's place, and a manifest that says so."""
    manifest_file = out / "manifest.json"
    manifest = json.loads(manifest_file.read_text())
    pitch = tuple(manifest["grid"]["pitch_mm"])
    totals = dict.fromkeys((m["name"] for m in manifest["materials"]), 0)
    for layer, entry in zip(amslicer.open_stack(out), manifest["layers"], strict=True):
        labels = change(layer.labels)
        for number, name in enumerate(totals, 1):
            deposit = labels == number
            content = encode_png(deposit, pitch)
            (out / name / f"{layer.index:05d}.png").write_bytes(content)
            entry["sha256"][name] = hashlib.sha256(content).hexdigest()
            entry["pixels"][name] = int(deposit.sum())
            totals[name] += int(deposit.sum())
    for material in manifest["materials"]:
        material["pixels"] = totals[material["name"]]
    manifest["solid_pixels"] = sum(totals.values())
    manifest_file.write_text(json.dumps(manifest))
