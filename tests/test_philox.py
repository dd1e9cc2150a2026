"""The hash behind the impulses: known answers, and the device against its twin, bit for bit."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from amslicer import block
from amslicer.device import Device
from amslicer.noise import kernels
from amslicer.reference import CHOICES, EDGES, TURN_PLACES, TURN_WEIGHTS, cell_words, impulses_of, philox4x32
from amslicer.resources import resource_folder

# Philox-4x32-10 in kat_vectors of the Random123 distribution (D. E. Shaw Research): counter, key, answer.
KNOWN = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]
SEEDS = [0, 1, 2**32, 2**64 - 1]
# One work-item per impulse, in groups of 64: one, a prime, and either side of a power of two.
COUNTS = [1, 7, 63, 65, 127, 1023, 1025]


def words_of(text: str) -> NDArray[np.uint32]:
    return np.array([int(word, 16) for word in text.split()], np.uint32)


def draw(
    device: Device, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int = 0
) -> NDArray[np.uint32]:
    """(z, y, x, per_cell, 4) words of a box of cells, from cl/impulses.cl; a guard behind them must stay."""
    words = np.full((np.prod(count) * per_cell + 1, 4), 0xDEADBEEF, np.uint32)
    buffer = cl.Buffer(device.context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=words)
    device.run(
        device.kernel("impulses"), len(words) - 1, buffer, np.array([*first, 0], np.int32),
        np.array([*count, per_cell], np.uint32), np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint32),
        np.uint32(number),
    )  # fmt: skip
    device.read(buffer, words)
    assert np.all(words[-1] == 0xDEADBEEF)
    return words[:-1].reshape(*count[::-1], per_cell, 4)


def twin(
    first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int, number: int = 0
) -> NDArray[np.uint32]:
    z, y, x = np.meshgrid(*(first[a] + np.arange(count[a]) for a in (2, 1, 0)), indexing="ij")
    return cell_words(np.stack([x, y, z], axis=-1), per_cell, seed, number)


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_twin_gives_the_known_answers(counter: str, key: str, answer: str) -> None:
    assert np.array_equal(philox4x32(words_of(counter), words_of(key)), words_of(answer))


def test_twin_takes_many_counters_and_keys_at_once() -> None:
    counters, keys, answers = (np.stack([words_of(row[i]) for row in KNOWN]) for i in range(3))
    assert np.array_equal(philox4x32(counters, keys), answers)


def test_device_hash_gives_the_known_answers(device: Device) -> None:
    source = (
        (resource_folder("cl") / "hash.h").read_text(encoding="utf-8")
        + """
        kernel void hash(global uint4 *words, global const uint4 *counters, global const uint2 *keys)
        {
            const size_t i = get_global_id(0);
            words[i] = philox4x32(counters[i], keys[i]);
        }"""
    )
    counters, keys, answers = (np.stack([words_of(row[i]) for row in KNOWN]) for i in range(3))
    out = np.zeros_like(answers)
    buffer = device.empty(out.nbytes)
    program = cl.Program(device.context, source).build(options=["-cl-std=CL1.2"])
    cl.Kernel(program, "hash")(device.queue, (len(KNOWN),), None, buffer, device.buffer(counters), device.buffer(keys))
    device.read(buffer, out)
    assert np.array_equal(out, answers)


def test_first_impulse_of_the_first_cell_is_a_known_answer(device: Device) -> None:
    """Counter (0, 0, 0, 0), key 0; and the key of all ones with cell (-1, -1, -1) is the seed 2^64 - 1."""
    assert np.array_equal(draw(device, (0, 0, 0), (1, 1, 1), 1, 0)[0, 0, 0, 0], words_of(KNOWN[0][2]))
    ones = np.array([0xFFFFFFFF] * 3 + [0], np.uint32)
    expected = philox4x32(ones, np.array([0xFFFFFFFF] * 2, np.uint32))
    assert np.array_equal(draw(device, (-1, -1, -1), (1, 1, 1), 1, 2**64 - 1)[0, 0, 0, 0], expected)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("count", COUNTS)
def test_device_and_twin_agree_on_a_row_of_cells(device: Device, count: int, seed: int) -> None:
    box = (-count // 2, -3, 5), (count, 1, 1), 1, seed
    assert np.array_equal(draw(device, *box), twin(*box))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("first", "count", "per_cell"),
    [
        ((-2, -3, -1), (5, 4, 3), 4),
        ((-7, 11, -13), (1, 17, 2), 5),
        ((2**31 - 4, -(2**31), 0), (4, 3, 1), 2),
    ],
)
def test_device_and_twin_agree_on_a_box_of_cells(
    device: Device, first: tuple[int, int, int], count: tuple[int, int, int], per_cell: int, seed: int
) -> None:
    assert np.array_equal(draw(device, first, count, per_cell, seed), twin(first, count, per_cell, seed))


@pytest.mark.parametrize("number", [CHOICES, TURN_PLACES + 256 * 255, TURN_WEIGHTS + 256 * 3])
def test_device_and_twin_agree_on_other_uses_of_a_cell(device: Device, number: int) -> None:
    box = (-2, 3, -1), (3, 2, 2), 4, 2**40 + 7
    drawn = draw(device, *box, number)
    assert np.array_equal(drawn, twin(*box, number))
    assert not np.any(drawn == draw(device, *box))  # 192 words, each equal with probability 2^-32


def test_no_two_uses_share_a_counter() -> None:
    """Up to 100 impulses and choices, 4 points of 256 levels, and the edges: all fourth words differ."""
    levels = 256 * np.arange(256)[:, None] + np.arange(4)
    uses = [np.arange(100), CHOICES + np.arange(100), TURN_PLACES + levels, TURN_WEIGHTS + levels, [EDGES]]
    numbers = np.concatenate([np.ravel(use) for use in uses])
    assert len(np.unique(numbers)) == len(numbers)
    assert numbers.max() < 2**32
    assert (kernels.IMPULSES, kernels.CHOICE, kernels.TURN_PLACES, kernels.TURN_WEIGHTS, block.EDGES) == (
        0, CHOICES, TURN_PLACES, TURN_WEIGHTS, EDGES,
    )  # fmt: skip


def test_a_cell_does_not_depend_on_the_box_it_is_drawn_in(device: Device) -> None:
    large = draw(device, (-5, -5, -5), (9, 9, 9), 3, 42)
    small = draw(device, (-1, 0, -2), (2, 1, 3), 3, 42)
    assert np.array_equal(large[3:6, 5:6, 4:6], small)


def test_no_two_counters_and_no_two_seeds_share_their_words() -> None:
    """Cells, impulses and both halves of the seed each change everything: no sums, no truncation."""
    drawn = [twin((-2, -2, -2), (4, 4, 4), 4, seed).reshape(-1, 4) for seed in (*SEEDS, 2**32 - 1, 2**63)]
    words = np.concatenate(drawn)
    assert len(np.unique(words, axis=0)) == len(words)


def test_a_comparison_of_words_can_fail(device: Device) -> None:
    """Neither an offset cell nor the other half of the seed goes unnoticed."""
    box = (-2, -3, -1), (5, 4, 3), 4
    drawn = draw(device, *box, 1)
    for wrong in (twin(*box, 2**32), twin((-2, -3, 0), *box[1:], 1), twin((-3, -2, -1), *box[1:], 1)):
        assert np.count_nonzero(drawn == wrong) <= 2  # 960 words, each equal with probability 2^-32


def test_impulses_lie_in_their_cells() -> None:
    """Word 2^32 - 1 is still inside: u < 1; in 2D the third word is drawn and not used."""
    cells = np.array([[0, 0, 0], [-1, 2, 0], [7, -9, 0]])
    for dimensions in (2, 3):
        place, phase = impulses_of(cells, side_mm=2.5, per_cell=100, dimensions=dimensions, seed=3)
        share = place / 2.5 - cells[:, None, :]
        assert place.shape == (3, 100, 3)
        assert np.all((share >= -1e-12) & (share < 1))
        assert np.all((phase >= 0) & (phase < 2 * np.pi))
        assert np.all(place[..., 2] == 0) == (dimensions == 2)
