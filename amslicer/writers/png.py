"""One 1-bit PNG per material and layer: <material>/00000.png, white = deposit, pixel size in pHYs."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from amslicer.grid import MM_PER_INCH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.layer import Layer

# zlib levels. Thin stripes deflate to about the same size at every level; 1 is several times faster than 6.
LEVELS = {"fast": 1, "small": 9}


def png_files(layer: Layer, pitch_mm: tuple[float, float], compression: str) -> list[tuple[str, str, bytes]]:
    """The layer's files: (path in the stack, material, content), in the order of the materials."""
    return [
        (
            layer_path(name, layer.index),
            name,
            encode_png(layer.labels == m + 1, pitch_mm, LEVELS[compression]),
        )
        for m, name in enumerate(layer.materials)
    ]


def layer_path(material: str, index: int) -> str:
    """Where a material's bitmap of a layer is, relative to the stack."""
    return f"{material}/{index:05d}.png"


def encode_png(deposit: NDArray[np.bool_], pitch_mm: tuple[float, float], level: int) -> bytes:
    """A 1-bit PNG of (H, W) booleans with its pixel size."""
    from PIL import Image

    height, width = deposit.shape
    picture = Image.frombytes("1", (width, height), np.packbits(deposit, axis=1).tobytes())
    stream = io.BytesIO()
    dpi = (MM_PER_INCH / pitch_mm[0], MM_PER_INCH / pitch_mm[1])
    picture.save(stream, "PNG", dpi=dpi, compress_level=level)
    return stream.getvalue()
