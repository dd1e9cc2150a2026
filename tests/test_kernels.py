"""Each OpenCL kernel alone, against its twin in amslicer.reference, over ordinary and awkward inputs.

Tolerances are the rounding of float32 (half a unit in the last place is 2^-24) carried through the formula,
with the accuracy that OpenCL promises for exp, sin and cos (3 and 4 units).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

from amslicer import reference
from amslicer.device import Device
from amslicer.evaluator import AXIS, work_shape
from amslicer.generator import DeviceGenerator
from amslicer.noise import turn
from amslicer.profiles import PROFILES
from amslicer.profiles.rank import RankProfile
from amslicer.resources import resource_folder

Floats = NDArray[np.float64]
Kernels = tuple[NDArray[np.float32], ...]

ULP = 2.0**-24
LIBRARY_ULP = 8 * ULP  # exp (3 units) and sincos (4), and their product
SIZES = [1, 2, 13, 63, 65, 127, 257]  # one, primes, and either side of powers of two
FILES = sorted(resource_folder("cl").glob("*.cl"))
# Tile sides and vector widths that work together; the first is what most jobs on most CPUs use.
SHAPES = [(32, 8), (32, 16), (16, 8), (16, 16), (8, 8)]
WAVES = {"PAINTED": 1, "LEVELS": 2, "SAMPLES": 64, "COSINES": 16, "ISOTROPIES": 3}  # as cl/waves.cl asks for
TAPS = {"TAPS_X": 9, "TAPS_Y": 6, "TAPS_Z": 6, "COLUMNS": 3, "ROW_GROUPS": 8}  # of cl/interpolate.cl


def zeroed(device: Device, nbytes: int) -> Any:
    buffer = device.empty(nbytes)
    device.fill_zeros(buffer, nbytes)
    return buffer


def constants(device: Device, shape: tuple[int, int]) -> dict[str, int]:
    """The macros of cl/tile.h for a tile side and a vector width."""
    return {**work_shape(device, shape[0]), "VECTOR": shape[1]}


def assert_close(got: NDArray[np.complex64], expected: NDArray[np.complex128], bound: Floats) -> None:
    """Within the bound everywhere, and no NaN on either side."""
    assert got.shape == expected.shape
    assert np.all(np.isfinite(got))
    assert np.all(np.isfinite(expected))
    assert np.max(np.abs(got - expected) - bound) <= 0


def some_kernels(count: int, seed: int, pixels: int, pitch_mm: float) -> Kernels:
    """Offset, wave, decay, radius of kernels over a row of pixels, as the device gets them.

    Beside ordinary ones: no wave, a centre on a pixel centre, on a pixel's border and far outside, a support
    smaller than a pixel, a kernel so narrow that its envelope underflows.
    """
    random = np.random.default_rng(seed)
    extent = pixels * pitch_mm
    offset, wave = random.uniform(-0.2 * extent, 1.2 * extent, count), random.uniform(-30, 30, count)
    decay, radius = random.uniform(0.05, 5.0, count), random.uniform(0.3, 1.0, count) * extent
    awkward = [
        (2.5 * pitch_mm, 0.0, 1.0, extent),
        (8 * pitch_mm, 6.0, 0.2, extent),
        (-100 * extent, 6.0, 1.0, extent),
        (10.3 * pitch_mm, -6.0, 1.0, 0.4 * pitch_mm),
        (5.1 * pitch_mm, 12.0, 1e6, extent),
    ]
    for place, values in zip(range(count - 1, 0, -1), awkward, strict=False):
        offset[place], wave[place], decay[place], radius[place] = values
    return tuple(a.astype(np.float32) for a in (offset, wave, decay, radius))


def rounding(d: Floats, magnitude: Floats, wave: Floats, decay: Floats) -> Floats:
    """How far float32 may be off at the distance d (mm), itself a difference of numbers of this magnitude."""
    in_d = 4 * ULP * magnitude
    slope = np.abs(wave) + np.sqrt(2 * decay / np.e)  # steepest carrier and envelope, 1/mm
    envelope = np.exp(-decay * d**2)
    in_arguments = envelope * (np.abs(wave * d) * ULP + 3 * decay * d**2 * ULP)
    return in_d * slope + in_arguments + LIBRARY_ULP


def is_tiled(file: Path) -> bool:
    source = file.read_text(encoding="utf-8")
    return '#include "tile.h"' in source or '#include "deposit.h"' in source


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.stem)
def test_each_file_builds_alone(device: Device, file: Path) -> None:
    """With the constants that tile.h asks for, for every shape, or with none where a file does not include it."""
    for macros in [{**constants(device, shape), **TAPS, **WAVES} for shape in SHAPES] if is_tiled(file) else [{}]:
        assert device.kernel(file.stem, macros).function_name == file.stem


def test_every_file_is_tried() -> None:
    assert {
        "along_z",
        "fill",
        "impulses",
        "interpolate",
        "normal_fields",
        "per_pixel",
        "profile",
        "rank1",
        "tables",
    } <= {f.stem for f in FILES}


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("count", SIZES)
def test_tables(device: Device, count: int, shape: tuple[int, int]) -> None:
    slots, pitch = 3, np.float32(25.4 / 600)
    pixels = slots * shape[0]
    offset, wave, decay, radius = some_kernels(count, count, pixels, float(pitch))
    axes = np.zeros(count + 1, AXIS)
    axes["offset"][:-1], axes["wave"][:-1] = offset, wave
    axes["table"] = slots * np.arange(count + 1)
    got = np.full((count, slots, 2, shape[0]), np.nan, np.float32)
    buffer = device.empty(got.nbytes)
    device.kernel("tables", constants(device, shape))(
        device.queue, (count,), (1,), buffer, device.buffer(axes),
        device.buffer(np.stack([decay, radius], axis=-1)),
        np.array([pitch, pitch / 2, shape[0] * pitch, 0], np.float32),
    )  # fmt: skip
    device.read(buffer, got)
    got_complex = (got[:, :, 0] + 1j * got[:, :, 1]).reshape(count, pixels)

    o, w, a, r = (v.astype(np.float64) for v in (offset, wave, decay, radius))
    expected = reference.tables(o, w, a, r, pitch_mm=float(pitch), pixels=pixels)
    x = (np.arange(pixels) + 0.5) * float(pitch)
    d, magnitude = x - o[:, None], x + np.abs(o[:, None])
    clear = np.abs(np.abs(d) - r[:, None]) > 4 * ULP * magnitude  # of the support's edge
    assert np.count_nonzero(~clear) <= 2
    bound = rounding(d, magnitude, w[:, None], a[:, None])
    assert_close(np.where(clear, got_complex, 0), np.where(clear, expected, 0), bound)
    assert np.all(got_complex[clear & (np.abs(d) > r[:, None])] == 0)  # zero outside, not merely small


@pytest.mark.parametrize("count", SIZES)
@pytest.mark.parametrize("shape", SHAPES[:2], ids=str)
@pytest.mark.parametrize(("layers", "first"), [(1, 0), (1, 15), (3, 7), (16, 0), (9, 2)])
def test_along_z(device: Device, count: int, layers: int, first: int, shape: tuple[int, int]) -> None:
    layer_mm = np.float32(0.027)
    centre, wave, decay, radius = some_kernels(count, 100 + count, 32, 0.1)
    phase = np.random.default_rng(count).uniform(0, 2 * np.pi, count).astype(np.float32)
    phase[0] = 0
    for planar in (False, True):
        got = np.full((layers, count), np.nan, np.complex64)
        buffer = device.empty(got.nbytes)
        device.run(
            device.kernel("along_z", constants(device, shape)), count, buffer,
            device.buffer(np.stack([-centre, wave, phase, decay], axis=-1)),
            device.buffer(np.stack([decay, radius], axis=-1)), np.uint32(count), np.uint32(layers), layer_mm,
            np.uint32(first), np.uint32(planar),
        )  # fmt: skip
        device.read(buffer, got)
        h, w, f, a, r = (v.astype(np.float64) for v in (-centre, wave, phase, decay, radius))
        z = (first + np.arange(layers)) * float(layer_mm) * (not planar)
        if planar:
            h = np.zeros(count)
        expected = reference.along_z(h, w, f, a, r, z)
        magnitude = np.abs(h) + z[:, None]
        d = h + z[:, None]
        clear = np.abs(np.abs(d) - r) > 4 * ULP * magnitude
        assert np.count_nonzero(~clear & (r > 0)) <= 2
        bound = rounding(d, magnitude, w, a) + 2 * np.pi * ULP  # the phase's own rounding in the sum
        assert_close(np.where(clear, got, 0), np.where(clear, expected, 0), bound)


@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("rows", [1, 31, 32, 33, 127])
@pytest.mark.parametrize("columns", [1, 37, 63, 65])
def test_fill(device: Device, columns: int, rows: int, layers: int) -> None:
    """Empty rows, empty runs, full rows, runs that end at the last column; the padding stays empty."""
    padded_rows, padded_columns = -(-rows // 32) * 32, -(-columns // 32) * 32
    random = np.random.default_rng(columns * rows)
    count = random.integers(0, 4, layers * rows)
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.uint32)
    runs = np.sort(random.integers(0, columns + 1, (int(starts[-1]), 2)), axis=1).astype(np.int32)
    runs[: len(runs) // 5] = (0, columns)
    got = np.empty((layers, padded_rows, padded_columns // 8), np.uint8)
    solid = zeroed(device, got.nbytes)
    device.run(
        device.kernel("fill"), layers * rows, solid, device.buffer(starts), device.buffer(runs),
        np.uint32(padded_columns // 8), np.uint32(rows), np.uint32(padded_rows), np.uint32(layers * rows),
    )  # fmt: skip
    device.read(solid, got)
    expected = np.zeros((layers, padded_rows, padded_columns), np.uint8)
    expected[:, :rows, :columns] = reference.fill(starts, runs, columns).reshape(layers, rows, columns)
    assert np.array_equal(np.unpackbits(got, axis=-1), expected)


def test_fill_twin_on_rows_drawn_by_hand() -> None:
    starts, runs = np.array([0, 0, 1, 3, 4]), np.array([[0, 5], [1, 2], [3, 5], [2, 2]])
    expected = [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1], [0, 1, 0, 1, 1], [0, 0, 0, 0, 0]]
    assert reference.fill(starts, runs, 5).tolist() == expected


def labels_of(deposits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(layers, rows, columns) labels of (layers, materials, rows, bytes); no pixel belongs to two materials."""
    bits = np.unpackbits(deposits, axis=-1)
    assert bits.sum(axis=1).max() <= 1
    return np.einsum("m,lmyx->lyx", np.arange(1, bits.shape[1] + 1, dtype=np.uint8), bits)


def device_labels(
    device: Device, g: NDArray[np.complex64], cumulative: Floats, solid: NDArray[np.uint8],
    shape: tuple[int, int] = SHAPES[0], profile: str | RankProfile = "symmetric", wave: Floats | None = None,
    seed: int = 0, first_layer: int = 0,
) -> NDArray[np.uint8]:  # fmt: skip
    """cl/profile.cl and cl/deposit.h on (layers, rows, columns) of G, multiples of the tile, tiles in reverse order."""
    layers, rows, columns = g.shape
    tile = shape[0]
    tiles = np.argwhere(np.ones((rows // tile, columns // tile)))[::-1, ::-1].astype(np.int32)
    slots = np.arange(len(tiles), dtype=np.uint32)[::-1]
    cut = g.reshape(layers, rows // tile, tile, columns // tile, tile).transpose(0, 1, 3, 2, 4)
    field = np.stack([cut.real, cut.imag], axis=-2)
    kind = PROFILES[profile] if isinstance(profile, str) else profile
    table = None if isinstance(profile, str) else profile.rank_table(parts.noise("phasor"))
    ranks = np.zeros((1, 1), np.float32) if table is None else table.ranks
    thresholds = np.broadcast_to(kind.thresholds(cumulative), (len(cumulative), rows, columns))
    waves = np.zeros((len(tiles), 4), np.float32)
    waves[:, :3] = 0.0 if wave is None else wave
    macros = {**constants(device, shape), "CYCLIC": kind.arrows, "DITHERED": wave is not None, "VALUE": 0,
              "TABLE": 0 if table is None else ranks.shape[1],
              "BLENDED": 0}  # fmt: skip
    deposits = np.zeros((layers, len(cumulative) + 1, rows, columns // 8), np.uint8)
    out = zeroed(device, deposits.nbytes)
    device.kernel("profile", macros)(
        device.queue, (tile, len(tiles), layers), (tile, 1, 1), out, device.buffer(field),
        device.buffer(np.packbits(solid, axis=-1)),
        device.buffer(thresholds), device.buffer(ranks), np.float32(1),
        device.buffer(tiles), device.buffer(slots), np.uint32(len(cumulative)),
        np.array([columns, rows], np.uint32), np.uint32(len(tiles)), np.uint32(layers), np.uint32(0),
        device.buffer(waves), np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint32), np.uint32(reference.EDGES),
        np.uint32(first_layer), np.uint32(0),
    )  # fmt: skip
    device.read(out, deposits)
    return labels_of(deposits)


def random_phasors(shape: tuple[int, ...], seed: int) -> NDArray[np.complex64]:
    random = np.random.default_rng(seed)
    return (random.normal(size=shape) + 1j * random.normal(size=shape)).astype(np.complex64)


def ties(g: NDArray[np.complex64], cumulative: Floats) -> NDArray[np.bool_]:
    """Where rounding decides: squares of float32 numbers, compared, are off by at most 4 · 2^-24 of |G|²."""
    cosine = np.cos(np.angle(g.astype(np.complex128)))
    limit = np.cos(np.pi * cumulative)
    near = np.abs(cosine * np.abs(cosine) - limit * np.abs(limit)) <= 4 * ULP * cosine**2
    return np.any(near & (cumulative > 0) & (cumulative < 1), axis=0)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("tiles", [(1, 1, 1), (2, 1, 5), (3, 4, 2)])
@pytest.mark.parametrize("cumulative", [[0.5], [0.25], [0.001], [0.999], [0.2, 0.7], [0.0, 0.3, 0.3, 1.0]], ids=str)
def test_profile(device: Device, cumulative: list[float], tiles: tuple[int, int, int], shape: tuple[int, int]) -> None:
    pixels = (tiles[0], tiles[1] * shape[0], tiles[2] * shape[0])
    g = random_phasors(pixels, sum(tiles))
    solid = (np.random.default_rng(1).random(pixels) < 0.8).astype(np.uint8)
    ratios = np.array(cumulative)[:, None, None]
    got = device_labels(device, g, ratios, solid, shape)
    expected = np.where(solid, reference.symmetric_labels(g, ratios[:, None]), 0)
    tied = ties(g, ratios[:, None])
    assert np.count_nonzero(tied) <= 2
    assert np.array_equal(got[~tied], expected[~tied])


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("cumulative", [[0.5], [0.25], [0.75], [0.001], [0.999], [0.2, 0.7], [0.0, 0.3, 0.3, 1.0]])
def test_cyclic_profile(device: Device, cumulative: list[float], shape: tuple[int, int]) -> None:
    g = random_phasors((2, 2 * shape[0], 3 * shape[0]), 7)
    ratios = np.array(cumulative)[:, None, None]
    got = device_labels(device, g, ratios, np.ones(g.shape, np.uint8), shape, "cyclic")
    expected = reference.cyclic_labels(g, ratios[:, None])
    share = np.angle(g.astype(np.complex128)) / (2 * np.pi) % 1
    # The key goes with the squared sine of the angle from its ends: near those, 4 · 2^-24 of it is √ of that in angle.
    tied = np.any(np.abs(share - ratios[:, None]) < 2e-4, axis=0)
    assert np.count_nonzero(tied) <= 20
    assert np.array_equal(got[~tied], expected[~tied])


@pytest.mark.parametrize(("share", "material"), [(0.0, 1), (0.125, 1), (0.25, 2), (0.5, 2), (0.75, 3), (0.875, 3)])
def test_cyclic_materials_follow_each_other_through_the_whole_turn(device: Device, share: float, material: int) -> None:
    """Quarters of a turn at ratios ¼, ½, ¼; thresholds at exact phases belong to the next material."""
    g = np.full((1, 32, 32), EXACT[round(8 * share)], np.complex64)
    ratios = np.array([0.25, 0.75])[:, None, None]
    assert np.all(device_labels(device, g, ratios, np.ones(g.shape, np.uint8), profile="cyclic") == material)
    assert np.all(reference.cyclic_labels(g, ratios[:, None]) == material)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("seed", [0, 2**40 + 5])
def test_dithered_edges(device: Device, seed: int, shape: tuple[int, int]) -> None:
    g = random_phasors((3, 2 * shape[0], 2 * shape[0]), 8)
    wave, ratios = np.array([0.6, -0.2, 0.1]), np.array([0.2, 0.7])[:, None, None]
    got = device_labels(device, g, ratios, np.ones(g.shape, np.uint8), shape, wave=wave, seed=seed, first_layer=5)
    rows, columns = np.arange(g.shape[1])[:, None], np.arange(g.shape[2])[None, :]
    turned = np.stack([reference.jittered(g[i], columns, rows, 5 + i, wave, seed) for i in range(len(g))])
    expected = reference.symmetric_labels(turned, ratios[:, None])
    share = np.abs(np.angle(turned)) / np.pi
    tied = np.any(np.abs(share - ratios[:, None]) < 2e-6, axis=0)  # float32 turns by the wave's rounding
    assert np.count_nonzero(tied) <= 3
    assert np.array_equal(got[~tied], expected[~tied])
    assert np.any(got != device_labels(device, g, ratios, np.ones(g.shape, np.uint8), shape))


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("count", [1, 63, 257])
@pytest.mark.parametrize("width", [0.25, 0.3, 7.0])
def test_normal_fields(device: Device, width: float, count: int, dimensions: int) -> None:
    """The fields that turn directions, through the module that asks for them, far from the origin too."""
    random = np.random.default_rng(count)
    place = np.array([40.0, -25.0, 0.0]) + random.uniform(-3, 3, (count, 3))
    widths = width * random.uniform(0.5, 2.0, count)
    if dimensions == 2:
        place[:, 2] = 0.0
    got = turn._normal_fields(place, widths, dimensions, 2**33 + 1, DeviceGenerator(device))
    expected = reference.normal_fields(place, widths, dimensions, 2**33 + 1)
    # A distance of up to 2 cells in float32, times the steepest slope of g, summed over some ten points.
    assert np.max(np.abs(got - expected)) < 2e-5


def test_profile_with_a_ratio_of_its_own_at_every_pixel(device: Device) -> None:
    g = random_phasors((2, 64, 96), 4)
    ratio = np.random.default_rng(2).random((1, 64, 96))
    ratio[:, :8], ratio[:, 8:16] = 0.0, 1.0
    got = device_labels(device, g, ratio, np.ones(g.shape, np.uint8))
    tied = ties(g, ratio[:, None])
    assert np.count_nonzero(tied) <= 2
    assert np.array_equal(got[~tied], reference.symmetric_labels(g, ratio[:, None])[~tied])
    assert np.all(got[:, :8] == 2)
    assert np.all(got[:, 8:16] == 1)


# Phases on the axes and diagonals, of which float32 knows the squares exactly; |ϕ|/π = 0, ¼, ½, ¾, 1.
EXACT = np.array([1, 1 + 1j, 1j, -1 + 1j, -1, -1 - 1j, -1j, 1 - 1j], np.complex64)
EXACT_SHARE = np.array([0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25])
SCALES = [1.0, 3e-15, 1e15]  # far from 1, but with squares that float32 still holds


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("ratio", [0.0, 0.001, 0.5, 0.999, 1.0])
def test_intervals_are_half_open_and_0_and_1_are_fills(device: Device, ratio: float, scale: float) -> None:
    """A phase at the threshold belongs to the next material; a fill takes even the phases 0 and π."""
    g = np.resize(EXACT * np.float32(scale), (1, 32, 32))
    expected = np.resize(np.where(ratio > EXACT_SHARE, 1, 2) if ratio < 1 else np.ones(8), g.shape)
    assert np.array_equal(device_labels(device, g, np.full((1, 1, 1), ratio), np.ones(g.shape, np.uint8)), expected)
    assert np.array_equal(reference.symmetric_labels(g, [[[[ratio]]]])[0], expected[0])


def test_a_ratio_next_to_a_fill_is_as_good_as_the_fill(device: Device) -> None:
    """float32 cannot tell 2^-26 from 0, nor 1 - 2^-26 from 1: no pixel of either may be of the other material."""
    g = np.concatenate([random_phasors((1, 32, 32), 5), np.resize(EXACT, (1, 32, 32))], axis=1)
    solid = np.ones(g.shape, np.uint8)
    assert np.all(device_labels(device, g, np.full((1, 1, 1), 2.0**-26), solid) == 2)
    assert np.all(device_labels(device, g, np.full((1, 1, 1), 1 - 2.0**-26), solid) == 1)


def test_where_no_kernel_reaches_the_device_and_the_twin_take_the_same_material(device: Device) -> None:
    g, solid = np.zeros((1, 32, 32), np.complex64), np.ones((1, 32, 32), np.uint8)
    for ratio in (0.0, 0.1, 0.5, 0.9, 1.0):
        ratios = np.full((1, 1, 1), ratio)
        expected = reference.symmetric_labels(g, ratios[:, None])
        assert np.array_equal(device_labels(device, g, ratios, solid), expected)


def test_the_comparison_can_fail(device: Device) -> None:
    """A factor that is off by 1e-5, a NaN, and labels of a ratio that is off by 1e-3 are all noticed."""
    expected = reference.tables(*(np.ones(3),) * 4, pitch_mm=0.1, pixels=32)
    bound = np.full(expected.shape, LIBRARY_ULP)
    assert_close(expected.astype(np.complex64), expected, bound)
    broken = expected.astype(np.complex64)
    broken[1, 1] = np.nan
    for wrong in (expected.astype(np.complex64) + np.complex64(1e-5), broken):
        with pytest.raises(AssertionError):
            assert_close(wrong, expected, bound)
    g = random_phasors((1, 256, 256), 6)
    ratio = np.full((1, 1, 1), 0.3)
    got = device_labels(device, g, ratio + 1e-3, np.ones(g.shape, np.uint8))
    different = got != reference.symmetric_labels(g, ratio[:, None])
    assert 20 < np.count_nonzero(different & ~ties(g, ratio[:, None])) < 150  # 65 536 pixels · 1e-3 = 66 ± 8
