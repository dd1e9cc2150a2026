"""python -m tests.bench [--quick]: a Markdown table of figures from one run on one machine, then the same as JSON."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from amslicer.noise import NOISES
from tests.bench.measure import PAINTED

REPOSITORY = Path(__file__).resolve().parents[2]
PARTS = {
    "cross_plate": "cross_plate (2D)", "insole": "insole",
    "lens": "lens of 100 k triangles, 100 × 60 × 11 mm",
}  # fmt: skip
PEERS = {"prusa": "`prusa-slicer --export-sla`", "stltovoxel": "`stltovoxel`"}
TIMES = 3  # whole processes: the median
# How cost grows: what changes, and what it is compared with. Layers of the lens, whole processes.
SWEEPS, PAIRS = 20, 5
GROWTH: dict[str, dict[str, Any]] = {
    "one layer": {"layers": (200, 201)},
    "layers 160 to 240": {"layers": (160, 240)},
    "× 4 layers": {"layers": (40, 360)},
    "× 4 pixels (1200 dpi)": {"layers": (160, 240), "printer.dpi": 1200},
    "× 4 triangles": {"layers": (160, 240), "part": "fine lens"},
    "half the period": {"layers": (160, 240), "pattern.period": 0.5},
    "bandwidth 1": {"layers": (160, 240), "pattern.bandwidth": 1.0},
}


def measure(name: str, *arguments: object) -> dict[str, Any]:
    """One measurement in a process of its own."""
    words = [sys.executable, "-m", "tests.bench.measure", name, *map(str, arguments)]
    print(f"measuring {name} {' '.join(map(str, arguments))} …", file=sys.stderr, flush=True)
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name} failed:\n{done.stderr}")
    return dict(json.loads(done.stdout))


def machine() -> str:
    """The processor, its number of cores and the OpenCL device."""
    from amslicer.device import choose_device

    cpu = next((line.partition(":")[2].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                if line.startswith("model name")), platform.processor())  # fmt: skip
    return f"{cpu}, {len(os.sched_getaffinity(0))} cores; {choose_device().label}"


def reached(made: dict[str, float]) -> str:
    """What each tile of 32 pixels has to sum."""
    for what in ("kernels", "waves"):
        if what in made:
            return f"{made[what]:.0f} {what} reach a tile of 32 pixels"
    return "a value at each pixel"


def main() -> None:
    """Measures, then prints."""
    first, end = (192, 256) if "--quick" in sys.argv else (0, "all")
    for dimensions in (2, 3):
        measure("forms", dimensions)  # compiles
    found: dict[str, Any] = {"machine": machine(), "layers": [first, end]}
    found["forms"] = {f"{d}D": measure("forms", d) for d in (2, 3)}
    for name in NOISES:
        for dimensions in (2, 3):
            measure("noise", name, dimensions)  # compiles
            found.setdefault("noises", {})[f"{name}, {dimensions}D"] = measure("noise", name, dimensions)
    found["whole"] = {}
    for part in PARTS:
        measure("whole", part, "all", 192, 256 if part != "cross_plate" else "all")  # reads the part, compiles
        runs: dict[str, list[dict[str, Any]]] = {"1": [], "all": []}
        for time in range(TIMES):
            for jobs, made in runs.items():
                made.append(measure("whole", part, jobs, first, end, "{}", "floor" if time == 0 else ""))
        found["whole"][part] = {jobs: median(made) for jobs, made in runs.items()}
    found["stages"] = {part: measure("stages", part) for part in PARTS}
    found["peers"] = {part: {peer: measure(peer, part) for peer in PEERS} for part in PARTS}
    found["growth"] = {}
    for name, changes in GROWTH.items():
        settings = {key: value for key, value in changes.items() if key not in ("layers", "part")}
        arguments = (changes.get("part", "lens"), "all", *changes["layers"], json.dumps(settings))
        measure("whole", *arguments)  # compiles
        found["growth"][name] = median([measure("whole", *arguments) for _ in range(TIMES)])
    # In turn, each against the one before it: the machine's speed drifts by more than the difference.
    pairs = [[measure("whole", "insole", "all", 0, "all", json.dumps({"pattern.alignment": n})) for n in (0, SWEEPS)]
             for _ in range(PAIRS)]  # fmt: skip
    found["aligned"] = sorted(pairs, key=lambda pair: pair[1]["seconds"] / pair[0]["seconds"])[PAIRS // 2]
    found["painted"] = {name: measure("painted", name) for name in PAINTED}
    found["encode"] = measure("encode")
    found["start"] = measure("start")
    rows = list(table(found))
    print(f"{found['machine']}\n")
    print("| figure | value |\n|---|---|")
    for name, value in rows:
        print(f"| {name} | {value} |")
    print("\n" + json.dumps(found))


def median(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The run of median time, with the first one's floor and the largest memory."""
    middle = sorted(runs, key=lambda run: float(run["seconds"]))[len(runs) // 2]
    return {**middle, "floor_s": runs[0]["floor_s"], "peak_mb": max(run["peak_mb"] for run in runs)}


def table(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """The rows of the table."""
    for name, form in found["forms"].items():
        slow = form["per_pixel"]["mpx_s"]
        kernels = f"{form['kernels_per_pixel']:.0f} kernels per pixel"
        yield f"G, {name}, kernel by kernel at each pixel ({kernels})", f"{slow:.2f} Mpx/s"
        vectors = form["per_pixel_vector"]["mpx_s"]
        yield f"G, {name}, the same on explicit vectors", f"{vectors:.2f} Mpx/s: {vectors / slow:.0f} ×"
        yield (
            f"G, {name}, rank-1 sums at each pixel",
            f"{form['rank1']['mpx_s']:.0f} Mpx/s, {form['rank1']['g_s']:.1f} G kernel evaluations/s: "
            f"{form['rank1']['mpx_s'] / slow:.0f} ×",
        )
        yield (
            f"bitmaps, {name}, block of 20 × 20 mm: at each pixel, and on the lattice",
            f"{form['exact']:.0f} and {form['lattice']:.0f} Mpx/s: {form['lattice'] / slow:.0f} ×",
        )
    for name, made in found["noises"].items():
        yield (
            f"bitmaps, {name}, block of 20 × 20 mm ({reached(made)})",
            f"{made['exact']:.0f} Mpx/s at each pixel, {made['lattice']:.0f} on the lattice",
        )
    for part, text in PARTS.items():
        one, whole = found["whole"][part]["1"], found["whole"][part]["all"]
        seconds, solid, pixels = whole["seconds"], whole["solid"] / 1e6, whole["pixels"] / 1e6
        yield (
            f"{text}: command to manifest, {whole['layers']} layers, {pixels / whole['layers']:.1f} Mpx each",
            f"{seconds:.1f} s ({solid / seconds:.0f} Mpx/s of {solid:.0f} Mpx solid, {pixels / seconds:.0f} of all), "
            f"peak memory {whole['peak_mb']:.0f} MB",
        )
        floor = whole["floor_s"]
        yield (
            f"{text}: encoding and writing the same bitmaps from memory",
            f"{floor:.2f} s; the whole job is {seconds / floor:.1f} ×, or {max(0.0, seconds - 2) / floor:.1f} × + 2 s",
        )
        for peer, name in PEERS.items():
            if made := found["peers"][part][peer]:
                yield (
                    f"{text}: {name}, masks of one material",
                    f"{made['seconds']:.1f} s; the whole job is {whole['seconds'] / made['seconds']:.2f} ×",
                )
        yield f"{text}: --jobs 1", f"{one['seconds']:.1f} s; {one['seconds'] / whole['seconds']:.2f} × all cores"
        stage = found["stages"][part]
        kernels = ", ".join(f"{k} {v:.2f}" for k, v in sorted(stage["kernels_s"].items(), key=lambda kv: -kv[1])[:4])
        yield f"{text}: masks on one core; OpenCL kernels", f"{stage['masks_s']:.2f} s; {kernels} s"
    one, base = found["growth"]["one layer"], found["growth"]["layers 160 to 240"]
    yield "lens, one layer: what starting takes", f"{one['seconds']:.2f} s"
    for name, grown in list(found["growth"].items())[1:]:
        net, base_net = grown["seconds"] - one["seconds"], base["seconds"] - one["seconds"]
        yield (
            f"lens, {name}",
            f"{grown['seconds']:.2f} s, {net:.2f} s more than one layer: {net / base_net:.2f} × for "
            f"{grown['solid'] / base['solid']:.2f} × the solid pixels; {grown['peak_mb']:.0f} MB",
        )
    plain, aligned = (run["seconds"] for run in found["aligned"])
    yield (
        f"insole, {SWEEPS} sweeps of alignment",
        f"{aligned:.2f} s, {aligned - plain:.2f} s or {100 * (aligned / plain - 1):.0f} % more; "
        f"{found['aligned'][1]['peak_mb']:.0f} MB",
    )
    constant = found["painted"]["constants"]["seconds"]
    for name, made in found["painted"].items():
        yield (
            f"insole, painted by: {name}",
            f"{made['seconds']:.1f} s, {made['seconds'] / constant:.2f} × constants; {made['peak_mb']:.0f} MB",
        )
    png = found["encode"]
    height, width = png["shape"]
    yield (
        f"PNG of one material of one layer, {width} × {height} pixels",
        f"{png['ours_ms']:.1f} ms; Pillow at zlib's fastest {png['pillow_ms']:.1f} ms",
    )
    yield "start", ", ".join(f"{name} {seconds:.2f} s" for name, seconds in found["start"].items())


if __name__ == "__main__":
    main()
