"""One 1-bit PNG per material and layer: <material>/00000.png, white = deposit, pixel size in pHYs."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from isal import isal_zlib

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.layer import Layer

# Both without the interpreter's lock. ISA-L's level 1 is four times as fast as zlib's, and a tenth smaller; zlib's 9 is
# another fifth smaller, and a hundred times slower.
DEFLATE: dict[str, Callable[[bytes], bytes]] = {
    "fast": lambda rows: isal_zlib.compress(rows, 1),
    "small": lambda rows: zlib.compress(rows, 9),
}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
MM_PER_M = 1000.0


def png_files(layer: Layer, pitch_mm: tuple[float, float], compression: str) -> list[tuple[str, str, bytes]]:
    """The layer's files: (path in the stack, material, content), in the order of the materials."""
    return [
        (layer_path(name, layer.index), name, encode_png(layer.labels == m, pitch_mm, compression))
        for m, name in enumerate(layer.materials, 1)
    ]


def layer_path(material: str, index: int) -> str:
    """Where a material's bitmap of a layer is, relative to the stack."""
    return f"{material}/{index:05d}.png"


def encode_png(deposit: NDArray[np.bool_], pitch_mm: tuple[float, float], compression: str = "fast") -> bytes:
    """A 1-bit grey PNG of (H, W) booleans with its pixel size.

    Rows are packed and deflated unfiltered, which is what 1-bit pictures deflate best as (PNG specification,
    12.7), in a fraction of the time that Pillow takes to get there (`make bench` prints both).
    """
    height, width = deposit.shape
    rows = np.zeros((height, 1 + -(-width // 8)), np.uint8)  # each row starts with its filter: 0, none
    rows[:, 1:] = np.packbits(deposit, axis=1)
    per_metre = (round(MM_PER_M / pitch) for pitch in pitch_mm)
    return b"".join(
        (
            SIGNATURE,
            _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)),
            _chunk(b"pHYs", struct.pack(">IIB", *per_metre, 1)),
            _chunk(b"IDAT", DEFLATE[compression](rows.tobytes())),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", isal_zlib.crc32(kind + data))
