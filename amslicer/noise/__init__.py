"""The noises: complex, band-limited random fields G, each made of kernels at hashed places.

`NOISES` is the closed list: a job file names a noise by its key. A new one is one file and one line.
"""

from __future__ import annotations

from collections.abc import Callable

from amslicer.noise.kernels import Kernels, Noise
from amslicer.noise.phasor import Phasor

# Name -> maker(periods_mm=, bandwidth=, dimensions=, seed=, impulses=default of the noise).
NOISES: dict[str, Callable[..., Noise]] = {
    "phasor": Phasor,
}

__all__ = ["NOISES", "Kernels", "Noise"]
