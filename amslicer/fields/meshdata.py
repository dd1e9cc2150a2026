"""A field from the results of a finite-element analysis: an array at the nodes or in the cells of a mesh.

    {mesh_data: result.vtu, array: von_mises, data: [0, 80], range: [0.2, 0.8]}      0 … 80 in the file → 0.2 … 0.8
    {mesh_data: result.vtu, array: stress, component: von_mises, range: [0.2, 0.8]}  data: the array's own range
    {mesh_data: result.vtu, array: stress, principal: 1}                             a direction: of the most tension
    {mesh_data: result.vtu, array: displacement, units: m}                           a direction: along the vectors

The mesh lies in the part's file coordinates (its unit by `units`). Values are linear in tetrahedra, or in the triangles
of a flat mesh, and then the same at all heights; other kinds of cells are cut into these, and quadratic ones count with
their corner nodes. Outside the mesh, a field is as at the nearest place of its surface. Values of cells are averaged to
the nodes by volume unless `smooth: false`. Vectors and tensors make directions; `component` makes them numbers.

A tensor has three principal directions in space: where a plane stress compresses both ways, `principal: 1` is the
direction out of the plane, whose stress is 0. Where a vector is 0, or a tensor the same all around, it is +x. `order`
names six components in the order of the file: VTK's is the default, Abaqus has [xx, yy, zz, xy, xz, yz], XDMF's Tensor6
[xx, xy, xz, yy, yz, zz].
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from amslicer.errors import JobError
from amslicer.fields.constant import ConstantSampler
from amslicer.fields.nodes import Nodes, choose_spacing, lines_on_nodes
from amslicer.fields.orientation import TENSOR, tensors_of, unit_vectors
from amslicer.fields.results import Place, Results, read_results
from amslicer.fields.simplices import Located, Simplices, cut, optional_library
from amslicer.fields.source import TINY_SHARE, Frame, Inputs, Number, Range, Sampler, Source, blend
from amslicer.fields.tensors import eigenlines, matrices, von_mises
from amslicer.mesh import UNIT_MM

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    from amslicer.fields.orientation import Orientation

    Floats = NDArray[np.float64]

Component = Literal["x", "y", "z", "magnitude", "xx", "yy", "zz", "xy", "yz", "xz", "von_mises", "principal"]
TensorName = Literal["xx", "yy", "zz", "xy", "yz", "xz"]
SixNames = tuple[TensorName, TensorName, TensorName, TensorName, TensorName, TensorName]
TENSOR_NAMES: SixNames = ("xx", "yy", "zz", "xy", "yz", "xz")  # the order of TENSOR, and of VTK
OF_VECTORS, OF_TENSORS = ("x", "y", "z", "magnitude"), (*TENSOR_NAMES, "von_mises", "principal")
FINEST_GRID_MM = 0.01  # a fifth of a pixel: finer ones are mistakes
MOST_GRID_NODES = 50_000_000  # six float32 each are 1.2 GB
FAR = 1e30  # in widths of the data interval: still float32


class MeshDataSource(Source):
    """An array of a finite-element mesh."""

    mesh_data: str = Field(min_length=1, description="vtu, vtk, msh (Gmsh), xdmf (numbers inline) or avs file")
    array: str = Field(min_length=1, description="the array's name in the file")
    on: Place | None = Field(default=None, description="where the array is, if its name is at points and in cells")
    data: Range | None = Field(
        default=None, description="values in the file that become range[0] and range[1]; default: least and greatest"
    )
    range: Range = Field(default=(0.0, 1.0), description="values of the field; clipped to these")
    units: Literal["mm", "cm", "m", "inch"] = Field(default="mm", description="what one unit of the mesh is")
    component: Component | None = Field(default=None, description="which number of a vector or tensor")
    principal: Annotated[int, Field(strict=True, ge=1, le=3)] | None = Field(
        default=None,
        description="a tensor's direction: of its largest eigenvalue (1: tension), middle or smallest",
    )
    order: SixNames = Field(default=TENSOR_NAMES, description="order of a tensor's six components in the file")
    smooth: bool = Field(default=True, description="average the values of cells to the nodes, by volume")
    grid_mm: Annotated[Number, Field(ge=FINEST_GRID_MM)] | None = Field(
        default=None, description="grid that the field is evaluated on; default: about 500 000 nodes over the part"
    )

    @field_validator("data")
    @classmethod
    def _ascending(cls, data: tuple[float, float] | None) -> tuple[float, float] | None:
        if data is not None and not data[0] < data[1]:
            raise ValueError(f"must be [low, high] with low < high, but is {list(data)}; turn range around instead")
        return data

    @field_validator("order")
    @classmethod
    def _complete(cls, order: SixNames) -> SixNames:
        if set(order) != set(TENSOR_NAMES):
            raise ValueError(f"must name each of {', '.join(TENSOR_NAMES)} once, but is {list(order)}")
        return order

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if self.principal is not None and self.component not in (None, "principal"):
            raise ValueError(f"principal makes a direction, component: {self.component} a number: give one of them")
        if self.component == "principal" and self.principal is None:
            raise ValueError("component: principal needs principal: 1, 2 or 3")
        return self

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The array's numbers over a part.

        Raises:
            JobError: the file, the array or its components cannot be used; or it makes directions.
        """
        solved = self._solve(frame, inputs)
        if solved.kind != "scalar" and self.component is None:
            choices = OF_VECTORS if solved.kind == "vector" else OF_TENSORS
            raise JobError(
                f"the {solved.kind}s of the array '{self.array}' of '{self.mesh_data}' make directions, and a number "
                "is asked for here",
                hint=f"add component: {' | '.join(choices)}, or use it as fields.orientation",
            )
        shares = self._shares(solved)
        ends = np.clip([shares[solved.used].min(), shares[solved.used].max()], 0.0, 1.0)
        if ends[0] == ends[1]:
            return ConstantSampler(float(blend(ends[0], *self.range)))
        at_nodes = solved.smoothed(shares[:, None], self.smooth)
        nodes = Nodes(
            lambda places: solved.interpolate(at_nodes, places),
            frame.size_mm,
            self._spacing(frame, solved),
            varies=solved.varies,
        )
        mesh = hashlib.sha256(inputs.read(self.mesh_data)).hexdigest(), solved.results.on, self.units
        return MeshDataSampler(solved, shares, nodes, (float(ends[0]), float(ends[1])), self.range, mesh)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The array's directions over a part; of numbers, angles in degrees.

        Raises:
            JobError: the file, the array or its components cannot be used.
        """
        solved = self._solve(frame, inputs)
        which = 1
        if solved.kind == "scalar" or self.component is not None:
            angles = np.deg2rad(blend(np.clip(self._shares(solved), 0.0, 1.0), *self.range))
            tensors = tensors_of(np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1))
        elif solved.kind == "vector":
            lengths = np.linalg.norm(solved.values, axis=-1, keepdims=True)
            tensors = lengths * tensors_of(unit_vectors(solved.values))
        elif self.principal is not None:
            tensors, which = solved.values, self.principal
        else:
            raise JobError(
                f"which direction of the tensors of the array '{self.array}' of '{self.mesh_data}'?",
                hint="add principal: 1 (largest eigenvalue: tension), 2 or 3 (smallest: compression)",
            )
        at_nodes = solved.smoothed(tensors, self.smooth)
        return lines_on_nodes(
            lambda places: eigenlines(solved.interpolate(at_nodes, places), which),
            frame.size_mm,
            self._spacing(frame, solved),
            solved.varies,
        )

    def paths(self) -> tuple[str, ...]:
        """The mesh's path."""
        return (self.mesh_data,)

    def with_paths(self, renamed: Mapping[str, str]) -> Source:
        """The same source with its mesh elsewhere."""
        return self.model_copy(update={"mesh_data": renamed.get(self.mesh_data, self.mesh_data)})

    def _solve(self, frame: Frame, inputs: Inputs) -> Solved:
        optional_library("igl", "mesh_data")  # now, rather than at the first place that is asked
        results = read_results(inputs.read(self.mesh_data), self.mesh_data, self.array, self.on)
        points = results.points * UNIT_MM[self.units]
        mesh = cut(points - frame.minimum_mm, results.blocks, self.mesh_data)
        self._check_box(points[results.used], mesh.level is not None, frame)
        kind, values = self._components(results)
        return Solved(results, mesh, kind, values)

    def _components(self, results: Results) -> tuple[str, Floats]:
        """What the array holds, and its (M,) scalars, (M, 3) vectors or (M, 6) tensors."""
        values, named = results.values, f"the array '{self.array}' of '{self.mesh_data}'"
        count = values.shape[1]
        if count == 1:
            kind, values = "scalar", values[:, 0]
        elif count in (2, 3):
            kind, values = "vector", np.column_stack([values, np.zeros((len(values), 3 - count))])
        elif count == 6:
            kind, values = "tensor", values[:, [self.order.index(name) for name in TENSOR_NAMES]]
        elif count == 9:
            square = values.reshape(-1, 3, 3)
            kind, values = "tensor", np.stack([(square[:, i, j] + square[:, j, i]) / 2 for i, j in TENSOR], axis=-1)
        else:
            raise JobError(
                f"{named} has {count} components",
                hint="1 are a number, 2 or 3 a vector, 6 or 9 (3 x 3) a tensor",
            )
        fitting = {"scalar": (), "vector": OF_VECTORS, "tensor": OF_TENSORS}[kind]
        if self.component is not None and self.component not in fitting:
            raise JobError(
                f"{named} holds {kind}s ({count} components), which have no component {self.component}",
                hint=f"{kind}s have " + (", ".join(fitting) if fitting else "none: leave out component"),
            )
        if self.principal is not None and kind != "tensor":
            raise JobError(
                f"{named} holds {kind}s ({count} components), which have no principal direction",
                hint="principal is for tensors of 6 or 9 components; leave it out",
            )
        return kind, values

    def _shares(self, solved: Solved) -> Floats:
        """(M,) where each number lies in the data interval: 0 at its low end, 1 at its high one."""
        numbers = self._numbers(solved)
        low, high = self.data or (float(numbers[solved.used].min()), float(numbers[solved.used].max()))
        if not low < high:
            raise JobError(
                f"the array '{self.array}' of '{self.mesh_data}' is {low:.6g} everywhere, which is no interval to map "
                f"to {list(self.range)}",
                hint="add data: [low, high], the values that become range[0] and range[1]",
            )
        with np.errstate(over="ignore"):
            return np.clip((numbers - low) / (high - low), -FAR, FAR)

    def _numbers(self, solved: Solved) -> Floats:
        v = solved.values
        if solved.kind == "scalar":
            return v
        if self.component == "magnitude":
            return np.asarray(np.linalg.norm(v, axis=1))
        if self.component == "von_mises":
            return von_mises(v)
        if self.component == "principal":
            assert self.principal is not None
            return np.asarray(np.linalg.eigvalsh(matrices(v))[:, 3 - self.principal])
        names = OF_VECTORS if solved.kind == "vector" else OF_TENSORS
        assert self.component is not None
        return np.asarray(v[:, names.index(self.component)])

    def _spacing(self, frame: Frame, solved: Solved) -> float:
        if self.grid_mm is None:
            return choose_spacing(frame.size_mm, solved.varies)
        sides = [side for side, along in zip(frame.size_mm, solved.varies, strict=True) if along]
        count = float(np.prod([side / self.grid_mm + 1 for side in sides]))
        if count > MOST_GRID_NODES:
            raise JobError(
                f"grid_mm: {self.grid_mm} makes {count:.3g} nodes over the part; at most {MOST_GRID_NODES} are made",
                hint=f"the default is {choose_spacing(frame.size_mm, solved.varies):.3g} mm here",
            )
        return self.grid_mm

    def _check_box(self, points: Floats, flat: bool, frame: Frame) -> None:
        """The mesh and the part have places in common, and are of similar size."""
        low, high = points.min(axis=0), points.max(axis=0)
        part_low, part_high = frame.minimum_mm, frame.minimum_mm + frame.size_mm
        axes = slice(0, 2 if flat else 3)
        apart = bool(((low > part_high) | (high < part_low))[axes].any())
        tiny = float((high - low).max()) < TINY_SHARE * float(frame.size_mm.max())
        if apart or tiny:
            box, part = (
                " x ".join(f"{a:.6g} … {b:.6g}" for a, b in zip(ends[0][axes], ends[1][axes], strict=True))
                for ends in ((low, high), (part_low, part_high))
            )
            raise JobError(
                f"the mesh of '{self.mesh_data}' {'lies outside the part' if apart else 'is tiny beside the part'}: "
                f"it is {box} mm, the part's file {part} mm",
                hint=f"units: {self.units} may be another one, or the analysis moved the part",
            )


@dataclass(frozen=True, eq=False)
class Solved:
    """An array over a mesh in the field frame.

    Attributes:
        kind: scalar, vector or tensor.
        values: (M,), (M, 3) or (M, 6) at nodes or in cells.
    """

    results: Results
    mesh: Simplices
    kind: str
    values: Floats

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """In space; flat meshes in their plane."""
        return True, True, self.mesh.level is None

    @property
    def used(self) -> NDArray[np.bool_]:
        """(M,) which values count."""
        return self.results.used if self.results.on == "points" else np.ones(len(self.values), bool)

    def smoothed(self, values: Floats, smooth: bool) -> tuple[Floats, Place]:
        """(M, C) values where they are interpolated from: those of cells at nodes, weighted by size, or as they are."""
        if self.results.on == "points" or not smooth:
            return values, self.results.on
        sizes = self.mesh.cell_sizes(len(values))
        total = np.zeros((len(self.results.points), values.shape[1]))
        weight, before = np.zeros(len(total)), 0
        for _, nodes in self.results.blocks:
            own = slice(before, before + len(nodes))
            before += len(nodes)
            shares = np.repeat(sizes[own], nodes.shape[1])
            weight += np.bincount(nodes.ravel(), shares, len(total))
            for channel in range(values.shape[1]):
                each = shares * np.repeat(values[own, channel], nodes.shape[1])
                total[:, channel] += np.bincount(nodes.ravel(), each, len(total))
        return total / np.where(weight == 0, 1.0, weight)[:, None], "points"

    def interpolate(self, values: tuple[Floats, Place], places: Floats) -> Floats:
        """(N, C) of what `smoothed` gave, at (N, 3) places."""
        located = self.mesh.locate(places)
        return located.between(values[0]) if values[1] == "points" else values[0][located.cells]


@dataclass(frozen=True, eq=False)
class MeshDataSampler:
    """Numbers of a mesh, by where they lie in the data interval.

    Attributes:
        shares: (M,) 0 at the low end of the interval, 1 at the high one; beyond, clipped after interpolation.
        nodes: the same on a grid.
        ends: the least and the greatest share, clipped.
        range: the values at 0 and 1.
        mesh: tells it from others.
    """

    solved: Solved
    shares: Floats
    nodes: Nodes
    ends: tuple[float, float]
    range: tuple[float, float]
    mesh: Hashable

    @property
    def varies(self) -> tuple[bool, bool, bool]:
        """As the mesh does."""
        return self.solved.varies

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value at any node or in any cell."""
        low, high = sorted(float(blend(np.asarray(end), *self.range)) for end in self.ends)
        return low, high

    @property
    def texels(self) -> Hashable:
        """Arrays of one mesh share its nodes."""
        return ("mesh_data", self.mesh)

    def scalar(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Values at points, from the grid."""
        return blend(np.clip(self.nodes.at(x, y, z)[0], *self.ends), *self.range)

    def taps(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """The values at the corners around each point; of cells, the one value of the cell, never smoothed."""
        located: Located = self.solved.mesh.locate(np.column_stack(np.broadcast_arrays(x, y, z)))
        values = blend(np.clip(self.shares, *self.ends), *self.range)
        if self.solved.results.on == "cells":
            return values[located.cells][None], np.ones((1, len(located.cells)))
        return values[located.corners].T, located.weights.T
