"""Values at nodes: linear between, within bounds, in little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from amslicer.fields.nodes import Nodes, NodesSampler

Floats = NDArray[np.float64]

SIZE = np.array([4.0, 3.0, 2.0])


def overshooting(places: Floats) -> Floats:
    return (2 * places[:, :1] - 3) ** 3


def test_a_raster_that_would_clip_before_it_interpolates_is_none() -> None:
    nodes = Nodes(overshooting, SIZE, 1.0)
    x, y, z = np.linspace(0, 4, 33)[None, :], np.linspace(0, 3, 5)[:, None], np.asarray(0.7)
    clipped = NodesSampler(nodes, (0.0, 1.0))
    assert clipped.raster(x, y, z) is None
    assert clipped.scalar(x, y, z).max() == 1
    free = NodesSampler(nodes, (-27.0, 125.0)).raster(x, y, z)
    assert free is not None
    below, above, share = free.columns
    texels = free.texels[0].astype(np.float64)
    expected = texels[below] + share * (texels[above] - texels[below])
    np.testing.assert_allclose(nodes.at(x, y, z)[0][2], expected, atol=1e-5)


@pytest.mark.parametrize("bounds", [(-27.0, 0.1), (0.1, 0.7), (0.0, 1e6)])
def test_rounding_to_single_precision_is_no_overshoot(bounds: tuple[float, float]) -> None:
    low, high = bounds
    nodes = Nodes(lambda p: np.where(p[:, :1] < 2, low, high), SIZE, 1.0)
    x, y, z = np.linspace(0, 4, 33)[None, :], np.linspace(0, 3, 5)[:, None], np.asarray(0.7)
    raster = NodesSampler(nodes, bounds).raster(x, y, z)
    assert raster is not None
    ends = np.array(bounds, np.float32)
    assert ends[0] <= raster.texels.min()
    assert raster.texels.max() <= ends[1]


def test_points_at_many_heights_are_trilinear() -> None:
    def function(p: Floats) -> Floats:
        x, y, z = p.T
        return np.stack([x + 2 * y - z, x * y * z], axis=1)

    nodes = Nodes(function, SIZE, 0.5, 2)
    at = np.random.default_rng(3).uniform(0, SIZE, (5000, 3))
    found = nodes.at(*at.T)
    np.testing.assert_allclose(found[0], function(at)[:, 0], atol=1e-5)
    np.testing.assert_allclose(found[1], function(at)[:, 1], atol=1e-5)  # linear along each axis
    each = np.concatenate([nodes.at(*p[:, None]) for p in at[:50]], axis=1)
    np.testing.assert_array_equal(found[:, :50], each)
    z, y, x = np.array([0.1, 1.9])[:, None], np.array([[0.3], [2.0]]), np.array([[1.0, 2.5, 3.9]])
    np.testing.assert_array_equal(nodes.at(x, y, z).shape, (2, 2, 3))


def test_a_turned_strip_needs_little_more_than_its_points() -> None:
    nodes = Nodes(lambda p: np.zeros((len(p), 1)), np.array([50.0, 50.0, 50.0]), 0.5)
    nodes.whole()
    z = np.linspace(0, 50, 1000)
    tracemalloc.start()
    nodes.at(z[None, :], z[:2, None], z[None, :])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * np.prod(nodes.shape)  # half of what the planes themselves are in double precision
