"""A field smoothed by a Gaussian.

    {blur: {field: FIELD, mm: 2.0}}        mm: standard deviation, in the part's file

Beyond the part's box the field is taken to stay as it is at the box's sides. Directions are smoothed as lines, through
n nᵀ. It is worked out at the nodes of a grid, linear between; a step is placed to half a node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from amslicer.errors import JobError
from amslicer.fields.combination import Content
from amslicer.fields.nodes import Nodes, NodesSampler
from amslicer.fields.opening import open_field, open_orientation
from amslicer.fields.orientation import Lines, principal_lines, tensors_of
from amslicer.fields.source import Frame, Inputs, Number, Sampler, Source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from amslicer.fields import FieldSpec
    from amslicer.fields.orientation import Orientation

    Floats = NDArray[np.float64]

LEAST_PER_SIGMA, MOST_PER_SIGMA = 2, 32  # nodes per standard deviation: so few at least, no more than are of use
WANTED_VALUES = 4_000_000  # numbers at nodes: a second's work
MOST_VALUES = 24_000_000  # where fewer are too coarse: some ten seconds, 200 MB
SHORTEST_MM = 1e-3  # a thousandth of a millimetre is below every printer's pixel
WIDEST = 64  # a Gaussian so many times wider than the box is the mean of its two sides, within 1 %
TENSOR_PARTS = 6  # of n nᵀ


class Blur(Content):
    """A field and a width."""

    field: FieldSpec = Field(description="the field to smooth")
    mm: Annotated[Number, Field(ge=SHORTEST_MM)] = Field(
        description="standard deviation of the Gaussian, mm in the part's file"
    )


class BlurSource(Source):
    """A field without its fine detail."""

    blur: Blur = Field(description="{field: FIELD, mm: 2}: smoothed by a Gaussian of this standard deviation")

    @property
    def mixes_numbers(self) -> bool:
        """Always."""
        return True

    def open(self, frame: Frame, inputs: Inputs) -> Sampler:
        """The smoothed numbers over a part.

        Raises:
            JobError: too fine for the part's size, or the field cannot be used.
        """
        field = open_field(self.blur.field, frame, inputs)
        bounds = field.bounds
        if not any(field.varies) or bounds[0] == bounds[1]:
            return field

        def values(places: Floats) -> Floats:
            return np.broadcast_to(field.scalar(*places.T), len(places))[:, None]

        nodes = self._smoothed(values, frame, 1, field.varies)
        return NodesSampler(nodes, bounds if np.isfinite(bounds).all() else None)

    def open_orientation(self, frame: Frame, inputs: Inputs) -> Orientation:
        """The smoothed directions over a part; raises as open does."""
        field = open_orientation(self.blur.field, frame, inputs)
        if not any(field.varies) or not field.turns:
            return field
        nodes = self._smoothed(lambda places: tensors_of(field.normals(*places.T)), frame, TENSOR_PARTS, field.varies)
        return Lines(lambda x, y, z: principal_lines(np.moveaxis(nodes.at(x, y, z), 0, -1)), field.varies)

    def _smoothed(
        self, function: Callable[[Floats], Floats], frame: Frame, channels: int, varies: tuple[bool, bool, bool]
    ) -> Nodes:
        """A grid of nodes with all of its planes made."""
        from scipy.ndimage import gaussian_filter1d

        size, sigma = frame.size_mm, self.blur.mm
        for per_sigma in range(MOST_PER_SIGMA, LEAST_PER_SIGMA - 1, -1):
            nodes = Nodes(function, size, sigma / per_sigma, channels, varies)
            count = float(np.prod([float(n) for n in nodes.shape]))
            if count * channels <= (MOST_VALUES if per_sigma == LEAST_PER_SIGMA else WANTED_VALUES):
                break
        else:
            shown = " × ".join(str(n) for n in nodes.shape)
            raise JobError(
                f"a blur of {sigma:g} mm over {' × '.join(f'{side:.4g}' for side in size)} mm needs {shown} nodes; "
                f"at most {MOST_VALUES // channels} are made",
                hint=f"use a larger mm, {_fitting(sigma, count * channels, sum(varies)):.2g} for instance",
            )
        values = nodes.whole()
        for axis, along in enumerate(nodes.shape):
            if along > 1:
                step_mm = float(size[axis]) / (along - 1)
                width = min(sigma / step_mm, WIDEST * along)
                values = gaussian_filter1d(values, width, axis=3 - axis, mode="nearest")
        return Nodes(function, size, nodes.spacing_mm, channels, varies, dict(enumerate(np.moveaxis(values, 1, 0))))


def _fitting(sigma_mm: float, values: float, axes: int) -> float:
    """A width, about, with which a blur has fewer values than are made."""
    return 1.1 * sigma_mm * float((values / MOST_VALUES) ** (1 / axes))
