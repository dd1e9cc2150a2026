"""Stacks on disk: layout, manifest, atomic files, and the law that nothing about the run changes a byte."""

from __future__ import annotations

import errno
import hashlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshes
import numpy as np
import parts
import pytest
from PIL import Image

import amslicer
from amslicer import Job, Run, StorageError, UsageError, stack, stackfolder, storage
from amslicer.pipeline import prepare

SIZE_MM = (9.0, 6.0, 1.0)
PRINTER = {"dpi": [300, 150], "layer_mm": 0.1, "margin_px": 3}


@pytest.fixture
def block(tmp_path: Path) -> Path:
    return parts.box(tmp_path, SIZE_MM, "block.stl")


def block_job(block: Path, **changes: Any) -> Job:
    settings: dict[str, Any] = {"printer": PRINTER, "dimensions": 3, "orientation": 40, "ratio": 0.3} | changes
    return parts.job(block, **settings)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_layout_and_manifest_are_as_documented(tmp_path: Path, block: Path) -> None:
    out = tmp_path / "out"
    result = amslicer.slice_job(block_job(block), out)
    manifest = json.loads((out / "manifest.json").read_text())
    # 9 mm at 300 dpi = 106.3 pixels, 6 mm at 150 dpi = 35.4, 1 mm in 0.1 mm layers = 10; 3 pixels on each side.
    assert (manifest["grid"]["width_px"], manifest["grid"]["height_px"]) == (107 + 6, 36 + 6)
    assert manifest["grid"]["layer_count"] == 10
    assert manifest["grid"]["pitch_mm"] == pytest.approx([25.4 / 300, 25.4 / 150])
    assert manifest["grid"]["origin_mm"] == pytest.approx([-3 * 25.4 / 300, -3 * 25.4 / 150, 0.0])
    assert (manifest["format"], manifest["version"], manifest["complete"]) == ("amslicer-stack", 1, True)
    assert manifest["part"]["sha256"] == hashlib.sha256(block.read_bytes()).hexdigest()
    assert manifest["part"]["bbox_mm"] == [[0, 0, 0], list(SIZE_MM)]
    names = [m["name"] for m in manifest["materials"]]
    assert names == ["rigid", "flexible"]
    expected = {f"{name}/{layer:05d}.png" for name in names for layer in range(10)}
    assert set(files(out)) == expected | {"manifest.json", "job.yaml"}
    voxel = 25.4 / 300 * 25.4 / 150 * 0.1
    for entry in manifest["materials"]:
        per_layer = [layer["pixels"][entry["name"]] for layer in manifest["layers"]]
        assert entry["pixels"] == sum(per_layer)
        assert entry["volume_mm3"] == pytest.approx(entry["pixels"] * voxel)
        assert entry["ratio"] == pytest.approx(entry["pixels"] / manifest["solid_pixels"])
    for layer in manifest["layers"]:
        assert layer["z_mm"] == pytest.approx((layer["index"] + 0.5) * 0.1)
        for name, digest in layer["sha256"].items():
            content = (out / name / f"{layer['index']:05d}.png").read_bytes()
            assert hashlib.sha256(content).hexdigest() == digest
    assert result.complete
    assert result.solid_pixels == 106 * 35 * 10  # centres inside the box: 106.3 and 35.4 rounded to whole centres


def test_bitmaps_are_one_bit_white_where_deposited_with_pixel_size(tmp_path: Path, block: Path) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(block_job(block), out)
    (layer, *_) = amslicer.layers(block_job(block))
    for number, name in enumerate(layer.materials, 1):
        picture = Image.open(out / name / "00000.png")
        assert picture.mode == "1"
        # pHYs counts whole pixels per metre.
        assert picture.info["dpi"] == pytest.approx((300, 150), abs=0.02)
        assert np.array_equal(np.asarray(picture), layer.labels == number)
        assert not np.asarray(picture)[:3].any()
        assert not np.asarray(picture)[:, -3:].any()


def test_manifest_and_job_have_no_clock_path_or_thread_count(tmp_path: Path, block: Path) -> None:
    amslicer.slice_job(block_job(block), tmp_path / "a", run=Run(jobs=1))
    for name in ("manifest.json", "job.yaml"):
        text = (tmp_path / "a" / name).read_text()
        assert str(tmp_path) not in text
        assert "jobs" not in text
        assert "seconds" not in text


RUNS: list[tuple[str, Run]] = [
    ("again", Run()),
    ("one thread", Run(jobs=1)),
    ("two threads", Run(jobs=2)),
]


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize(("name", "run"), RUNS, ids=[name for name, _ in RUNS])
def test_no_run_changes_a_byte(tmp_path: Path, block: Path, name: str, run: Run, dimensions: int) -> None:
    job = block_job(block, dimensions=dimensions, ratio={"gradient": {"axis": "z", "from": 0.1, "to": 0.9}})
    amslicer.slice_job(job, tmp_path / "first")
    amslicer.slice_job(job, tmp_path / "second", run=run)
    assert files(tmp_path / "first") == files(tmp_path / "second")


def test_pieces_have_the_bytes_of_the_whole(tmp_path: Path, block: Path) -> None:
    job = block_job(block)
    amslicer.slice_job(job, tmp_path / "whole")
    whole = files(tmp_path / "whole")
    pieces: dict[str, bytes] = {}
    for first, end in ((0, 1), (1, 4), (4, None)):
        out = tmp_path / f"piece{first}"
        amslicer.slice_job(job, out, run=Run(layers=(first, end)))
        manifest = json.loads((out / "manifest.json").read_text())
        assert manifest["complete"] is False
        assert manifest["job_digest"] == json.loads(whole["manifest.json"])["job_digest"]
        pieces |= {name: content for name, content in files(out).items() if name.endswith(".png")}
    assert pieces == {name: content for name, content in whole.items() if name.endswith(".png")}


def test_a_batch_of_any_size_has_the_same_bytes(tmp_path: Path, block: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from amslicer import block as blocks
    from amslicer import pipeline

    job = block_job(block)
    amslicer.slice_job(job, tmp_path / "large")
    monkeypatch.setattr(pipeline, "BATCH_BYTES", 1)
    monkeypatch.setattr(blocks, "FIELD_BYTES", 1)
    amslicer.slice_job(job, tmp_path / "small")
    assert files(tmp_path / "large") == files(tmp_path / "small")


def uniform(folder: Path) -> dict[str, Any]:
    grey = np.full((7, 5), 51, np.uint8)  # 51 / 255 = 0.2
    return {"image": parts.paint(folder, grey, "uniform.png")}


SAME_VALUE: list[tuple[str, Callable[[Path], Any]]] = [
    ("gradient", lambda _: {"gradient": {"axis": "x", "from": 0.2, "to": 0.2}}),
    ("gradient in z", lambda _: {"gradient": {"axis": "z", "from": 0.2, "to": 0.2}}),
    ("picture", uniform),
    ("picture with range", lambda folder: uniform(folder) | {"range": [0.0, 1]}),
]


@pytest.mark.parametrize(("name", "field"), SAME_VALUE, ids=[name for name, _ in SAME_VALUE])
def test_the_same_value_however_written_gives_the_same_bytes(
    tmp_path: Path, block: Path, name: str, field: Callable[[Path], Any]
) -> None:
    amslicer.slice_job(block_job(block, ratio=0.2), tmp_path / "constant")
    amslicer.slice_job(block_job(block, ratio=field(tmp_path)), tmp_path / "field")
    pictures = [
        {n: c for n, c in files(tmp_path / which).items() if n.endswith(".png") and "inputs" not in n}
        for which in ("constant", "field")
    ]
    assert pictures[0] == pictures[1]


def test_the_same_direction_however_written_gives_the_same_bytes(tmp_path: Path, block: Path) -> None:
    grey = parts.paint(tmp_path, np.full((4, 4), 255, np.uint8))
    as_picture = {"azimuth": {"image": grey, "range": [0, 40]}, "elevation": {"image": grey, "range": [0, 20]}}
    as_numbers = {"azimuth": 40, "elevation": {"gradient": {"axis": "y", "from": 20, "to": 20}}}
    first, second = (parts.labels(block_job(block, orientation=o)) for o in (as_picture, as_numbers))
    assert np.array_equal(first, second)


def test_job_yaml_slices_again_to_the_same_stack(tmp_path: Path, block: Path) -> None:
    grey = np.tile(np.arange(0, 250, 10, dtype=np.uint8), (20, 1))
    ratio = {"image": parts.paint(tmp_path, grey), "range": [0.2, 0.7]}
    amslicer.slice_job(block_job(block, ratio=ratio), tmp_path / "first")
    again = amslicer.load_job(tmp_path / "first" / "job.yaml", part=block)
    amslicer.slice_job(again, tmp_path / "second")
    assert files(tmp_path / "first") == files(tmp_path / "second")


def test_pictures_of_the_same_name_are_both_kept(tmp_path: Path, block: Path) -> None:
    for folder, grey in (("a", 100), ("b", 200)):
        (tmp_path / folder).mkdir()
        parts.paint(tmp_path / folder, np.full((4, 4), grey, np.uint8), "map.png")
    job = block_job(block, ratio={"image": "a/map.png"}, orientation={"image": "b/map.png", "range": [0, 90]})
    amslicer.slice_job(job, tmp_path / "out")
    kept = [np.asarray(Image.open(p))[0, 0] for p in sorted((tmp_path / "out" / "inputs").iterdir())]
    assert sorted(kept) == [100, 200]
    assert amslicer.verify(tmp_path / "out").ok


def test_a_stack_reads_back_as_it_was_made(tmp_path: Path, block: Path) -> None:
    job = block_job(block)
    amslicer.slice_job(job, tmp_path / "out")
    stack = amslicer.open_stack(tmp_path / "out")
    assert len(stack) == 10
    for made, read in zip(amslicer.layers(job), stack, strict=True):
        assert (made.index, made.z_mm) == (read.index, read.z_mm)
        assert np.array_equal(made.labels, read.labels)
        assert np.array_equal(made.mask("rigid"), read.labels == 1)
    assert np.array_equal(stack[-1].labels, stack[9].labels)
    assert [layer.index for layer in stack[2:4]] == [2, 3]
    with pytest.raises(UsageError, match="no material 'soft'"):
        stack[0].mask("soft")


def test_a_folder_that_is_not_empty_is_refused(tmp_path: Path, block: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("x")
    with pytest.raises(UsageError, match="not empty"):
        amslicer.slice_job(block_job(block), tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_overwrite_deletes_what_amslicer_wrote_and_nothing_else(tmp_path: Path, block: Path) -> None:
    out = tmp_path / "out"
    ratio = {"image": parts.paint(tmp_path, np.full((4, 4), 90, np.uint8))}
    amslicer.slice_job(block_job(block, ratio=ratio), out)
    (out / "mine.txt").write_text("x")
    (out / "rigid" / "notes.txt").write_text("y")
    (out / "manifest.json").unlink()  # as after an interruption
    job = block_job(block, settings={"scale": 0.5})
    amslicer.slice_job(job, out, overwrite=True)
    amslicer.slice_job(job, tmp_path / "fresh")
    assert set(files(out)) == set(files(tmp_path / "fresh")) | {"mine.txt", "rigid/notes.txt"}


@pytest.mark.parametrize("name", ["rigid/00000.png", "job.yaml", "manifest.json"])
def test_overwrite_never_replaces_what_amslicer_did_not_write(tmp_path: Path, block: Path, name: str) -> None:
    foreign = tmp_path / "out" / name
    foreign.parent.mkdir(parents=True)
    foreign.write_text("mine")
    with pytest.raises(UsageError, match="did not write it"):
        amslicer.slice_job(block_job(block), tmp_path / "out", overwrite=True)
    assert foreign.read_text() == "mine"


def test_out_that_is_a_file_is_refused(tmp_path: Path, block: Path) -> None:
    with pytest.raises(UsageError, match="is a file"):
        amslicer.slice_job(block_job(block), block)


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("stage", ["encoding", "writing", "progress"])
def test_what_fails_ends_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, jobs: int) -> None:
    """In any stage, some batches behind the device: nothing goes on, nothing is called finished, no thread is left."""
    monkeypatch.setattr("amslicer.pipeline.BATCH_BYTES", 1)  # a layer at a time
    job = parts.job(parts.box(tmp_path, (4.0, 4.0, 4.0)), printer=PRINTER, dimensions=3, ratio=0.3)
    out, begun, before = tmp_path / "out", [], set(threading.enumerate())

    def fails(*arguments: Any) -> Any:
        begun.append(1)
        if len(begun) == 3:
            raise KeyboardInterrupt if stage == "progress" else RuntimeError("a damaged encoder")
        return encode(*arguments)

    name, kind = {"encoding": ("_encode", RuntimeError), "writing": ("_write", RuntimeError)}.get(
        stage, ("", KeyboardInterrupt)
    )
    encode = getattr(stack, name) if name else lambda *arguments: None
    if name:
        monkeypatch.setattr(stack, name, fails)
    assert prepare(job).grid.layers == 40
    with pytest.raises(kind):
        amslicer.slice_job(job, out, run=Run(jobs=jobs), progress=None if name else fails)
    assert len(begun) <= 9  # the batches that were waiting, not the whole part
    assert not (out / "manifest.json").exists()
    assert set(threading.enumerate()) <= before


def test_a_full_disk_leaves_no_half_file(tmp_path: Path, block: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = 0
    sync = storage.os.fsync

    def fails_at_the_fifth(descriptor: int) -> None:
        nonlocal written
        written += 1
        if written >= 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(descriptor)

    monkeypatch.setattr(storage.os, "fsync", fails_at_the_fifth)
    with pytest.raises(StorageError, match="No space left") as caught:
        amslicer.slice_job(block_job(block), tmp_path / "out")
    assert caught.value.exit_code == 6
    assert "make space" in (caught.value.hint or "")
    monkeypatch.undo()
    left = files(tmp_path / "out")
    assert "manifest.json" not in left
    assert not [name for name in left if name.endswith(storage.TEMPORARY)]
    for name in left:
        if name.endswith(".png"):
            Image.open(tmp_path / "out" / name).load()
    amslicer.slice_job(block_job(block), tmp_path / "out", overwrite=True)
    assert amslicer.verify(tmp_path / "out").ok


def test_a_disk_that_may_be_too_small_is_noted_before_anything_is_written(
    tmp_path: Path, block: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Two materials of 10 layers, each 36 + 6 pixels high and 107 + 6 pixels, 15 bytes, wide."""
    size = 2 * 10 * (36 + 6) * 15
    for free, noted in ((size, False), (size - 1, True)):
        caplog.clear()
        monkeypatch.setattr(storage.shutil, "disk_usage", lambda place, free=free: SimpleNamespace(free=free))
        with caplog.at_level("INFO", logger="amslicer"):
            amslicer.slice_job(block_job(block), tmp_path / "new" / f"{free}")
        assert ("note: the bitmaps may not fit" in caplog.text) == noted
    assert str(tmp_path) in caplog.text


def test_overwrite_deletes_only_the_layers_that_the_manifest_lists(tmp_path: Path, block: Path) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(block_job(block), out)
    (out / "rigid" / "99999.png").write_text("mine")
    with pytest.raises(UsageError, match="did not write it"):
        amslicer.slice_job(block_job(block), out, overwrite=True)
    assert (out / "rigid" / "99999.png").read_text() == "mine"


def test_overwrite_follows_no_name_out_of_the_folder(tmp_path: Path, block: Path) -> None:
    out, victim = tmp_path / "out", tmp_path / "victim"
    amslicer.slice_job(block_job(block), out)
    victim.mkdir()
    (victim / "00001.png").write_text("mine")
    job = (out / "job.yaml").read_text().replace("name: rigid", "name: ../victim")
    (out / "job.yaml").write_text(job)
    (out / "manifest.json").unlink()
    with pytest.raises(UsageError, match="did not write it"):  # rigid's bitmaps are nobody's now
        amslicer.slice_job(block_job(block), out, overwrite=True)
    assert (victim / "00001.png").read_text() == "mine"


@pytest.mark.parametrize("materials", ["materials:\n- a\n- b\n", "materials: null\n", "[\n"])
def test_overwrite_of_an_edited_job_is_no_traceback(tmp_path: Path, block: Path, materials: str) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(block_job(block), out)
    (out / "job.yaml").write_text(stackfolder.JOB_HEADER + materials)
    with pytest.raises(UsageError, match="did not write it"):
        amslicer.slice_job(block_job(block), out, overwrite=True)


def test_left_over_temporary_files_go_with_the_stack(tmp_path: Path, block: Path) -> None:
    out = tmp_path / "out"
    amslicer.slice_job(block_job(block), out)
    (out / "manifest.json").unlink()
    for name in ("manifest.json", "job.yaml", "rigid/00003.png"):
        (out / (name + storage.TEMPORARY)).write_text("torn")
    amslicer.slice_job(block_job(block), out, overwrite=True)
    assert not [name for name in files(out) if name.endswith(storage.TEMPORARY)]


def test_a_job_that_cannot_work_leaves_the_old_stack_alone(tmp_path: Path, block: Path) -> None:
    amslicer.slice_job(block_job(block), tmp_path / "out")
    before = files(tmp_path / "out")
    for axis in "xz":
        wrong = block_job(block, ratio={"gradient": {"axis": axis, "from": 0.5, "to": 1.5}})
        with pytest.raises(amslicer.JobError, match="a ratio is between 0 and 1"):
            amslicer.slice_job(wrong, tmp_path / "out", overwrite=True)
    assert files(tmp_path / "out") == before


def test_two_runs_in_one_folder_are_refused(tmp_path: Path, block: Path) -> None:
    with (
        stackfolder.opened_folder(tmp_path / "out", block_job(block), overwrite=False),
        pytest.raises(UsageError, match="another amslicer is writing"),
    ):
        amslicer.slice_job(block_job(block), tmp_path / "out", overwrite=True)


def test_a_part_without_a_solid_pixel_is_noted(tmp_path: Path) -> None:
    thin = parts.box(tmp_path, (3.0, 0.01, 3.0))
    result = amslicer.slice_job(block_job(thin), tmp_path / "out")
    assert result.solid_pixels == 0
    assert [(m.ratio, m.asked) for m in result.materials] == [(0, 0), (0, 0)]
    assert any("no pixel is solid" in note for note in result.notes)
    assert amslicer.verify(tmp_path / "out").ok


def test_empty_layers_between_solid_ones_are_noted(tmp_path: Path) -> None:
    low, high = (meshes.box((3.0, 3.0, 0.4), (0.0, 0.0, z)) for z in (0.0, 0.8))
    part = parts.stl(tmp_path, meshes.joined(low, high))
    result = amslicer.slice_job(block_job(part), tmp_path / "out")
    assert any("4 layers between solid ones are empty, first 4" in note for note in result.notes)


def test_overlapping_bodies_are_noted(tmp_path: Path) -> None:
    part = parts.stl(tmp_path, meshes.joined(meshes.box((6.0, 6.0, 6.0)), meshes.box((6.0, 6.0, 6.0), (1.0, 1.0, 1.0))))
    result = amslicer.slice_job(block_job(part), tmp_path / "out")
    assert any("overlapping bodies count once" in note for note in result.notes)
    alone = amslicer.slice_job(block_job(parts.box(tmp_path, (6.0, 6.0, 6.0))), tmp_path / "alone")
    assert not any("overlapping" in note for note in alone.notes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"period": 0.4}, "sheets are lost"),
        ({"ratio": 0.05, "period": 1.0}, "the thinnest sheets are 50 µm"),
        (
            {"ratio": {"gradient": {"axis": "x", "from": 0.5, "to": 0.95}}, "period": 1.0},
            "the thinnest sheets are 50 µm",
        ),
    ],
)
def test_sheets_finer_than_pixels_are_noted(tmp_path: Path, block: Path, changes: dict[str, Any], said: str) -> None:
    result = amslicer.slice_job(block_job(block, **changes), tmp_path / "out")
    assert any(said in note for note in result.notes), result.notes


def test_every_solid_pixel_has_one_material_and_no_other_pixel_any(tmp_path: Path, block: Path) -> None:
    job = block_job(block, ratio={"gradient": {"axis": "x", "from": 0.0, "to": 1.0}})
    for layer in amslicer.layers(job):
        solid = np.zeros(layer.labels.shape, bool)
        solid[3 + 1 : -3, 3:-4] = True  # top row and right column: centres outside the box (35.4, 106.3)
        assert np.array_equal(layer.labels > 0, solid)
        assert layer.labels.max() <= 2


def test_ratios_of_zero_and_one_are_plain_fills(block: Path) -> None:
    for ratio, label in ((0, 2), (1, 1), (1.0, 1), ({"gradient": {"axis": "z", "from": 1, "to": 1}}, 1)):
        labels = parts.labels(block_job(block, ratio=ratio))
        assert set(np.unique(labels)) == {0, label}


def test_layer_ranges_are_like_pythons(block: Path) -> None:
    job = block_job(block)
    for chosen, expected in (((7, None), [7, 8, 9]), ((None, 2), [0, 1]), ((-2, None), [8, 9]), ((8, 99), [8, 9])):
        assert [layer.index for layer in amslicer.layers(job, Run(layers=chosen))] == expected
    with pytest.raises(UsageError, match="10 layers"):
        next(amslicer.layers(job, Run(layers=(10, None))))


def test_field_is_g_at_every_pixel_of_the_rectangle(block: Path) -> None:
    job = block_job(block, ratio=0.4)
    g = amslicer.field(job, -1)
    assert g.shape == (36 + 6, 107 + 6)
    assert g.dtype == np.complex64
    assert np.all(np.abs(g) > 0)
    labels = parts.labels(job)[-1]
    # material 1 where |arg G| < π ratio
    asked = np.where(np.abs(np.angle(g)) < np.pi * 0.4, 1, 2)
    assert np.mean(asked[labels > 0] != labels[labels > 0]) < 1e-3
    with pytest.raises(UsageError, match="no layer 10"):
        amslicer.field(job, 10)


def test_the_summary_weighs_what_was_deposited(tmp_path: Path, block: Path) -> None:
    job = amslicer.load_job(
        {
            "printer": {"pitch_um": 100, "layer_um": 100},
            "materials": [{"name": "a", "density_g_cm3": 1.5}, "b"],
            "fields": {"ratio": 1},
        },
        part=block,
    )
    result = amslicer.slice_job(job, tmp_path / "out")
    heavy, light = result.materials
    assert heavy.volume_mm3 == pytest.approx(54.0)
    assert heavy.grams == pytest.approx(0.081)  # 54 mm³ at 1.5 g/cm³
    assert (heavy.ratio, heavy.asked, light.ratio, light.asked) == (1, 1, 0, 0)
    assert light.grams is None


def test_turning_the_part_and_its_fields_together_keeps_the_laminate(tmp_path: Path, block: Path) -> None:
    ratio = {"gradient": {"axis": "x", "from": 0.2, "to": 0.8}}
    straight = parts.labels(block_job(block, ratio=ratio, printer=parts.SQUARE))
    turned = parts.labels(block_job(block, ratio=ratio, printer=parts.SQUARE, settings={"rotate": [0, 0, 180]}))
    halves = [[np.mean(half[half > 0] == 1) for half in np.array_split(x, 2, axis=2)] for x in (straight, turned)]
    assert halves[0][0] == pytest.approx(0.35, abs=0.05)
    assert halves[0][1] == pytest.approx(0.65, abs=0.05)
    assert halves[1][0] == pytest.approx(0.65, abs=0.05)
    assert halves[1][1] == pytest.approx(0.35, abs=0.05)
