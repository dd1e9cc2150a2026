"""Verification finds what is wrong, and nothing where nothing is."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

import amslicer
from amslicer import Job, Run
from amslicer.writers.png import encode_png

SIZE_MM = (30.0, 24.0, 2.4)
PRINTER = {"pitch_um": 120, "layer_um": 200}
PITCH_MM = (0.12, 0.12)


def make_job(folder: Path, **changes: Any) -> Job:
    settings: dict[str, Any] = {"printer": PRINTER, "dimensions": 3, "orientation": 35, "ratio": 0.3} | changes
    return parts.job(parts.box(folder, SIZE_MM), **settings)


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("honest")
    amslicer.slice_job(make_job(folder), folder / "out")
    return folder / "out"


@pytest.fixture
def stack(honest: Path, tmp_path: Path) -> Path:
    return shutil.copytree(honest, tmp_path / "out")


def failed(out: Path, fields: Path | None = None) -> set[str]:
    """The first words of the laws that a stack breaks."""
    report = amslicer.verify(out, fields)
    broken = {check.name.partition(":")[0] for check in report.checks if not check.ok}
    assert report.ok == (not broken)
    return broken


def rewrite(out: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Changes the manifest: a forger who knows what verification looks at."""
    file = out / "manifest.json"
    manifest = json.loads(file.read_text())
    change(manifest)
    file.write_text(json.dumps(manifest))


def replace_bitmap(out: Path, material: str, layer: int, deposit: np.ndarray[Any, Any]) -> None:
    """Puts another bitmap in place, hash and counts included."""
    content = encode_png(deposit, PITCH_MM)
    (out / material / f"{layer:05d}.png").write_bytes(content)

    def correct(manifest: dict[str, Any]) -> None:
        entry = manifest["layers"][layer]
        before = entry["pixels"][material]
        entry["sha256"][material] = hashlib.sha256(content).hexdigest()
        entry["pixels"][material] = int(deposit.sum())
        for m in manifest["materials"]:
            if m["name"] == material:
                m["pixels"] += int(deposit.sum()) - before

    rewrite(out, correct)


def test_an_honest_stack_passes(stack: Path) -> None:
    assert failed(stack) == set()
    report = amslicer.verify(stack)
    assert report.materials["rigid"].expected == pytest.approx(0.3)
    assert report.materials["flexible"].expected == pytest.approx(0.7)
    assert report.materials["rigid"].error == pytest.approx(-report.materials["flexible"].error)
    assert report.solid_pixels == 250 * 200 * 12


def test_one_altered_byte_is_found(stack: Path) -> None:
    file = stack / "flexible" / "00003.png"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1  # in the last chunk's checksum: the pixels are the same
    file.write_bytes(content)
    assert "hashes" in failed(stack)


@pytest.mark.parametrize("position", [0.3, 0.6, 0.9])
def test_an_altered_byte_anywhere_is_found(stack: Path, position: float) -> None:
    file = stack / "rigid" / "00007.png"
    content = bytearray(file.read_bytes())
    content[int(position * len(content))] ^= 0x40
    file.write_bytes(content)
    assert "hashes" in failed(stack)


def test_a_missing_layer_is_found(stack: Path) -> None:
    (stack / "rigid" / "00002.png").unlink()
    assert "files" in failed(stack)


def test_a_layer_that_the_manifest_forgot_is_found(stack: Path) -> None:
    rewrite(stack, lambda manifest: manifest["layers"].pop(4))
    assert "files" in failed(stack)


def test_swapped_materials_are_found(stack: Path) -> None:
    (stack / "rigid").rename(stack / "x")
    (stack / "flexible").rename(stack / "rigid")
    (stack / "x").rename(stack / "flexible")
    assert {"hashes", "counts", "ratio"} <= failed(stack)


def test_swapped_materials_are_found_even_where_the_manifest_was_forged(stack: Path) -> None:
    for layer in amslicer.open_stack(stack):
        replace_bitmap(stack, "rigid", layer.index, layer.labels == 2)
        replace_bitmap(stack, "flexible", layer.index, layer.labels == 1)
    assert failed(stack) == {"ratio", "windows"}


def test_a_ratio_that_is_two_hundredths_off_is_found(stack: Path, tmp_path: Path) -> None:
    for wrong in (0.28, 0.32):
        fields = make_job(tmp_path, ratio=wrong).name
        assert failed(stack, Path(fields)) == {"ratio", "windows"}


def test_a_pixel_in_two_materials_is_found(stack: Path) -> None:
    deposit = amslicer.open_stack(stack)[5].labels == 1
    row, column = np.argwhere(~deposit)[0]
    deposit[row, column] = True
    replace_bitmap(stack, "rigid", 5, deposit)
    assert failed(stack) == {"partition"}


def test_a_wrong_size_is_found(stack: Path) -> None:
    deposit = amslicer.open_stack(stack)[5].labels == 1
    replace_bitmap(stack, "rigid", 5, deposit[:-1])
    assert "sizes" in failed(stack)


def test_wrong_counts_are_found(stack: Path) -> None:
    def one_more(manifest: dict[str, Any]) -> None:
        manifest["materials"][0]["pixels"] += 1

    rewrite(stack, one_more)
    assert failed(stack) == {"counts"}


def test_part_of_a_stack_passes(tmp_path: Path) -> None:
    amslicer.slice_job(make_job(tmp_path), tmp_path / "out", run=Run(layers=(3, 9)))
    assert failed(tmp_path / "out") == set()


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"format": "amslicer-stack", "version": 1}'])
def test_a_damaged_manifest_is_an_error_not_a_traceback(stack: Path, damage: str) -> None:
    (stack / "manifest.json").write_text(damage)
    with pytest.raises(amslicer.StorageError, match="damaged"):
        amslicer.verify(stack)


@pytest.mark.parametrize(("key", "value"), [("layers", []), ("part", {"transform": [[0] * 4] * 4})])
def test_a_manifest_that_describes_nothing_is_damaged(stack: Path, key: str, value: Any) -> None:
    def empty(manifest: dict[str, Any]) -> None:
        manifest[key] = value if isinstance(value, list) else manifest[key] | value

    rewrite(stack, empty)
    with pytest.raises(amslicer.StorageError, match="damaged"):
        amslicer.verify(stack)


def test_a_folder_without_a_stack_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(amslicer.StorageError, match="not a finished stack"):
        amslicer.verify(tmp_path)


def test_an_interrupted_stack_is_named_as_such(stack: Path) -> None:
    (stack / "manifest.json").unlink()
    with pytest.raises(amslicer.StorageError) as caught:
        amslicer.verify(stack)
    assert "interrupted" in (caught.value.hint or "")


def test_fields_with_other_materials_are_refused(stack: Path, tmp_path: Path) -> None:
    fields = tmp_path / "other.yaml"
    fields.write_text("materials: [a, b]\nfields: {ratio: 0.3}\n")
    with pytest.raises(amslicer.JobError, match="materials are a, b"):
        amslicer.verify(stack, fields)


def test_margin_scale_and_rotation_are_understood(tmp_path: Path) -> None:
    grey = np.tile(np.linspace(30, 220, 40).astype(np.uint8), (30, 1))
    job = make_job(
        tmp_path,
        ratio={"image": parts.paint(tmp_path, grey)},
        printer=PRINTER | {"margin_px": 4},
        settings={"scale": 0.7, "rotate": [0, 0, 30]},
    )
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok
    # What slicing asked for and what verification reads back from the manifest are the same field.
    asked = json.loads((tmp_path / "out" / "manifest.json").read_text())["materials"][0]["ratio_asked"]
    assert report.materials["rigid"].expected == pytest.approx(asked, abs=1e-6)


def test_fields_without_the_scale_that_the_command_line_gave(tmp_path: Path) -> None:
    """The manifest says how the part was scaled; the fields that it is compared with need not."""
    ratio = {"gradient": {"axis": "x", "from": 0.1, "to": 0.9}}
    scaled = make_job(tmp_path, ratio=ratio, settings={"scale": 0.5, "rotate": [0, 0, 90]})
    amslicer.slice_job(scaled, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out", make_job(tmp_path, ratio=ratio).name)
    assert report.ok
    assert report.materials["rigid"].expected == pytest.approx(0.5, abs=1e-3)


def test_jobs_are_checked(stack: Path) -> None:
    with pytest.raises(amslicer.UsageError, match="at least 1"):
        amslicer.verify(stack, jobs=-1)


HONEST = [(seed, dimensions) for seed in range(25) for dimensions in (2, 3)]


def honest_job(folder: Path, seed: int, dimensions: int) -> Job:
    """A job drawn from the seed: ratio constant or graded, any direction, two bandwidths."""
    random = np.random.default_rng(seed)
    low, high = np.sort(random.uniform(0.1, 0.9, 2))
    ratio: Any = float(low) if seed % 2 else {"gradient": {"axis": "xyz"[seed % 3], "from": low, "to": high}}
    return make_job(
        folder,
        dimensions=dimensions, ratio=ratio, orientation=float(random.uniform(-90, 90)),
        bandwidth=float(random.choice([0.25, 0.5, 1.0])), seed=seed, period=float(random.uniform(0.8, 1.5)),
    )  # fmt: skip


@pytest.mark.parametrize(("seed", "dimensions"), HONEST)
def test_fifty_honest_stacks_raise_no_alarm(tmp_path: Path, seed: int, dimensions: int) -> None:
    amslicer.slice_job(honest_job(tmp_path, seed, dimensions), tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, report.checks
