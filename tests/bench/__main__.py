"""python -m tests.bench [--quick]: a Markdown table of figures from one run on one machine, then the same as JSON."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
LAYERS = 442  # of the insole at 27 µm


def measure(name: str, *arguments: object) -> dict[str, Any]:
    """One measurement in a process of its own."""
    words = [sys.executable, "-m", "tests.bench.measure", name, *map(str, arguments)]
    print(f"measuring {name} {' '.join(map(str, arguments))} …", file=sys.stderr, flush=True)
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def machine() -> str:
    """The processor, its number of cores and the OpenCL device."""
    from amslicer.device import choose_device

    cpu = next((line.partition(":")[2].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                if line.startswith("model name")), platform.processor())  # fmt: skip
    return f"{cpu}, {len(os.sched_getaffinity(0))} cores; {choose_device().label}"


def main() -> None:
    """Measures, then prints."""
    first, end = (192, 256) if "--quick" in sys.argv else (0, LAYERS)
    measure("forms", 2)  # compiles
    found: dict[str, Any] = {"machine": machine(), "layers": [first, end]}
    found["forms"] = {f"{d}D": measure("forms", d) for d in (2, 3)}
    found["stages"] = {str(jobs): measure("stages", jobs, first, end) for jobs in (1, 2)}
    found["whole"] = {str(jobs): measure("whole", jobs, first, end) for jobs in (1, 2)}
    found["encode"] = measure("encode")
    middle = (first + end) // 2
    found["memory"] = {str(n): measure("whole", "all", middle - n // 2, middle + n // 2) for n in (32, 64)}
    rows = list(table(found))
    print(f"{found['machine']}\n")
    print("| figure | value |\n|---|---|")
    for name, value in rows:
        print(f"| {name} | {value} |")
    print("\n" + json.dumps(found))


def table(found: dict[str, Any]) -> Any:
    """The rows of the table."""
    for name, form in found["forms"].items():
        fast, slow = form["rank1"], form["per_pixel"]
        yield (
            f"G, {name}, rank-1 sums ({form['kernels_per_pixel']:.0f} kernels per pixel)",
            f"{fast['mpx_s']:.1f} Mpx/s, {fast['g_evaluations_s']:.1f} G kernel evaluations/s",
        )
        yield (
            f"G, {name}, kernel by kernel at each pixel",
            f"{slow['mpx_s']:.2f} Mpx/s, {slow['g_evaluations_s']:.2f} G/s; "
            f"rank-1 is {fast['mpx_s'] / slow['mpx_s']:.0f} ×",
        )
    one, two = found["stages"]["1"], found["stages"]["2"]
    part = f"insole, 600 dpi, 27 µm, layers {found['layers'][0]} to {found['layers'][1]}"
    yield f"{part}: masks alone, 1 thread", f"{one['masks_s']:.1f} s"
    for jobs, stage in (("1", one), ("2", two)):
        speed = stage["solid"] / stage["evaluate_s"] / 1e6
        yield f"{part}: exact evaluation, --jobs {jobs}", f"{speed:.1f} solid Mpx/s ({stage['evaluate_s']:.1f} s)"
    yield "exact evaluation, --jobs 2 over 1", f"{one['evaluate_s'] / two['evaluate_s']:.2f} ×"
    png = found["encode"]
    height, width = png["shape"]
    yield (
        f"PNG of one material of one layer, {width} × {height} pixels",
        f"{png['ours_ms']:.1f} ms; Pillow at the same level {png['pillow_ms']:.1f} ms",
    )
    one, two = found["whole"]["1"], found["whole"]["2"]
    for jobs, whole in (("1", one), ("2", two)):
        speed = whole["solid"] / whole["seconds"] / 1e6
        yield (
            f"job to files, --jobs {jobs}",
            f"{whole['seconds']:.1f} s ({speed:.1f} solid Mpx/s), {whole['bytes'] / 1e6:.0f} MB of files, "
            f"peak memory {whole['peak_mb']:.0f} MB",
        )
    yield "job to files, --jobs 2 over 1", f"{one['seconds'] / two['seconds']:.2f} ×"
    for count, whole in found["memory"].items():
        yield f"peak memory of {count} layers", f"{whole['peak_mb']:.0f} MB"


if __name__ == "__main__":
    main()
