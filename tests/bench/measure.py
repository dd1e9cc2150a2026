"""One measurement in a process of its own, printed as JSON: python -m tests.bench.measure NAME [ARGUMENTS]"""

from __future__ import annotations

import io
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import amslicer
from amslicer import Job, Run
from amslicer.device import Device
from amslicer.pipeline import prepare

SAMPLES = Path(__file__).resolve().parents[2] / "samples"


def insole(printer: str = "generic-600dpi") -> Job:
    folder = SAMPLES / "insole"
    return amslicer.load_job(folder / "fields.yaml", folder / "insole.stl", {"printer": printer})


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def stages(jobs: int | None, first: int, end: int) -> dict[str, Any]:
    """Masks alone, then masks and materials, of the insole's layers first … end - 1."""
    job, run = insole(), Run(jobs=jobs, layers=(first, end))
    prepared = prepare(job)
    started = time.perf_counter()
    solid = 0
    for layer in range(first, end, 16):
        solid += int(prepared.slicer.runs(layer, min(layer + 16, end)).pixels.sum())
    masks = time.perf_counter() - started
    made = amslicer.layers(job, run)
    next(made)  # compiles, opens the device and makes the first batch
    started = time.perf_counter()
    batch = prepared.tiling.layers
    counted = sum(1 for _ in made) + 1 - batch
    evaluate = (time.perf_counter() - started) * (end - first) / counted
    return {"solid": solid, "masks_s": masks, "evaluate_s": evaluate, "peak_mb": peak_mb()}


def whole(jobs: int | None, first: int, end: int) -> dict[str, Any]:
    """The insole from job to files."""
    with tempfile.TemporaryDirectory() as folder:
        result = amslicer.slice_job(insole(), Path(folder) / "out", run=Run(jobs=jobs, layers=(first, end)))
        size = sum(p.stat().st_size for p in Path(folder).rglob("*.png"))
    return {"solid": result.solid_pixels, "seconds": result.seconds, "bytes": size, "peak_mb": peak_mb()}


def forms(dimensions: int) -> dict[str, Any]:
    """G of one layer of a 20 × 20 mm block: rank-1 sums and the per-pixel form, kernel evaluations per second."""
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "block.stl"
        trimesh.creation.box((20, 20, 4)).export(part)
        content = {
            "materials": ["a", "b"],
            "pattern": {"dimensions": dimensions, "evaluate": "exact"},
            "fields": {"ratio": 0.3, "orientation": 30},
        }
        prepared = prepare(amslicer.load_job(content, part))
        with Device() as device:
            pattern = prepared.pattern(device)
            from amslicer.tiles import all_tiles

            tiling = prepared.tiling
            rows, columns = tiling.over(prepared.grid)
            layers = 16 if dimensions == 3 else 1
            evaluator = pattern.evaluator(tiling, 4, all_tiles((0, 0), (columns, rows)))
            pixels = evaluator.floats_per_plane // 2 * layers
            evaluations = len(evaluator.lists.entries) * tiling.nodes[0].count ** 2 * layers
            result: dict[str, Any] = {"kernels_per_pixel": evaluations / pixels}
            for name, enqueue, count in (
                ("rank1", evaluator.field, layers),
                ("per_pixel", evaluator.field_per_pixel, 1),
            ):
                seconds = repeat(lambda e=enqueue, n=count: (e(0, n), device.queue.finish())) * layers / count
                result[name] = {"mpx_s": pixels / seconds / 1e6, "g_evaluations_s": evaluations / seconds / 1e9}
    return result


def encode() -> dict[str, Any]:
    """One material's bitmap of the insole's fullest layer as PNG, by our writer and by Pillow at the same level."""
    from PIL import Image

    from amslicer.writers.png import encode_png

    layer = next(amslicer.layers(insole(), Run(layers=(88, 89))))
    deposit = layer.labels == 1

    def pillow() -> None:
        picture = Image.frombytes("1", deposit.shape[::-1], np.packbits(deposit, axis=1).tobytes())
        picture.save(io.BytesIO(), "PNG", compress_level=1)

    ours = repeat(lambda: encode_png(deposit, (0.0423, 0.0423)))
    return {"shape": deposit.shape, "ours_ms": 1000 * ours, "pillow_ms": 1000 * repeat(pillow)}


def repeat(work: Callable[[], Any], times: int = 5) -> float:
    """Median seconds of a few runs, the first not counted."""
    seconds = []
    for _ in range(times + 1):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds[1:]))


if __name__ == "__main__":
    name, *arguments = sys.argv[1:]
    numbers = [None if a == "all" else int(a) for a in arguments]
    print(json.dumps({"stages": stages, "whole": whole, "forms": forms, "encode": encode}[name](*numbers)))  # type: ignore[operator]
