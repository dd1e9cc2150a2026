"""Random words for what a noise draws once, on the host: Philox-4x32-10 (Salmon et al. 2011), as cl/hash.h."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ROUNDS = 10
MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
STEPS = 0x9E3779B9, 0xBB67AE85
MASK, BITS = np.uint64(0xFFFFFFFF), np.uint64(32)


def words(*counter: ArrayLike, seed: int) -> NDArray[np.uint32]:
    """(..., 4) words of counters of four integers, which broadcast; negative ones in two's complement.

    Args:
        seed: 0 … 2^64 - 1, the key.
    """
    a, b, c, d = (np.asarray(word, np.int64).astype(np.uint64) & MASK for word in np.broadcast_arrays(*counter))
    key = [seed & 0xFFFFFFFF, seed >> 32]
    for _ in range(ROUNDS):
        left, right = a * MULTIPLIERS[0], c * MULTIPLIERS[1]
        a, b, c, d = (
            (right >> BITS) ^ b ^ np.uint64(key[0]),
            right & MASK,
            (left >> BITS) ^ d ^ np.uint64(key[1]),
            left & MASK,
        )
        key = [(word + step) & 0xFFFFFFFF for word, step in zip(key, STEPS, strict=True)]
    return np.stack([a, b, c, d], axis=-1).astype(np.uint32)
