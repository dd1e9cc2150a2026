"""Pictures that show a texture, and their periodic component against its definition and what can be solved by hand."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy import sparse
from scipy.sparse.linalg import spsolve

from amslicer import JobError
from amslicer.exemplar import periodic_component, read_exemplar

Floats = NDArray[np.float64]
ROUNDING = 1e-12


def saved(pixels: Any, kind: str = "PNG", **options: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


def raw_png(width: int, height: int, *, bits: int = 8, colour: int = 2, channels: int = 3, rows: int = -1) -> bytes:
    """A PNG by hand (RFC 2083), of a checkerboard of bytes; with fewer rows than its header says, if asked."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    row = bytes(i % 2 * 200 for i in range(width * channels * bits // 8))
    data = zlib.compress((b"\0" + row) * (height if rows < 0 else rows))
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def rgb_tiff(pixels: Any, bits: int, *, samples: int = 3, orientation: int = 1) -> bytes:
    """An uncompressed colour TIFF by hand (TIFF 6.0, page 24): one strip, samples beside each other."""
    array = np.asarray(pixels)
    data = array.astype(f"<u{bits // 8}").tobytes()
    entries = [
        (256, 1, array.shape[1]), (257, 1, array.shape[0]), (258, samples, -1), (259, 1, 1), (262, 1, 2), (273, 1, -2),
        (274, 1, orientation), (277, 1, samples), (278, 1, array.shape[0]), (279, 1, len(data)), (338, 1, 0),
    ][: 10 + (samples > 3)]  # fmt: skip
    depths = struct.pack(f"<{samples}H", *[bits] * samples)
    end = 8 + 2 + 12 * len(entries) + 4
    out = b"II*\0" + struct.pack("<IH", 8, len(entries))
    places = {-1: end, -2: end + len(depths)}
    for tag, count, value in entries:
        out += struct.pack("<HHII", tag, 3 if tag in (258, 338) else 4, count, places.get(value, value))
    return out + struct.pack("<I", 0) + depths + data


RNG = np.random.default_rng(3)
GREY8 = RNG.integers(0, 256, (9, 12), np.uint8)
GREY16 = RNG.integers(0, 65536, (9, 12), np.uint16)
RGB8 = RNG.integers(0, 256, (9, 12, 3), np.uint8)


# Reading


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
@pytest.mark.parametrize(("pixels", "full"), [(GREY8, 255), (GREY16, 65535), (RGB8, 255)], ids=["8", "16", "RGB"])
def test_values_are_shares_of_the_full_scale_and_row_0_is_the_lowest(kind: str, pixels: Any, full: int) -> None:
    exemplar = read_exemplar(saved(pixels, kind), "grain")
    assert exemplar.values.dtype == np.float64
    assert exemplar.values.shape == (9, 12, 1 if pixels.ndim == 2 else 3)
    assert exemplar.is_grey == (pixels.ndim == 2)
    assert exemplar.name == "grain"
    for row in range(9):
        np.testing.assert_array_equal(exemplar.values[row].ravel(), pixels[8 - row].ravel() / full)


def test_a_tiff_by_hand_is_read() -> None:
    """Else the refusals of its relatives would prove nothing."""
    np.testing.assert_array_equal(read_exemplar(rgb_tiff(RGB8, 8), "a").values[::-1], RGB8 / 255)


def test_one_colour_that_varies_is_enough() -> None:
    pixels = np.full((8, 8, 3), 7, np.uint8)
    pixels[3, 4, 2] = 8
    assert read_exemplar(saved(pixels), "a").values.shape == (8, 8, 3)


def converted(mode: str, kind: str) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(RGB8).convert(mode).save(stream, kind)
    return stream.getvalue()


def turned(kind: str) -> bytes:
    exif = Image.Exif()
    exif[0x0112] = 6  # displayed a quarter turn from how it is stored
    return saved(RGB8, kind, exif=exif)


def several(kind: str) -> bytes:
    return saved(RGB8, kind, save_all=True, append_images=[Image.fromarray(255 - RGB8)])


DEEP = np.asarray(RGB8, np.uint16) * 257
REFUSED: dict[str, tuple[bytes, str]] = {
    "constant": (saved(np.full((9, 9), 51, np.uint8)), "shows nothing: it is 0.2 everywhere"),
    "constant colour": (saved(np.full((9, 9, 3), (0, 51, 255), np.uint8)), "shows nothing: it is 0, 0.2, 1 everywhere"),
    "black": (saved(np.zeros((9, 9), np.uint16)), "shows nothing: it is 0 everywhere"),
    "7 rows": (saved(GREY8[:7]), "has 12 × 7 pixels; a texture is read from 8 or more a side"),
    "7 columns": (saved(RGB8[:, :7]), "has 7 × 9 pixels"),
    "one pixel": (saved(GREY8[:1, :1]), "has 1 × 1 pixels"),
    "16.1 Mpx": (raw_png(4025, 4000, colour=0, channels=1, rows=1), "4025 × 4000 pixels; at most 16 million are read"),
    "20 Mpx in colour": (raw_png(5000, 4000, rows=1), "5000 × 4000 pixels; at most 16 million are read"),
    "16-bit RGB": (raw_png(9, 9, bits=16), "has 16 bits per colour; 8 are read"),
    "16-bit RGB TIFF": (rgb_tiff(DEEP, 16), "has BitsPerSample (16, 16, 16)"),
    "RGB and one more": (
        rgb_tiff(np.dstack([RGB8, GREY8]), 8, samples=4), "has BitsPerSample (8, 8, 8, 8)"
    ),
    "palette": (converted("P", "PNG"), "is not grey or RGB (mode P)"),
    "RGBA": (saved(np.dstack([RGB8, GREY8])), "is not grey or RGB (mode RGBA)"),
    "grey and alpha": (raw_png(9, 9, colour=4, channels=2), "is not grey or RGB (mode LA)"),
    "CMYK": (converted("CMYK", "TIFF"), "is not grey or RGB (mode CMYK)"),
    "YCbCr": (converted("YCbCr", "TIFF"), "is not grey or RGB (mode YCbCr)"),
    "float": (saved(np.asarray(GREY8, np.float32), "TIFF"), "is not grey or RGB (mode F)"),
    "animated": (several("PNG"), "has frames"),
    "several pages": (several("TIFF"), "has 2 frames; one is needed"),
    "turned PNG": (turned("PNG"), "has an Exif orientation or other Exif data"),
    "turned TIFF": (rgb_tiff(RGB8, 8, orientation=6), "has Orientation 6"),
    "JPEG": (saved(RGB8, "JPEG"), "is not a PNG or TIFF picture"),
    "no rows": (raw_png(9, 9, rows=0), "is cut short: 0 of 9 rows are there"),
    "a row too few": (raw_png(9, 9, rows=8), "is cut short: 8 of 9 rows are there"),
    "text": (b"grain", "is not a PNG or TIFF picture"),
    "empty": (b"", "is not a PNG or TIFF picture"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_exemplars_that_are_refused(case: str) -> None:
    content, said = REFUSED[case]
    with pytest.raises(JobError) as caught:
        read_exemplar(content, "paint/grain.png")
    assert caught.value.message.startswith("the picture 'paint/grain.png' ")
    assert said in caught.value.message
    assert "\n" not in caught.value.message
    assert caught.value.hint


def test_a_large_exemplar_is_told_that_less_will_do() -> None:
    with pytest.raises(JobError) as caught:
        read_exemplar(REFUSED["20 Mpx in colour"][0], "a.png")
    assert caught.value.hint == "make it smaller: a micro-texture needs no more"


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_an_exemplar_cut_short_is_refused_or_whole(kind: str) -> None:
    """Never a picture with other values: only what follows the last texel may be missing."""
    whole = saved(RGB8, kind)
    refused = 0
    for length in range(len(whole)):
        try:
            found = read_exemplar(whole[:length], "a.png").values
        except JobError:
            refused += 1
        else:
            assert np.array_equal(found[::-1], RGB8 / 255), f"cut to {length} of {len(whole)} bytes"
    assert refused >= len(whole) - 40


# Periodic component


def inner_laplacian(h: Floats) -> Floats:
    """Δᵢ of the paper, pixel by pixel: |Nx ∩ Ω| f(x) - Σ f(y) over the neighbours y that are in the picture."""
    rows, columns = h.shape
    out = np.zeros(h.shape)
    for r in range(rows):
        for c in range(columns):
            inside = [(r + i, c + j) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
            inside = [(a, b) for a, b in inside if 0 <= a < rows and 0 <= b < columns]
            out[r, c] = len(inside) * h[r, c] - sum(h[at] for at in inside)
    return out


def circulant(count: int) -> Any:
    """2 on the diagonal, -1 for either neighbour around a ring."""
    ones = np.ones(count)
    ring = sparse.diags([2 * ones, -ones, -ones, [-1.0], [-1.0]], [0, 1, -1, count - 1, 1 - count])
    return sparse.csr_array(ring)


def solved(h: Floats) -> Floats:
    """The periodic Poisson problem (3) by a direct sparse solve, the mean as one more equation."""
    rows, columns = h.shape
    eye = [sparse.eye_array(n) for n in (rows, columns)]
    laplacian = sparse.kron(circulant(rows), eye[1]) + sparse.kron(eye[0], circulant(columns))
    ones = np.ones((h.size, 1))
    system = sparse.block_array([[laplacian, ones], [ones.T, None]], format="csc")
    return np.asarray(spsolve(system, np.append(inner_laplacian(h).ravel(), h.sum())))[:-1].reshape(h.shape)


@pytest.mark.parametrize("shape", [(8, 8), (9, 12), (12, 9), (15, 11)])
def test_it_solves_the_poisson_problem_of_the_interior_laplacian(shape: tuple[int, int]) -> None:
    h = np.random.default_rng(shape).uniform(0, 1, shape)
    expected = solved(h)
    assert np.abs(expected - h).max() > 0.05, "nothing to do"
    np.testing.assert_allclose(periodic_component(h), expected, rtol=0, atol=ROUNDING)


def test_its_laplacian_is_the_pictures_without_the_jumps_at_the_borders() -> None:
    """Checked without a solve: p's own differences, neighbours taken around the borders."""
    h = np.random.default_rng(1).uniform(0, 1, (23, 31))
    p = periodic_component(h)
    around = 4 * p - sum(np.roll(p, step, axis) for axis in (0, 1) for step in (1, -1))
    np.testing.assert_allclose(around, inner_laplacian(h), rtol=0, atol=ROUNDING)
    assert np.abs(around - (4 * h - sum(np.roll(h, s, a) for a in (0, 1) for s in (1, -1)))).max() > 0.1


@pytest.mark.parametrize("columns", [8, 9, 64, 501])
def test_a_gradient_is_flattened_by_the_number_of_its_pixels(columns: int) -> None:
    """By hand, in one dimension: p has h's steps plus the one constant that makes them close: a ramp of slope 1 becomes
    one of 1/N, and its energy on the cross of the spectrum falls by N²."""
    h = np.tile(np.arange(columns, dtype=float), (10, 1))
    p = periodic_component(h)
    np.testing.assert_allclose(p, h.mean() + (h - h.mean()) / columns, rtol=0, atol=1e-10)
    energy = [float((np.abs(np.fft.fft2(x - x.mean())[0]) ** 2).sum()) for x in (h, p)]
    print(f"{columns} columns: energy on the cross {energy[0] / energy[1]:.1f} times less")
    assert energy[0] / energy[1] == pytest.approx(columns**2, rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_of_a_picture_that_varies_along_one_axis_s_is_a_ramp(axis: int) -> None:
    """By hand: its slope is the jump between the last and the first pixel, divided by their number."""
    line = np.random.default_rng(5).uniform(0, 1, 20)
    h = np.tile(line, (13, 1)) if axis else np.tile(line[:, None], (1, 13))
    s = h - periodic_component(h)
    slope = np.diff(s, axis=axis)
    np.testing.assert_allclose(slope, (line[-1] - line[0]) / 20, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(np.diff(s, axis=1 - axis), 0, rtol=0, atol=ROUNDING)


def test_where_opposite_borders_are_equal_nothing_changes() -> None:
    """The paper's case is a constant border; any two opposite ones that agree leave no jump."""
    h = np.random.default_rng(6).uniform(0, 1, (16, 21))
    h[-1], h[:, -1] = h[0], h[:, 0]
    h[-1, -1] = h[0, -1] = h[-1, 0] = h[0, 0]
    np.testing.assert_allclose(periodic_component(h), h, rtol=0, atol=ROUNDING)
    h[0] = h[-1] = h[:, 0] = h[:, -1] = 0.3
    np.testing.assert_allclose(periodic_component(h), h, rtol=0, atol=ROUNDING)


def test_a_periodic_picture_changes_by_no_more_than_its_step_across_the_border() -> None:
    """Its last row is one step short of its first: the decomposition takes that step for a jump. Waves along one axis:
    s is the ramp of that step, ± half of it."""
    h = np.tile(0.5 + 0.4 * np.cos(2 * np.pi * (3 * np.arange(64) / 64 + 0.2)), (32, 1))
    step = abs(h[0, -1] - h[0, 0])
    changed = np.abs(h - periodic_component(h)).max()
    print(f"a wave of amplitude 0.4 changes by {changed:.4f}; its step across the border is {step:.4f}")
    assert 0 < changed <= step / 2


def test_the_mean_is_kept_and_channels_are_taken_one_by_one() -> None:
    h = np.random.default_rng(7).uniform(0, 1, (17, 24, 3))
    p = periodic_component(h)
    assert p.shape == h.shape
    np.testing.assert_allclose(p.mean(axis=(0, 1)), h.mean(axis=(0, 1)), rtol=0, atol=ROUNDING)
    for channel in range(3):
        np.testing.assert_allclose(p[..., channel], periodic_component(h[..., channel]), rtol=0, atol=ROUNDING)
