"""Bitmaps as other programs read them."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from amslicer import Layer
from amslicer.layer import Bitmaps
from amslicer.writers import WRITERS
from amslicer.writers.png import LEVELS, encode_png


def bitmaps_of(layer: Layer) -> Bitmaps:
    rows = np.stack([np.packbits(layer.labels == m, axis=1) for m in range(1, len(layer.materials) + 1)])
    return Bitmaps(layer.index, layer.z_mm, layer.materials, layer.labels.shape[1], rows)


@pytest.mark.parametrize("compression", LEVELS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 8), (5, 9), (64, 63), (31, 257)])
def test_png_is_what_pillow_reads(shape: tuple[int, int], compression: str) -> None:
    deposit = np.random.default_rng(1).random(shape) < 0.4
    picture = Image.open(io.BytesIO(encode_png(deposit, (25.4 / 600, 25.4 / 300), compression)))
    picture.load()
    assert (picture.format, picture.mode, picture.size) == ("PNG", "1", shape[::-1])
    assert np.array_equal(np.asarray(picture), deposit)
    assert picture.info["dpi"] == pytest.approx((600, 300), abs=0.02)  # whole pixels per metre
    Image.open(io.BytesIO(encode_png(deposit, (0.05, 0.05), compression))).verify()


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("compression", ["fast", "small"])
def test_a_writer_makes_one_file_per_material(name: str, compression: str) -> None:
    labels = np.array([[0, 1, 2], [2, 2, 0]], np.uint8)
    files = WRITERS[name](bitmaps_of(Layer(7, 0.1, labels, ("a", "b c"))), (0.1, 0.2), compression)
    assert [(path, material) for path, material, _ in files] == [("a/00007.png", "a"), ("b c/00007.png", "b c")]
    for number, (_, _, content) in enumerate(files, 1):
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(content))), labels == number)


def test_small_is_not_larger_than_fast() -> None:
    deposit = (np.add.outer(np.arange(400), np.arange(500)) // 9 % 2).astype(bool)
    sizes = [len(encode_png(deposit, (0.1, 0.1), name)) for name in ("small", "fast")]
    assert sizes[0] <= sizes[1]


@pytest.mark.parametrize("width", [1, 7, 8, 9, 63])
def test_bitmaps_and_labels_are_the_same_layer(width: int) -> None:
    labels = np.random.default_rng(width).integers(0, 4, (5, width)).astype(np.uint8)
    layer = Layer(3, 0.1, labels, ("a", "b", "c"))
    bitmaps = bitmaps_of(layer)
    assert bitmaps.rows.shape == (3, 5, -(-width // 8))
    np.testing.assert_array_equal(bitmaps.layer().labels, labels)
    assert bitmaps.pixels() == layer.pixels()
