"""The noises: complex, band-limited random fields G, each made of kernels at hashed places.

`NOISES` is the closed list: a job file names a noise by its key. A new one is one file and one line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from amslicer.noise.cellular import Cellular, Polytope, Stit
from amslicer.noise.example import WaveByExample
from amslicer.noise.gabor import Gabor, IsotropicGabor
from amslicer.noise.gaborkernel import GaborKernel, gabor_noise, varying_gabor_noise
from amslicer.noise.kernels import KernelNoise, Kernels, Noise
from amslicer.noise.phacelle import Phacelle, SimplePhacelle
from amslicer.noise.phasor import Phasor
from amslicer.noise.textures import AsymptoticSpot, RandomPhase
from amslicer.noise.waves import Wave

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from amslicer.noise.setting import Setting
    from amslicer.reference import Lobes as RelativeLobes
    from amslicer.reference import Scalar
    from amslicer.specification import Pattern


class Maker(Protocol):
    """A noise's class.

    Attributes:
        keys: of the job file's pattern, that mean something to this noise and not to all.
    """

    @property
    def made_of(self) -> str:
        """As of Noise."""

    @property
    def keys(self) -> frozenset[str]: ...

    def of_pattern(self, pattern: Pattern, setting: Setting) -> Noise:
        """The noise that a job's pattern asks for."""

    def read_by(self, pattern: Pattern) -> str:
        """As of Noise.reads, of a job's pattern."""

    def follows(self, pattern: Pattern) -> bool:
        """As of Noise.directed, of a job's pattern."""


NOISES: dict[str, Maker] = {
    "phasor": Phasor,
    "gabor": Gabor,
    "gabor-isotropic": IsotropicGabor,
    "phacelle": Phacelle,
    "phacelle-simple": SimplePhacelle,
    "wave": Wave,
    "wave-cellular": Cellular,
    "wave-polytope": Polytope,
    "wave-stit": Stit,
    "wave-by-example": WaveByExample,
    "random-phase": RandomPhase,
    "asymptotic-spot": AsymptoticSpot,
}

__all__ = ["NOISES", "GaborKernel", "KernelNoise", "Kernels", "Noise", "gabor_noise", "sample", "varying_gabor_noise"]


def sample(
    name: str, x: ArrayLike, y: ArrayLike, z: ArrayLike = 0.0, *, period: Scalar = 1.0, bandwidth: float = 0.5,
    orientation: Scalar = 0.0, elevation: Scalar = 0.0, isotropy: Scalar = 0.0, seed: int = 1,
    dimensions: int | None = None, impulses: float | None = None, lobes: RelativeLobes = (),
    directions: int | None = None, spectrum: Any = None, time: float | None = None, fourth: float | None = None,
    probability: float | None = None, depth: int | None = None, exemplar: ArrayLike | None = None,
    exemplar_pixel_mm: float | None = None, planes: Sequence[str] | None = None,
) -> NDArray[np.complex128]:  # fmt: skip
    """A noise's complex field G at any points, in plain float64: no part, no file, no device.

    The same field as a job's with these parameters, whose origin is the lowest corner of its part. (Where a job's
    direction turns, its imaginary part may have the other sign, tile by tile; where its period varies, the kernels
    are others.) Its phase arg G makes the sheets of phasor and Phacelle noise (material 1 where |arg G| < π ratio);
    its real part is Gabor noise, or the value of cells (minus the distance to the nearest wall in mm, or minus a cell's
    number in 0…1). Kernels are summed one by one, in NumPy.

    Args:
        name: a key of NOISES.
        x, y, z: coordinates in mm, which broadcast.
        period: p, mm from sheet to sheet: a number, or a function of (N, 3) places that gives (N,) numbers, which is
            read at the kernels' centres and varies by less than an octave within a kernel's reach.
        bandwidth: B, relative to 1/period, above 0 up to 2.
        orientation: azimuth of the normal, degrees from +x towards +y: a number or a function, as the period.
        elevation: of the normal above the xy plane, degrees, likewise; 0 in 2D.
        isotropy: 0 laminate … 1 isotropic, likewise.
        seed: 0 … 2^64 - 1.
        dimensions: 2 or 3; default 3 where z or elevation is given, else 2.
        impulses: Λ, kernels per B^dimensions; default: the noise's. Not of phacelle, nor of waves.
        lobes: several directions at a place, as (degrees about z from the painted normal, weight); at most 8.
        directions, spectrum, time, fourth: of wave; directions, probability, depth: of wave-cellular, wave-polytope,
            wave-stit; exemplar_pixel_mm (default 1): of wave-by-example, random-phase, asymptotic-spot; planes: of
            wave-by-example; as in the job file's pattern.
        exemplar: (rows, columns) values of the picture that these imitate, row 0 lowest.

    Returns:
        complex128, in the coordinates' common shape.

    Raises:
        UsageError: there is no such noise, or a parameter is out of its range.
    """
    from amslicer.noise.sampling import sample as sampled

    of_noise = {
        "impulses": impulses, "lobes": lobes, "directions": directions, "spectrum": spectrum, "time": time,
        "fourth": fourth, "probability": probability, "depth": depth, "exemplar": exemplar,
        "exemplar_pixel_mm": exemplar_pixel_mm, "planes": planes,
    }  # fmt: skip
    return sampled(
        name, x, y, z, period=period, bandwidth=bandwidth, orientation=orientation, elevation=elevation,
        isotropy=isotropy, seed=seed, dimensions=dimensions, of_noise=of_noise,
    )  # fmt: skip
