"""Reads a part's mesh and refuses what does not bound a solid.

The coordinates stay as the file stores them, but for rounding noise far below float32's (SNAP), and a mesh
that is inside out as a whole is turned over. Nothing is repaired.
"""

from __future__ import annotations

import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles import READERS, Soup, read_soup
from amslicer.surface import Rim, check_closed, connect, must_turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
"""Length of each unit in mm, by definition."""
PLAUSIBLE_MM = (2.0, 2000.0)
"""Largest sides of printed parts: outside, the unit was probably mistaken."""
MAX_SIZE_MM = 1e7
"""10 km: a corrupt coordinate more likely than a part."""
MAX_STEP_MM = 1e-4
"""Coarsest step between coordinates: a hundredth of a fine printer's pixel."""
MAX_FILE_BYTES = 2 << 30
"""40 million triangles of binary STL: about what fits in a desktop's memory while it is checked."""
SNAP = 1e-12
"""Coordinates closer than this times the size are one: CAD writes 0 and -2.7e-16 for the same corner."""


@dataclass(frozen=True)
class Mesh:
    """An outward-oriented triangle mesh in mm, relative to its bounding box minimum; closed, unless it has a rim."""

    file: str  # file name without folder
    sha256: str  # of the file's bytes
    vertices: Floats  # (V, 3) mm, from minimum_mm; those that no triangle uses are left out
    triangles: Ints  # (T, 3), counter-clockwise seen from outside
    minimum_mm: Floats  # (3,) bounding box minimum in the file's frame
    volume_mm3: float  # signed volume, > 0; overlaps count twice
    turned: bool  # the whole mesh was inside out
    notes: tuple[str, ...]  # what to tell the user
    rim: Rim | None = None  # of its holes
    unit_mm: float = 1.0  # length of the file's unit
    body: Ints | None = None  # (T,) number of the body (connected surface) that each triangle belongs to
    object_names: tuple[str, ...] = ()  # of the file's named objects, once each
    object_of: Ints | None = None  # (T,) number of each triangle's object in object_names

    @property
    def size_mm(self) -> Floats:
        """(3,) side lengths of the bounding box."""
        return np.asarray(self.vertices.max(axis=0), dtype=np.float64)


def read_mesh(path: str | os.PathLike[str], units: str | None = None, *, allow_open: bool = False) -> Mesh:
    """The solid in a file of one of the READERS' types; units None is the file's own (3mf), or mm.

    Args:
        allow_open: take a mesh with holes too.

    Raises:
        PartError: the file cannot be read, or its mesh does not bound a solid.
    """
    path = Path(path)
    try:
        if units is not None and units not in UNIT_MM:
            raise PartError(f"unknown unit {units!r}", hint=f"use one of {', '.join(UNIT_MM)}")
        data = _read_bytes(path)
        soup = read_soup(data, _suffix(path))
        unit_mm = soup.unit_mm if units is None else UNIT_MM[units]
        return _complete_solid(soup, path.name, hashlib.sha256(data).hexdigest(), unit_mm, allow_open)
    except PartError as error:
        raise PartError(f"{path.name}: {error.message}", hint=error.hint) from error


def _read_bytes(path: Path) -> bytes:
    try:
        found = path.stat()
        kind = found.st_mode
        if stat.S_ISDIR(kind):
            raise PartError("is a folder, not a mesh file", hint="name the file inside it")
        if not stat.S_ISREG(kind):
            raise PartError("is not a regular file", hint="copy the mesh to a file first")
        if _suffix(path) not in READERS:
            raise PartError(f"unsupported file type '{path.suffix}'", hint=f"use one of {', '.join(READERS)}")
        if found.st_size > MAX_FILE_BYTES:
            raise PartError(
                f"the file has {found.st_size} bytes; at most {MAX_FILE_BYTES} are read",
                hint="export it with fewer triangles, or as binary STL",
            )
        with path.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES)
    except FileNotFoundError:
        raise PartError(f"no such file ({path})", hint="check the path of the part") from None
    except (OSError, ValueError) as error:
        raise PartError(f"cannot be opened ({error})", hint="check the path and its permissions") from error
    if not data:
        raise PartError("the file is empty (0 bytes)", hint="copy or export it again")
    return data


def _suffix(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def _complete_solid(soup: Soup, name: str, sha256: str, unit_mm: float, allow_open: bool) -> Mesh:
    """The solid of a soup that lacks nothing; of one that does, its own faults are named as well."""
    if not soup.missing:
        return _solid(soup, name, sha256, unit_mm, allow_open)
    needs = f"needs {soup.missing} (not implemented): its mesh may only stand in for the part"
    try:
        _solid(soup, name, sha256, unit_mm, allow_open)
    except PartError as error:
        raise PartError(f"{error.message}; it also {needs}", hint=error.hint) from error
    raise PartError(needs, hint="export the part as a plain mesh (3MF core or STL)")


def _solid(soup: Soup, name: str, sha256: str, unit_mm: float, allow_open: bool) -> Mesh:
    soup.check()
    used, corners = np.unique(soup.triangles, return_inverse=True)
    stored, triangles = soup.vertices[used], np.asarray(corners.reshape(-1, 3), dtype=np.int64)
    _check_scale(stored, unit_mm)
    minimum = stored.min(axis=0)
    # Differences first: moving the file's mesh changes no bit of them. Adding 0 makes -0.0 a plain 0.
    vertices = _without_noise((stored - minimum) * unit_mm + 0.0)
    surface = connect(vertices, triangles, minimum * unit_mm)
    check_closed(surface, allow_open=allow_open)
    turned = must_turn(surface)
    notes = ["the whole mesh was inside out and has been turned over"] if turned else []
    return Mesh(
        name,
        sha256,
        vertices,
        np.ascontiguousarray(triangles[:, ::-1]) if turned else triangles,
        surface.minimum_mm,
        abs(float(surface.volumes.sum())),
        turned,
        (*notes, *_unit_notes(float(vertices.max()), unit_mm)),
        surface.rim if len(surface.rim.edges) else None,
        unit_mm,
        surface.body,
        soup.names,
        soup.object_of,
    )


def _check_scale(stored: Floats, unit_mm: float) -> None:
    with np.errstate(over="ignore"):
        farthest = float(np.abs(stored).max() * unit_mm)
        size = float(np.ptp(stored, axis=0).max() * unit_mm)
    if not size <= MAX_SIZE_MM:
        raise PartError(
            f"largest side {size:.6g} mm, more than {MAX_SIZE_MM:.0e} mm",
            hint="a damaged coordinate or the wrong --units: check the file",
        )
    step = float(np.spacing(farthest))
    if not step <= MAX_STEP_MM:
        raise PartError(
            f"{farthest:.6g} mm from the origin, where coordinates have steps of {step:.1g} mm",
            hint="move the part to the origin before exporting it",
        )


def _without_noise(vertices: Floats) -> Floats:
    """Vertices whose coordinates within SNAP of each other take the lowest one's value."""
    tolerance = SNAP * float(vertices.max())
    for axis in range(3):
        values = np.unique(vertices[:, axis])
        steps = np.diff(values)
        if (steps <= tolerance).any():
            groups = np.concatenate([[0], np.cumsum(steps > tolerance)])
            lowest = values[np.searchsorted(groups, groups)]
            vertices[:, axis] = lowest[np.searchsorted(values, vertices[:, axis])]
    return vertices


def _unit_notes(largest_mm: float, unit_mm: float) -> list[str]:
    low, high = PLAUSIBLE_MM
    if low <= largest_mm <= high:
        return []
    sizes = {unit: largest_mm / unit_mm * length for unit, length in UNIT_MM.items()}
    fitting = [f"--units {unit} ({size:.4g} mm)" for unit, size in sizes.items() if low <= size <= high]
    advice = f"; perhaps {' or '.join(fitting)}" if fitting else "; check --units and --scale"
    return [f"the largest side is {largest_mm:.4g} mm{advice}"]
