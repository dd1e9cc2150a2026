"""Mesh files: each reader turns a file's bytes into a Soup. A new format is one file here and one line below.

Nothing is repaired, merged or dropped; a file that holds less than it declares is refused.
"""

from __future__ import annotations

from collections.abc import Callable

from amslicer.errors import PartError
from amslicer.meshfiles.glb import read_glb
from amslicer.meshfiles.obj import read_obj
from amslicer.meshfiles.off import read_off
from amslicer.meshfiles.ply import read_ply
from amslicer.meshfiles.soup import EXPORT, Soup
from amslicer.meshfiles.stl import read_stl
from amslicer.meshfiles.threemf import read_3mf

# File name suffix -> reader. A reader may raise whatever it trips over: read_soup makes a PartError of it.
READERS: dict[str, Callable[[bytes], Soup]] = {
    "stl": read_stl,
    "obj": read_obj,
    "ply": read_ply,
    "off": read_off,
    "glb": read_glb,
    "3mf": read_3mf,
}


def read_soup(data: bytes, suffix: str) -> Soup:
    """What a file's bytes hold, read as the format of a suffix in READERS.

    Raises:
        PartError: the bytes are not such a file, or it is damaged, unsafe or needs what is not implemented.
    """
    try:
        return READERS[suffix](data)
    except PartError:
        raise
    except Exception as error:
        raise PartError(f"cannot be read as {suffix} ({type(error).__name__}: {error})", hint=EXPORT) from error


__all__ = ["READERS", "Soup", "read_soup"]
