"""Volume files: each reader turns a file's bytes into a Volume. A new type is one file here and one line below.

Nothing is converted: samples stay in the file's number type, and where it holds them plainly, in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import PurePath

from amslicer.errors import JobError
from amslicer.volumefiles.npy import read_npy
from amslicer.volumefiles.npz import read_npz
from amslicer.volumefiles.nrrd import read_nrrd
from amslicer.volumefiles.tiff import read_tiff
from amslicer.volumefiles.volume import Volume, refusal
from amslicer.volumefiles.vti import read_vti

# File name suffix -> reader of (bytes, name for messages, key of the array or None).
READERS: dict[str, Callable[[memoryview, str, str | None], Volume]] = {
    "npy": read_npy,
    "npz": read_npz,
    "nrrd": read_nrrd,
    "nhdr": read_nrrd,
    "tif": read_tiff,
    "tiff": read_tiff,
    "vti": read_vti,
}


def read_volume(data: memoryview, name: str, key: str | None = None) -> Volume:
    """What a file's bytes hold, read as the type of its suffix and of no other.

    Args:
        name: path as written in the job file.
        key: the array's name in files that hold several.

    Raises:
        JobError: the type is none of READERS, or the file is not of it, damaged, unsafe or too large.
    """
    suffix = PurePath(name).suffix.lower().removeprefix(".")
    if suffix not in READERS:
        raise refusal(name, f"ends in '.{suffix}'; " + ", ".join(f".{known}" for known in READERS) + " are read")
    try:
        volume = READERS[suffix](data, name, key)
    except JobError:
        raise
    except Exception as error:  # what a damaged file makes a reader trip over
        raise refusal(name, f"cannot be read as {suffix} ({type(error).__name__}: {str(error)[:200]})") from error
    return replace(volume, array=volume.array[..., 0]) if volume.channels == 1 else volume


__all__ = ["READERS", "Volume", "read_volume"]
