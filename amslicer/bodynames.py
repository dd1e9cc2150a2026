"""What a part's bodies are called, and which triangles each has.

Of a file with named objects (3MF, OBJ, GLB) a body is all that has one name; each must be a solid by itself. An OBJ
file's groups count as objects where it names none and all of them are solids. Of others each outward surface is a body,
with the cavities inside it, called "1", "2", … in the order of their first triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from amslicer.errors import JobError
from amslicer.surface import edge_uses, winding_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.mesh import Mesh

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

MOST_BODIES = 32_767  # what labels of two bytes can say
LISTED = 12  # names in a message
CAVITY_SAMPLES = 4  # vertices of a cavity that are looked at: one may touch the surface around it


class Body(NamedTuple):
    """One row of a table of bodies."""

    name: str
    triangles: int
    bbox_mm: Floats  # (2, 3) lowest and highest corner, file coordinates
    volume_mm3: float  # signed; cavities are taken away, overlaps within the body count twice


@dataclass(frozen=True, eq=False)
class Bodies:
    """A part's bodies.

    Attributes:
        names: once each.
        of_triangle: (T,) number of each triangle's body.
    """

    names: tuple[str, ...]
    of_triangle: Ints

    def numbers(self, wanted: Sequence[str], key: str) -> list[int]:
        """The numbers of bodies.

        Args:
            key: where the names stand in the job file, for the message.

        Raises:
            JobError: the part has no body of a name.
        """
        for name in wanted:
            if name not in self.names:
                raise JobError(f"{key}: the part has no body '{name}'", hint=f"it has {listed(self.names)}")
        return [self.names.index(name) for name in wanted]


def listed(names: Sequence[str]) -> str:
    """Names for a message, the first few of many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(f"'{name}'" for name in names[:LISTED]) + more


def find_bodies(mesh: Mesh) -> Bodies:
    """The bodies of a part.

    Raises:
        JobError: there are more than can be numbered, or a named object is no solid by itself.
    """
    if mesh.object_of is not None:
        unclosed = unclosed_pieces(mesh.vertices, mesh.triangles, mesh.object_of)
        if unclosed.size:
            names = listed([mesh.object_names[number] for number in unclosed])
            raise JobError(
                f"{mesh.file}: {names} {'is an object' if unclosed.size == 1 else 'are objects'} of the file, but only "
                "part of a solid's surface: no body by itself",
                hint="close each object before exporting it, or join those that bound one solid",
            )
        found = Bodies(mesh.object_names, mesh.object_of)
    else:
        of_triangle = _with_cavities(mesh)
        found = Bodies(tuple(str(n) for n in range(1, int(of_triangle.max()) + 2)), of_triangle)
    if len(found.names) > MOST_BODIES:
        raise JobError(
            f"the part has {len(found.names)} bodies; at most {MOST_BODIES} are told apart",
            hint="join those that belong together, or leave out what speaks of bodies",
        )
    return found


def unclosed_pieces(vertices: Floats, triangles: Ints, piece_of: Ints) -> Ints:
    """Numbers of the pieces of a mesh that have an edge which is closed in the whole, but not by the piece itself.

    Args:
        piece_of: (T,) number of each triangle's piece.
    """
    if not len(triangles):
        return np.zeros(0, np.int64)
    uses = edge_uses(vertices, triangles)
    whole = np.bincount(uses.edge, uses.sign) == 0
    piece = piece_of[uses.triangle]
    count = int(piece_of.max()) + 1
    of_piece, which = np.unique(uses.edge * count + piece, return_inverse=True)
    open_ = np.bincount(which.reshape(-1), uses.sign) != 0
    return np.asarray(np.unique((of_piece % count)[open_ & whole[of_piece // count]]), np.int64)


def body_table(mesh: Mesh) -> list[Body]:
    """Name, triangles, place and volume of each body."""
    bodies, corners = find_bodies(mesh), mesh.vertices[mesh.triangles]
    volumes = np.bincount(bodies.of_triangle, _volumes(corners), len(bodies.names))
    counts = np.bincount(bodies.of_triangle, minlength=len(bodies.names))
    low, high = np.full((len(counts), 3), np.inf), np.full((len(counts), 3), -np.inf)
    np.minimum.at(low, bodies.of_triangle, corners.min(axis=1))
    np.maximum.at(high, bodies.of_triangle, corners.max(axis=1))
    return [
        Body(name, int(counts[i]), np.stack([low[i], high[i]]) + mesh.minimum_mm, float(volumes[i]))
        for i, name in enumerate(bodies.names)
    ]


def _volumes(corners: Floats) -> Floats:
    """(T,) signed volumes of the tetrahedra from (T, 3, 3) triangles to the origin."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)


def _with_cavities(mesh: Mesh) -> Ints:
    """(T,) number of the outward surface that each triangle belongs to, or lies in."""
    if mesh.body is None:
        return np.zeros(len(mesh.triangles), np.int64)
    surface, corners = _surfaces(mesh, mesh.body), mesh.vertices[mesh.triangles]
    count = int(surface.max()) + 1
    volumes = np.bincount(surface, _volumes(corners), count)
    outward = np.flatnonzero(volumes > 0)
    owner = np.zeros(count, np.int64)
    owner[outward] = np.arange(len(outward))
    inward = np.flatnonzero(volumes <= 0)
    if len(inward) and len(outward) > 1:
        order = np.argsort(surface, kind="stable")
        bounds = np.searchsorted(surface[order], np.arange(count + 1))
        own = [corners[order[start:end]] for start, end in pairwise(bounds)]
        low, high = (np.array([f(f(c, axis=1), axis=0) for c in own]) for f in (np.min, np.max))
        smallest_first = outward[np.argsort(volumes[outward], kind="stable")]
        for cavity in inward:
            boxed = (low[smallest_first] <= low[cavity]) & (high[smallest_first] >= high[cavity])
            around = smallest_first[boxed.all(axis=1)]
            places = own[cavity][:: max(1, len(own[cavity]) // CAVITY_SAMPLES), 0]
            # The innermost surface around it; a box alone tells where only one fits.
            inside = (s for s in around if len(around) == 1 or winding_numbers(places, own[s]).mean() > 0.5)
            owner[cavity] = owner[next(inside, around[0] if len(around) else outward[0])]
    return np.asarray(owner[surface], dtype=np.int64)


def _surfaces(mesh: Mesh, connected: Ints) -> Ints:
    """(T,) number of the closed surface of each triangle, in the order of their first ones.

    Solids that share a whole face are connected there. Files list one solid after the other, nearly always: where all
    triangles up to one are closed by themselves, those behind it are others.
    """
    uses = edge_uses(mesh.vertices, mesh.triangles)
    first = np.flatnonzero(np.diff(uses.edge, prepend=-1))  # use of each edge
    total = np.cumsum(uses.sign)
    before = np.concatenate([[0], total])[first][uses.edge]
    open_ = (total != before).astype(np.int64)  # whether the edge is, after this use
    opened = np.diff(open_, prepend=0)
    opened[first] = open_[first]
    unclosed = np.cumsum(np.bincount(uses.triangle, opened, len(mesh.triangles)))
    piece = np.concatenate([[0], np.cumsum(unclosed == 0)[:-1]])
    _, where, kind = np.unique(piece * (int(connected.max()) + 1) + connected, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(where))
    return np.asarray(rank[kind], dtype=np.int64)
