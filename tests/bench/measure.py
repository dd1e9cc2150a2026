"""One measurement in a process of its own, printed as JSON: python -m tests.bench.measure NAME [ARGUMENTS]"""

from __future__ import annotations

import io
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage

import amslicer
from amslicer import Job, Run
from amslicer.device import Device
from amslicer.evaluator import Evaluator
from amslicer.noise import NOISES
from amslicer.pipeline import prepare
from amslicer.waveevaluator import WaveEvaluator

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
LENS_MM = (100.0, 60.0, 11.0)
LENS_SEGMENTS = {"lens": 448, "fine lens": 896}  # 100 352 and 401 408 triangles
SIZES_MM = {"insole": (120.0, 45.0), "cross_plate": (60.0, 60.0)}  # of the samples
FIELDS: dict[str, Any] = {
    "printer": "generic-600dpi", "materials": ["rigid", "flexible"], "pattern": {"period": 1.0, "bandwidth": 0.5},
    "fields": {
        "ratio": {"gradient": {"axis": "x", "from": 0.2, "to": 0.7}},
        "orientation": {"azimuth": {"gradient": {"axis": "y", "from": 0, "to": 90}}, "elevation": 30},
    },
}  # fmt: skip


def files_of(part: str) -> tuple[Path, Path]:
    """A part's mesh and fields; lenses are made in the temporary folder."""
    if part not in LENS_SEGMENTS:
        return SAMPLES / part / f"{part}.stl", SAMPLES / part / "fields.yaml"
    folder = Path(tempfile.gettempdir()) / "amslicer-bench"
    folder.mkdir(exist_ok=True)
    mesh, fields = folder / f"{part.replace(' ', '_')}.stl", folder / "fields.yaml"
    if not mesh.exists():
        import manifold3d
        import trimesh

        solid = manifold3d.Manifold.sphere(0.5, LENS_SEGMENTS[part]).scale(list(LENS_MM)).to_mesh()
        trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts, process=False).export(mesh)
    fields.write_text(json.dumps(FIELDS), encoding="utf-8")
    return mesh, fields


def job_of(part: str, changes: dict[str, Any] | None = None) -> Job:
    mesh, fields = files_of(part)
    return amslicer.load_job(fields, mesh, {"printer": "generic-600dpi", **(changes or {})})


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def whole(part: str, jobs: str, first: str, end: str, changes: str = "{}", floor: str = "") -> dict[str, Any]:
    """A job from the command line's start to its manifest: the whole process. With its floor, if asked."""
    mesh, fields = files_of(part)
    settings = [word for key, value in json.loads(changes).items() for word in ("--set", f"{key}={value}")]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        words = [sys.executable, "-m", "amslicer", str(mesh), "--fields", str(fields), "--printer", "generic-600dpi"]
        words += ["-o", str(out), *settings, *(["--jobs", jobs] if jobs != "all" else [])]
        words += ["--layers", f"{first}:{end}"] if end != "all" else []
        started = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True)
        seconds = time.perf_counter() - started
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        manifest = json.loads((out / "manifest.json").read_text())
        size = sum(p.stat().st_size for p in out.rglob("*.png"))
        floor_s = encode_floor(out) if floor else 0.0
    grid = manifest["grid"]
    layers = len(manifest["layers"])
    return {
        "seconds": seconds, "solid": manifest["solid_pixels"], "layers": layers, "bytes": size,
        "pixels": grid["width_px"] * grid["height_px"] * layers, "peak_mb": used.ru_maxrss / 1024, "floor_s": floor_s,
    }  # fmt: skip


# What is painted on the insole: a constant, and what costs more.
PAINTED: dict[str, dict[str, Any]] = {
    "constants": {},
    "gradient along z": {"ratio": {"gradient": {"axis": "z", "from": 0.2, "to": 0.4}}},
    "volume of 512³ at 16 bits": {"ratio": {"volume": "volume.npy", "range": [0.2, 0.4]}},
    "and a picture of 30 Mpx at 16 bits": {
        "ratio": {"volume": "volume.npy", "range": [0.2, 0.4]},
        "orientation": {"image": "angle.png", "range": [28, 32]},
    },
    "formula of x, y, z": {"ratio": {"expression": "0.3 + 0.1*sin(x/5)*cos(y/7 + z)"}},
    "depth below the skin": {"ratio": {"distance": {"from": 0.2, "to": 0.4, "depth": 4}}},
    "skin of 0.4 mm": {"skin": {"material": "rigid", "thickness_mm": 0.4}},
}  # fmt: skip


def painted_files() -> dict[str, Any]:
    """Makes the files that PAINTED names, in a process of its own: it would count as that of its children."""
    folder = Path(tempfile.gettempdir()) / "amslicer-bench"
    folder.mkdir(exist_ok=True)
    if not (folder / "angle.png").exists():
        z, y, x = np.meshgrid(*[np.arange(512) / 512] * 3, indexing="ij", sparse=True)
        wave = 0.5 + 0.3 * np.sin(7 * x) * np.cos(5 * y) + 0.2 * np.sin(9 * z + 3 * x)
        np.save(folder / "volume.npy", np.rint(65535 * wave).astype(np.uint16))
        row, column = np.meshgrid(np.arange(5000) / 700, np.arange(6000) / 900, indexing="ij", sparse=True)
        angle = np.rint(32768 + 16000 * np.sin(column) + 8000 * np.cos(row)).astype(np.uint16)
        Image.fromarray(angle).save(folder / "angle.png")
    return {"folder": str(folder)}


def painted(name: str) -> dict[str, Any]:
    """A job of the insole with one of PAINTED: the whole process, a second time."""
    words = [sys.executable, "-m", "tests.bench.measure", "painted_files"]
    folder = Path(json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)["folder"])
    keys = {"ratio": 0.3, "orientation": 30, **PAINTED[name]}
    sections = {key: keys.pop(key) for key in ("skin",) if key in keys}
    fields = folder / "painted.yaml"
    fields.write_text(json.dumps({**FIELDS, "fields": keys, **sections}), encoding="utf-8")
    words = [sys.executable, "-m", "amslicer", str(files_of("insole")[0]), "--fields", str(fields)]
    script = f"import resource, subprocess; subprocess.run({words!r} + ['-o', OUT], check=True, capture_output=True); "
    script += "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    for _ in range(2):
        with tempfile.TemporaryDirectory() as out:
            started = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-c", script.replace("OUT", repr(f"{out}/out"))],
                check=True, capture_output=True, text=True,
            )  # fmt: skip
            seconds = time.perf_counter() - started
    return {"seconds": seconds, "peak_mb": float(done.stdout)}


def encode_floor(out: Path) -> float:
    """Seconds to deflate and write the bitmaps of a stack that are already in memory, on all cores."""
    from PIL import Image

    from amslicer.storage import write_atomically
    from amslicer.writers.png import encode_packed

    Image.MAX_IMAGE_PIXELS = None
    pictures = [Image.open(file) for file in sorted(out.glob("*/[0-9]*.png"))]
    packed = [(np.packbits(np.asarray(p), axis=1), p.size[0]) for p in pictures]

    def write(numbered: tuple[int, tuple[Any, int]]) -> None:
        number, (rows, width) = numbered
        write_atomically(Path(folder) / f"{number}.png", encode_packed(rows, width, (0.0423, 0.0423), "fast"))

    seconds = []
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for _ in range(3):
            with tempfile.TemporaryDirectory() as folder:
                started = time.perf_counter()
                list(pool.map(write, enumerate(packed)))
                seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def stages(part: str) -> dict[str, Any]:
    """Seconds of each OpenCL kernel and of the masks, one after another, of a whole part on all cores."""
    spent: dict[str, float] = {}
    enqueue = Device.kernel

    def timed(name: str, device: Device, call: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            device.queue.finish()
            started = time.perf_counter()
            event = call(*arguments)
            event.wait()
            spent[name] = spent.get(name, 0.0) + time.perf_counter() - started
            return event

        return run

    job = job_of(part)
    prepared = prepare(job)
    started = time.perf_counter()
    for layer in range(0, prepared.grid.layers, 16):
        prepared.slicer.runs(layer, min(layer + 16, prepared.grid.layers))
    masks = time.perf_counter() - started
    next(amslicer.layers(job))  # compiles
    Device.kernel = lambda self, file, constants=None: timed(file, self, enqueue(self, file, constants))  # type: ignore[method-assign]
    started = time.perf_counter()
    solid = sum(int(np.count_nonzero(layer.labels)) for layer in amslicer.layers(job))
    return {"masks_s": masks, "kernels_s": spent, "all_s": time.perf_counter() - started, "solid": solid}


def block_of(device: Device, noise: str, dimensions: int, evaluate: str) -> tuple[Any, Any, float]:
    """A 20 × 20 mm block's pattern on a device, what prepares it, and Mpx/s of its second block of layers' bitmaps."""
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "block.stl"
        trimesh.creation.box((20, 20, 4)).export(part)
        content: dict[str, Any] = {
            "printer": "generic-600dpi", "materials": ["a", "b"],
            "pattern": {"noise": noise, "dimensions": dimensions, "evaluate": evaluate},
            "fields": {"ratio": 0.3, "orientation": 30},
        }  # fmt: skip
        if "exemplar" in NOISES[noise].keys:
            grain = ndimage.gaussian_filter(np.random.default_rng(7).normal(size=(256, 256)), (4.0, 2.0), mode="wrap")
            grey = np.rint(255 * (grain - grain.min()) / np.ptp(grain)).astype(np.uint8)
            Image.fromarray(grey).save(Path(folder) / "grain.png")
            content["pattern"] |= {"exemplar": str(Path(folder) / "grain.png"), "exemplar_pixel_mm": 0.08}
        prepared = prepare(amslicer.load_job(content, part, allow_outside=True))
    pattern, layers = prepared.pattern(device), prepared.tiling.layers
    runs = prepared.slicer.runs(layers, 2 * layers)

    def make() -> None:
        pattern._planar_field = pattern._planar_labels = None
        pattern.block(runs, layers).deposits(layers, 2 * layers)

    return pattern, prepared, int(runs.pixels.sum()) / repeat(make) / 1e6


def evaluator_of(pattern: Any, prepared: Any) -> Any:
    """Of all tiles of the second block of layers."""
    from amslicer.tiles import all_tiles

    rows, columns = prepared.tiling.over(prepared.grid)
    return pattern.evaluator(prepared.tiling, 1, all_tiles((0, 0), (columns, rows)))


def forms(dimensions: str) -> dict[str, Any]:
    """G and material of a 20 × 20 mm block: each pixel by itself, rank-1 sums at each pixel, and the lattice."""
    result: dict[str, Any] = {}
    with Device() as device:
        _, _, result["lattice"] = block_of(device, "phasor", int(dimensions), "lattice")
        pattern, prepared, result["exact"] = block_of(device, "phasor", int(dimensions), "exact")
        layers = prepared.tiling.layers if dimensions == "3" else 1
        evaluator = evaluator_of(pattern, prepared)
        nodes = evaluator.floats_per_plane // 2 * layers
        evaluations = len(evaluator.lists.entries) * prepared.tiling.nodes[0].count ** 2 * layers
        result["kernels_per_pixel"] = evaluations / nodes
        for name, call, count in (
            ("rank1", evaluator.field, layers), ("per_pixel", evaluator.field_per_pixel, 1),
            ("per_pixel_vector", vector_form(device, evaluator), 1),
        ):  # fmt: skip
            seconds = repeat(lambda c=call, n=count: (c(0, n), device.queue.finish())) * layers / count
            result[name] = {"mpx_s": nodes / seconds / 1e6, "g_s": evaluations / seconds / 1e9}
    return result


def noise(name: str, dimensions: str) -> dict[str, Any]:
    """Bitmaps of a 20 × 20 mm block of a noise, Mpx/s at each pixel and on the lattice; kernels that reach a tile."""
    with Device() as device:
        _, _, lattice = block_of(device, name, int(dimensions), "lattice")
        pattern, prepared, exact = block_of(device, name, int(dimensions), "exact")
        evaluator = evaluator_of(pattern, prepared)
        found = {"exact": exact, "lattice": lattice}
        if isinstance(evaluator, Evaluator):
            found["kernels"] = len(evaluator.lists.entries) / len(evaluator.lists.tiles)
        elif isinstance(evaluator, WaveEvaluator):
            found["waves"] = evaluator.entries_per_tile
        return found


def vector_form(device: Device, evaluator: Any) -> Callable[[int, int], Any]:
    """The per-pixel form on explicit vectors; checked against the plain one."""
    import pyopencl as cl

    from amslicer.evaluator import work_shape
    from amslicer.program import build

    tile, tiles = evaluator.tiling.nodes[0].count, len(evaluator.lists.tiles)
    shape = work_shape(device, tile)
    name = "per_pixel_vector"
    program = build(device.context, device.device, name, shape, Path(__file__).parent)
    kernel = cl.Kernel(program, name)

    def field(first: int, count: int) -> Any:
        out = device.scratch("field", 8 * count * tiles * tile**2)
        kernel(
            device.queue, (tile // shape["VECTOR"], tile * tiles, count), (tile // shape["VECTOR"], 1, 1), out,
            *evaluator._lists, evaluator._shape, *evaluator._axes, evaluator._along_z(first, count),
            np.uint32(len(evaluator.kernels)), *(np.float32(nodes.step_mm) for nodes in evaluator.tiling.nodes[:2]),
        )  # fmt: skip
        return out

    plain, vectors = (np.empty(tiles * tile * tile * 2, np.float32) for _ in range(2))
    device.read(evaluator.field_per_pixel(0, 1)[0], plain)
    device.read(field(0, 1), vectors)
    np.testing.assert_allclose(vectors, plain, atol=1e-4)
    return field


def encode() -> dict[str, Any]:
    """One material's bitmap of the insole's fullest layer as PNG, by our writer and by Pillow at the same level."""
    from PIL import Image

    from amslicer.writers.png import encode_png

    layer = next(amslicer.layers(job_of("insole"), Run(layers=(88, 89))))
    deposit = layer.labels == 1

    def pillow() -> None:
        picture = Image.frombytes("1", deposit.shape[::-1], np.packbits(deposit, axis=1).tobytes())
        picture.save(io.BytesIO(), "PNG", compress_level=1)

    ours = repeat(lambda: encode_png(deposit, (0.0423, 0.0423)))
    return {"shape": deposit.shape, "ours_ms": 1000 * ours, "pillow_ms": 1000 * repeat(pillow)}


PRUSA = """printer_technology = SLA
display_width = {0}
display_height = {1}
display_pixels_x = {2}
display_pixels_y = {3}
display_orientation = landscape
display_mirror_x = 0
layer_height = 0.027
initial_layer_height = 0.027
supports_enable = 0
pad_enable = 0
faded_layers = 0
max_print_height = 200
bed_shape = 0x0,{0}x0,{0}x{1},0x{1}
elefant_foot_compensation = 0
"""


def prusa(part: str) -> dict[str, Any]:
    """PrusaSlicer's masks of the part, one material, same pixels and layers; {} where it is not installed."""
    program = shutil.which("prusa-slicer")
    if program is None:
        return {}
    mesh, _ = files_of(part)
    pixels = [int(size / 25.4 * 600) + 20 for size in SIZES_MM.get(part, LENS_MM)[:2]]
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "sla.ini"
        settings.write_text(PRUSA.format(*(n * 25.4 / 600 for n in pixels), *pixels))
        words = [program, "--export-sla", "--load", str(settings), "-o", str(Path(folder) / "out.sl1"), str(mesh)]
        return {"seconds": repeat(lambda: subprocess.run(words, check=True, capture_output=True), 3)}


def stltovoxel(part: str) -> dict[str, Any]:
    """stltovoxel's masks of the part, same pixels and layers; {} where it is not installed."""
    program = shutil.which("stltovoxel", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if program is None:
        return {}
    mesh, _ = files_of(part)
    grid = prepare(job_of(part)).grid
    with tempfile.TemporaryDirectory() as folder:
        counts = map(str, (grid.columns, grid.rows, grid.layers))
        words = [program, "--resolution-xyz", *counts, str(mesh), str(Path(folder) / "out.png")]
        started = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True)
        return {"seconds": time.perf_counter() - started}


def start() -> dict[str, Any]:
    """Seconds of the shortest commands, whole processes."""
    words = {"import amslicer": ["-c", "import amslicer"], "amslicer --help": ["-m", "amslicer", "--help"]}
    return {
        name: repeat(lambda w=w: subprocess.run([sys.executable, *w], check=True, capture_output=True))
        for name, w in words.items()
    }


def repeat(work: Callable[[], Any], times: int = 5) -> float:
    """Median seconds of a few runs, the first not counted."""
    seconds = []
    for _ in range(times + 1):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds[1:]))


MEASUREMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    "whole": whole, "stages": stages, "forms": forms, "noise": noise, "encode": encode, "prusa": prusa,
    "stltovoxel": stltovoxel, "start": start, "painted": painted,
    "painted_files": painted_files,
}  # fmt: skip

if __name__ == "__main__":
    name, *arguments = sys.argv[1:]
    print(json.dumps(MEASUREMENTS[name](*arguments)))
