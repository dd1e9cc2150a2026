"""Output formats: each turns bitmaps into files. `WRITERS` is the closed list; a new format is one file, one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from amslicer.writers.png import png_files

if TYPE_CHECKING:
    from amslicer.layer import Bitmaps

# A writer encodes one layer: (bitmaps, pitch_mm, compression) -> [(path in the stack, material, bytes)].
# It keeps no state and may run in any thread.
Writer = Callable[["Bitmaps", tuple[float, float], str], list[tuple[str, str, bytes]]]

WRITERS: dict[str, Writer] = {
    "png": png_files,
}

__all__ = ["WRITERS", "Writer"]
