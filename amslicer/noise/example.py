"""Wave noise by example (Guehl et al. 2025, section 4.4): a picture's spectrum, sector by sector, in 2D and in 3D."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, radians
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from amslicer.noise.waves import READS, Wave

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.noise.setting import Setting
    from amslicer.specification import Pattern

    Floats = NDArray[np.float64]

LOOKS = 9  # per side of a cell of frequencies and directions, over which the picture's power is averaged
LENGTH = 4.0  # of a table, in pictures: amplitudes are read at quarters of its frequencies
# In space a plane's sectors reach this far above and below it: they are pyramids, as in Fig. 6.
HALF_ANGLE = radians(12.0)
DIRECTIONS = {2: 48, 3: 600}
AXES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@dataclass(frozen=True, eq=False)
class Example:
    """Amplitudes read from a picture's periodic component, whose frequencies are in 1/mm.

    Attributes:
        picture: (rows, columns), row 0 lowest.
        pixel_mm: of the picture.
        planes: which of xy, xz, yz show it; each other direction has nothing. In the plane: None.
        sector: how wide one is, rad.
    """

    picture: Floats
    pixel_mm: float
    planes: tuple[str, ...] | None
    sector: float
    # The power of a plane's sectors is that of the plane, however far they reach beside it: as in 2D.
    dimensions: ClassVar[int] = 2

    @property
    def _width_mm(self) -> float:
        return float(max(self.picture.shape) * self.pixel_mm)

    @property
    def length_periods(self) -> float:
        """In units of 1 mm."""
        return LENGTH * self._width_mm

    def band(self, bandwidth: float) -> tuple[float, float]:
        """From one wave over the picture to two pixels a wave."""
        return 1 / self._width_mm, 0.5 / self.pixel_mm

    @cached_property
    def _power(self) -> Floats:
        """|FFT|², frequency 0 in the middle and without its power."""
        spectrum = np.abs(np.fft.fft2(self.picture)) ** 2
        spectrum[0, 0] = 0.0
        return np.asarray(np.fft.fftshift(spectrum))

    def amplitude_along(self, direction: Floats, frequency: Floats, bandwidth: float) -> Floats:
        """√ of the mean power of the sector, of all planes that have the direction."""
        power = np.zeros(len(frequency))
        for plane in self.planes or ("xy",):
            a, b = AXES[plane]
            flat = float(np.hypot(direction[a], direction[b]))
            if self.planes is not None and flat < cos(HALF_ANGLE):
                continue
            power += self._sector(float(np.arctan2(direction[b], direction[a])), frequency)
        return np.sqrt(power)

    def _sector(self, azimuth: float, frequency: Floats) -> Floats:
        """Mean power at frequencies along an azimuth, over half a step of the picture's frequencies to either side."""
        from scipy import ndimage

        look = (np.arange(LOOKS) - LOOKS // 2) / LOOKS
        radius = np.maximum(frequency[:, None, None] + look[:, None] / self._width_mm, 0.0)
        angle = azimuth + look * self.sector
        rows, columns = self.picture.shape
        at = np.stack([
            rows // 2 + radius * np.sin(angle) * (rows * self.pixel_mm),
            columns // 2 + radius * np.cos(angle) * (columns * self.pixel_mm),
        ])  # fmt: skip
        found = ndimage.map_coordinates(self._power, at, order=1, mode="grid-wrap")
        return np.asarray(found.mean(axis=(1, 2)))


@dataclass(frozen=True)
class WaveByExample(Wave):
    """Wave noise with a picture's spectrum; attributes as of Wave, with lengths in mm."""

    keys: ClassVar[frozenset[str]] = frozenset(
        {"exemplar", "exemplar_pixel_mm", "directions", "planes", "reads", "time", "fourth"}
    )

    @classmethod
    def of_pattern(cls, pattern: Pattern, setting: Setting) -> Self:
        """The noise that a job's pattern asks for."""
        assert setting.exemplar is not None, "a job without an exemplar is refused"
        directions = pattern.directions or DIRECTIONS[pattern.dimensions]
        planes = None if pattern.dimensions == 2 else pattern.planes
        sector = pi / directions if planes is None else np.sqrt(2 * pi / directions)
        return cls(
            periods_mm=(1.0, 1.0), bandwidth=pattern.bandwidth, dimensions=pattern.dimensions, seed=pattern.seed,
            directions=directions, reads=cls.read_by(pattern), time=pattern.time, fourth=pattern.fourth,
            spectrum=Example(setting.exemplar, setting.pixel_mm, planes, float(sector)),
        )  # fmt: skip

    @classmethod
    def read_by(cls, pattern: Pattern) -> str:
        """What of G a job's pattern reads; its value where it does not say."""
        return READS[pattern.reads or "real"]

    @classmethod
    def follows(cls, pattern: Pattern) -> bool:
        """Not the painted direction: the picture has its own."""
        return False
