"""One 1-bit PNG per material and layer: <material>/00000.png, white = deposit, pixel size in pHYs."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import deflate
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.layer import Bitmaps

# libdeflate's levels; without the interpreter's lock.
LEVELS = {"fast": 1, "small": 9}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
MM_PER_M = 1000.0


def png_files(bitmaps: Bitmaps, pitch_mm: tuple[float, float], compression: str) -> list[tuple[str, str, bytes]]:
    """The layer's files: (path in the stack, material, content), in the order of the materials."""
    return [
        (layer_path(name, bitmaps.index), name, encode_packed(rows, bitmaps.width_px, pitch_mm, compression))
        for name, rows in zip(bitmaps.materials, bitmaps.rows, strict=True)
    ]


def layer_path(material: str, index: int) -> str:
    """Where a material's bitmap of a layer is, relative to the stack."""
    return f"{material}/{index:05d}.png"


def encode_png(deposit: NDArray[np.bool_], pitch_mm: tuple[float, float], compression: str = "fast") -> bytes:
    """A 1-bit grey PNG of (H, W) booleans with its pixel size."""
    return encode_packed(np.packbits(deposit, axis=1), deposit.shape[1], pitch_mm, compression)


def encode_packed(packed: NDArray[np.uint8], width: int, pitch_mm: tuple[float, float], compression: str) -> bytes:
    """Rows are deflated unfiltered, which is what 1-bit pictures deflate best as (PNG specification, 12.7).

    Pillow takes several times as long to get there (`make bench` prints both).
    """
    height = len(packed)
    rows = np.zeros((height, 1 + packed.shape[1]), np.uint8)  # each row starts with its filter: 0, none
    rows[:, 1:] = packed
    per_metre = (round(MM_PER_M / pitch) for pitch in pitch_mm)
    return b"".join(
        (
            SIGNATURE,
            _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)),
            _chunk(b"pHYs", struct.pack(">IIB", *per_metre, 1)),
            _chunk(b"IDAT", bytes(deflate.zlib_compress(rows.tobytes(), LEVELS[compression]))),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", deflate.crc32(kind + data))
