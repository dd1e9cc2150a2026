"""meshio in a process of its own: a few bytes of a damaged or hostile file may ask it for any memory, or for ever.

Run as a script: `python -P meshiochild.py FILE READER ARRAY BYTES SECONDS`. It imports nothing of this package, starts
in half a second, and leaves in the file's folder report.json and the arrays that it names.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

REPORT = "report.json"
NO_TEXT = "S1"  # stands for arrays of Python objects, which are not passed on


class Refused(Exception):
    """A file that is not read, in our own words."""


def read_beside(path: Path, reader: str, array: str) -> None:
    """Writes what a file holds into its folder: report.json, points.npy, cells_I.npy, at_points.npy, at_cells_I.npy.

    Args:
        reader: the name of meshio's module.
        array: of all arrays, only this one is written.
    """
    folder = path.parent
    report: dict[str, Any]
    try:
        mesh = _read(path, reader)
        np.save(folder / "points.npy", _plain(mesh.points))
        for i, block in enumerate(mesh.cells):
            np.save(folder / f"cells_{i}.npy", _plain(block.data))
        if array in mesh.point_data:
            np.save(folder / "at_points.npy", _plain(mesh.point_data[array]))
        for i, values in enumerate(mesh.cell_data.get(array, ())):
            np.save(folder / f"at_cells_{i}.npy", _plain(values))
        report = {
            "points": len(mesh.points),
            "cells": [(block.type, len(block.data)) for block in mesh.cells],
            "point_data": list(mesh.point_data),
            "cell_data": {name: len(values) for name, values in mesh.cell_data.items()},
        }
    except Refused as error:
        report = {"refused": str(error)}
    except Exception as error:  # meshio's readers raise whatever their parsing meets
        reason = str(error).strip() or type(error).__name__
        report = {"error": "its numbers take too much memory" if isinstance(error, MemoryError) else reason}
    (folder / REPORT).write_text(json.dumps(report), encoding="utf-8")


def _read(path: Path, reader: str) -> Any:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # NumPy only warns where text ends before the numbers do.
        warnings.filterwarnings("error", message="string or file could not be read to its end")
        read = _read_xdmf if reader == "xdmf" else importlib.import_module(f"meshio.{reader}").read
        return read(str(path))


def _read_xdmf(path: str) -> Any:
    """meshio's reader of XDMF, held to the numbers within the file: it would open any file that these may name."""
    formats = importlib.import_module("meshio.xdmf.common").xdmf_to_numpy_type

    class Inline(importlib.import_module("meshio.xdmf.main").XdmfReader):  # type: ignore[misc]
        def _read_data_item(self, item: Any, root: Any = None) -> Any:
            form = item.get("Format", "XML")
            if form != "XML" or item.get("Reference"):
                raise Refused(
                    f"keeps its numbers in another place ({form}: {(item.text or '').strip()[:60]!r}), and only files "
                    "that a job names are read"
                )
            kind = formats[item.get("DataType") or item.get("NumberType") or "Float", item.get("Precision", "4")]
            shape = [int(side) for side in item.get("Dimensions").split()]
            return np.fromstring(item.text or "", dtype=kind, sep=" ").reshape(shape)

    return Inline(path).read()


def _plain(values: Any) -> Any:
    try:
        array = np.asarray(values)
    except ValueError:  # rows of several lengths
        array = np.zeros(len(values), object)
    return array.astype(NO_TEXT) if array.dtype.hasobject and array.size == 0 else (
        np.zeros(len(array), NO_TEXT) if array.dtype.hasobject else array
    )  # fmt: skip


def _limit(size: int, seconds: int) -> None:
    """Memory, files and processor time of this process, where the system has such limits."""
    try:
        import resource
    except ImportError:  # Windows: the parent's clock is left
        return
    for kind, most in ((resource.RLIMIT_AS, size), (resource.RLIMIT_FSIZE, size), (resource.RLIMIT_CPU, seconds)):
        with contextlib.suppress(ValueError, OSError):  # a lower limit is there already, or macOS knows none
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))


if __name__ == "__main__":
    _limit(int(sys.argv[4]), int(sys.argv[5]))
    read_beside(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
