"""Results of a finite-element analysis, read from a file's bytes through meshio, which is never shown another file."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from amslicer.errors import JobError
from amslicer.fields import meshiochild
from amslicer.fields.meshiochild import REPORT
from amslicer.fields.simplices import FLAT, SOLID, optional_library

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

MOST_BYTES = 512 << 20  # read, parsed and cut, some ten times as much memory
LARGEST = 1e100  # no result is so large, and its square is still a number
MOST_CELLS = 20_000_000  # tetrahedra and their search tree then take about 5 GB
MOST_MEMORY, MEMORY_PER_BYTE = 2 << 30, 24  # bytes: packed numbers become some ten times as many, held twice
MOST_SECONDS, SECONDS_PER_MB = 15, 3  # of a processor: text is read at about 1 MB/s
WAITING = 4  # times as long by the clock, for others use the processor, too
# meshio's readers that take results from one file. Others hold none (inp, bdf), or are several files (exodus, ensight).
READERS = {"vtu": "vtu", "vtk": "vtk", "msh": "gmsh", "xdmf": "xdmf", "xmf": "xdmf", "avs": "avsucd"}
CONVERT = "save it as vtu: meshio convert IN OUT.vtu, or ParaView's File > Save Data"
# Cells of fewer dimensions, which say nothing about the inside.
THIN = ("vertex", "line")
KIND = re.compile("(" + "|".join([*FLAT, *SOLID, *THIN]) + ")[0-9]*")

Place = Literal["points", "cells"]


@dataclass(frozen=True)
class Results:
    """A mesh and one array over it, in the file's own unit.

    Attributes:
        points: (P, 3) nodes; those that no cell has are moved to another one.
        blocks: kinds and (C, corners) nodes of the solid cells, or where there is none, of the flat ones.
        values: (P, K) or (all cells, K) values; 0 at nodes that no cell has.
        on: which of the two.
        used: (P,) whether a cell has the node.
    """

    points: Floats
    blocks: list[tuple[str, Integers]]
    values: Floats
    on: Place
    used: NDArray[np.bool_]


def read_results(data: bytes, name: str, array: str, on: Place | None) -> Results:
    """One array of a file of results.

    Args:
        name: the file's name, whose suffix tells its type.
        array: the array's name.
        on: where it is looked for; None: at points and cells.

    Raises:
        JobError: the file cannot be read, is too large, or has no cells; the array is missing or has wrong values.
    """
    mesh = _read(data, name, array)
    points = np.array(mesh.points, np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise JobError(f"the nodes of '{name}' have the shape {points.shape}, not (nodes, 2 or 3)", hint=CONVERT)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    chosen = _choose_cells(mesh, name)
    blocks = []
    for i in chosen:
        kind = _kind(mesh.cells[i].type)
        nodes = np.asarray(mesh.cells[i].data, np.int64)[:, : {**FLAT, **SOLID}[kind]]
        if nodes.min() < 0 or nodes.max() >= len(points):
            raise JobError(
                f"a {kind} of '{name}' has the node {nodes.max() if nodes.min() >= 0 else nodes.min()}, "
                f"and there are {len(points)}",
                hint="the file is damaged: write it again",
            )
        blocks.append((kind, nodes))
    used = np.zeros(len(points), bool)
    for _, nodes in blocks:
        used[nodes] = True
    _check_numbers(points, used, f"the coordinates of '{name}'", "node")
    points[~used] = points[np.argmax(used)]
    where = _find(mesh, name, array, on)
    if where == "points":
        values = np.asarray(mesh.point_data[array])
    else:
        values = np.concatenate([np.asarray(mesh.cell_data[array][i]) for i in chosen])
    if values.dtype.kind not in "iufb":
        raise JobError(f"the array '{array}' of '{name}' holds no real numbers ({values.dtype})", hint=CONVERT)
    count = len(points) if where == "points" else sum(len(nodes) for _, nodes in blocks)
    if len(values) != count:
        raise JobError(f"the array '{array}' of '{name}' has {len(values)} values for {count} {where}", hint=CONVERT)
    values = values.astype(np.float64).reshape(count, -1)
    needed = used if where == "points" else np.ones(count, bool)
    _check_numbers(values, needed, f"the array '{array}' of '{name}'", "node" if where == "points" else "cell")
    values[~needed] = 0.0
    return Results(points, blocks, values, where, used)


def _read(data: bytes, name: str, array: str) -> Any:
    suffix = PurePosixPath(name).suffix.lower().lstrip(".")
    if suffix not in READERS:
        raise JobError(f"results are not read from '.{suffix}' files ('{name}')", hint=f"{CONVERT} ({_suffixes()})")
    if len(data) > MOST_BYTES:
        raise JobError(
            f"'{name}' has {len(data)} bytes; at most {MOST_BYTES} are read as a mesh",
            hint="save a coarser mesh, or only the array that the field uses",
        )
    if READERS[suffix] in ("vtu", "xdmf"):
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            raise JobError(f"'{name}' defines entities of its own, which are not read", hint=CONVERT)
        declared = [int(number) for number in re.findall(rb'NumberOf(?:Cells|Points)\s*=\s*"\s*(\d{1,18})', data)]
        _check_count(max(declared, default=0), name)
    if importlib.util.find_spec("meshio") is None:
        optional_library("meshio", "mesh_data")
    return _read_apart(data, name, suffix, array)


def _read_apart(data: bytes, name: str, suffix: str, array: str) -> Any:
    """What meshio makes of a private copy of the bytes; whatever stops it is a file that cannot be used.

    Returns:
        points, cells, point_data and cell_data as meshio has them; of the arrays, only the one is there.
    """
    with tempfile.TemporaryDirectory(prefix="amslicer-") as made:
        folder = Path(made)
        path = folder / f"results.{suffix}"
        path.write_bytes(data)
        why = _run_reader(path, READERS[suffix], array, len(data))
        report: dict[str, Any] = {"error": why} if why else json.loads((folder / REPORT).read_text(encoding="utf-8"))
        if "refused" in report:
            raise JobError(f"'{name}' {report['refused']}", hint=CONVERT)
        if "error" in report:
            reason = report["error"].splitlines()[0]
            raise JobError(
                f"'{name}' cannot be read as .{suffix}: {reason}",
                hint="write it binary, or as vtu" if suffix == "msh" and b"np.float" in data else CONVERT,
            )
        _check_count(max(report["points"], sum(count for _, count in report["cells"])), name)

        def load(file: str) -> NDArray[Any]:
            return np.asarray(np.load(folder / f"{file}.npy", allow_pickle=False))

        return SimpleNamespace(
            points=load("points"),
            cells=[SimpleNamespace(type=kind, data=load(f"cells_{i}")) for i, (kind, _) in enumerate(report["cells"])],
            point_data={key: load("at_points") if key == array else None for key in report["point_data"]},
            cell_data={
                key: [load(f"at_cells_{i}") for i in range(count)] if key == array else None
                for key, count in report["cell_data"].items()
            },
        )


def _run_reader(path: Path, reader: str, array: str, size: int) -> str | None:
    """Lets meshio read a file in a process of its own; returns what stopped it from outside."""
    seconds = MOST_SECONDS + SECONDS_PER_MB * size // 1_000_000
    command = [sys.executable, "-P", meshiochild.__file__, str(path), reader, array]
    command += [str(MOST_MEMORY + MEMORY_PER_BYTE * size), str(seconds)]
    # One thread: each would take address space, which is what is limited.
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path))),
        "OPENBLAS_NUM_THREADS": "1",
    }
    try:
        done = subprocess.run(
            command, env=environment, cwd=path.parent, timeout=WAITING * seconds, check=False,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no end of it within {WAITING * seconds} s"
    except OSError as error:
        return f"no process could be started for it ({error})"
    if not (path.parent / REPORT).exists():
        said = done.stderr.decode(errors="replace").strip().splitlines()
        return f"it takes too much memory, or more than {seconds} s ({said[-1][:200] if said else done.returncode})"
    return None


def _kind(cell: str) -> str:
    """The kind without its number of nodes; of unknown ones, as it is."""
    found = KIND.fullmatch(cell)
    return found[1] if found else cell


def _choose_cells(mesh: Any, name: str) -> list[int]:
    """Which blocks hold solid cells; where there are none, flat ones."""
    kinds = [_kind(block.type) for block in mesh.cells]
    unknown = sorted({kind for kind in kinds if kind not in (*FLAT, *SOLID, *THIN)})
    if unknown:
        raise JobError(
            f"'{name}' has cells that are not read: {', '.join(unknown)}",
            hint=f"known are {', '.join([*FLAT, *SOLID])} of any order; ParaView's Tetrahedralize makes tetrahedra",
        )
    for known in (SOLID, FLAT):
        found = [i for i, kind in enumerate(kinds) if kind in known and len(mesh.cells[i].data)]
        if found:
            return found
    listed = ", ".join(f"{len(block.data)} {block.type}" for block in mesh.cells) or "none"
    raise JobError(
        f"'{name}' has no cells to interpolate in: {len(mesh.points)} nodes; cells: {listed}",
        hint=f"save it with its cells: {', '.join([*FLAT, *SOLID])} of any order",
    )


def _find(mesh: Any, name: str, array: str, on: Place | None) -> Place:
    held: dict[Place, list[str]] = {"points": list(mesh.point_data), "cells": list(mesh.cell_data)}
    there: list[Place] = [place for place in held if array in held[place] and on in (None, place)]
    if len(there) == 1:
        return there[0]
    listed = "; ".join(f"at {place}: {', '.join(sorted(names)) or 'none'}" for place, names in held.items())
    if there:
        raise JobError(
            f"the array '{array}' of '{name}' is there twice, at points and in cells",
            hint="add on: points or on: cells",
        )
    raise JobError(f"'{name}' has no array '{array}'{f' at {on}' if on else ''}", hint=f"its arrays {listed}")


def _check_count(count: int, name: str) -> None:
    if count > MOST_CELLS:
        raise JobError(
            f"'{name}' has {count} nodes or cells; at most {MOST_CELLS} are read", hint="save a coarser mesh"
        )


def _check_numbers(values: Floats, needed: NDArray[np.bool_], what: str, item: str) -> None:
    good = np.abs(values) <= LARGEST
    wrong = np.flatnonzero(~good.all(axis=1) & needed)
    if len(wrong):
        number = int(wrong[0])
        raise JobError(
            f"{what}: {values[number][~good[number]][0]} at {item} {number} (counted from 0); {len(wrong)} of "
            f"{len(values)} {item}s have no numbers, or none below {LARGEST:g}",
            hint="save only the cells that have values: ParaView's Threshold removes the others",
        )


def _suffixes() -> str:
    return "read are " + ", ".join(f".{suffix}" for suffix in READERS)
