"""Amplitude spectra of wave noise: how strong a wave of each frequency is, along any one direction.

Frequencies are relative to 1/period. A spectrum's power is a density in the frequency space of the plane or of space,
as pictures of spectra show it: white is as strong everywhere, whatever the direction (Guehl et al. 2025, section 4).

`SPECTRA` are those with a name, `SHAPES` those with parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Union

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
LOW, HIGH = 0.125, 1.0  # of broad spectra, where no other is given: three octaves
LEAST, MOST = 0.01, 4.0  # longer waves than a table serves; shorter ones than a printer shows
# Where exp(-2π (f - 1/p)²/b²), the laminate's power, falls to 1e-6: |f - 1/p| in units of b.
BAND_REACH = 1.48
GAUSSIAN_REACH = 3.7  # of a Gaussian of amplitudes, in standard deviations: 1e-3 of the peak


class Spectrum(Protocol):
    """Amplitudes over frequency, as a part of the job."""

    def band(self, bandwidth: float) -> tuple[float, float]:
        """The lowest and the highest frequency, in 1/period."""

    def amplitude(self, frequency: Floats, bandwidth: float) -> Floats:
        """A(f) ≥ 0 at frequencies in 1/period, in any unit; 0 outside the band."""


@dataclass(frozen=True)
class Laminate:
    """The ring that a laminate's spectrum is part of: a Gaussian around 1/period as wide as the bandwidth makes it.

    The same as of phasor noise's kernels: exp(-π b² r²) has the power exp(-2π (f - f0)²/b²).
    """

    def band(self, bandwidth: float) -> tuple[float, float]:
        """1 ± 1.48 B."""
        return max(1 - BAND_REACH * bandwidth, 0.0), 1 + BAND_REACH * bandwidth

    def amplitude(self, frequency: Floats, bandwidth: float) -> Floats:
        """exp(-π (f - 1)²/B²)."""
        return np.asarray(np.exp(-np.pi * ((frequency - 1) / bandwidth) ** 2))


class Directional(Protocol):
    """Amplitudes that depend on the direction, in printer axes: neither the painted direction nor isotropy count."""

    def band(self, bandwidth: float) -> tuple[float, float]:
        """As of Spectrum."""

    def amplitude_along(self, direction: Floats, frequency: Floats, bandwidth: float) -> Floats:
        """A(f) of waves that travel along a (3,) unit vector, or against it."""

    @property
    def length_periods(self) -> float | None:
        """Of a table, where it is not what the band asks for."""


class Shape(BaseModel):
    """Base of the spectra with parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Limits(Shape):
    """The band of a broad spectrum."""

    low: Annotated[Number, Field(ge=LEAST, le=MOST)] = Field(default=LOW, description="lowest frequency, in 1/period")
    high: Annotated[Number, Field(ge=LEAST, le=MOST)] = Field(default=HIGH, description="highest frequency")

    @model_validator(mode="after")
    def _rising(self) -> Limits:
        if not self.low < self.high:
            raise ValueError(f"has low {self.low:g} and high {self.high:g}; low is below high")
        return self

    def band(self, bandwidth: float) -> tuple[float, float]:
        """From low to high."""
        return self.low, self.high

    def inside(self, frequency: Floats) -> Floats:
        """1 in the band, else 0."""
        return np.asarray((frequency >= self.low) & (frequency <= self.high), np.float64)


class Power(Limits):
    """Power that grows as f^power: 0 white, 1 blue, -2 brown; an amplitude of 1/f^n is -2n."""

    power: Annotated[Number, Field(ge=-8, le=8)] = Field(description="exponent of the power over frequency")

    def amplitude(self, frequency: Floats, bandwidth: float) -> Floats:
        """f^(power/2) within the band."""
        inside = self.inside(frequency)
        return np.asarray(inside * np.where(inside > 0, frequency, 1.0) ** (self.power / 2))


class GaussianShape(Shape):
    """Amplitudes as a Gaussian over frequency (Fig. 2)."""

    gaussian: Annotated[Number, Field(ge=0, le=MOST)] = Field(description="frequency of the peak, in 1/period")
    width: Annotated[Number, Field(ge=LEAST, le=MOST)] = Field(default=0.2, description="standard deviation")

    def band(self, bandwidth: float) -> tuple[float, float]:
        """As far as amplitudes matter."""
        reach = GAUSSIAN_REACH * self.width
        return max(self.gaussian - reach, 0.0), self.gaussian + reach

    def amplitude(self, frequency: Floats, bandwidth: float) -> Floats:
        """exp(-(f - f0)²/(2 width²))."""
        return np.asarray(np.exp(-(((frequency - self.gaussian) / self.width) ** 2) / 2))


class TableShape(Shape):
    """Amplitudes between the points of a table, 0 outside."""

    table: tuple[tuple[Number, Number], ...] = Field(
        min_length=2, max_length=1000, description="[frequency in 1/period, amplitude], with rising frequencies"
    )

    @model_validator(mode="after")
    def _usable(self) -> TableShape:
        frequency, amplitude = np.array(self.table).T
        if not np.all(np.diff(frequency) > 0):
            raise ValueError("needs rising frequencies")
        if not (frequency[0] >= 0 and LEAST <= frequency[-1] <= MOST):
            raise ValueError(
                f"has frequencies from {frequency[0]:g} to {frequency[-1]:g}; they end at {LEAST:g} … {MOST:g}"
            )
        if not (np.all(amplitude >= 0) and np.any(amplitude > 0)):
            raise ValueError("needs amplitudes of at least 0, and one above")
        return self

    def band(self, bandwidth: float) -> tuple[float, float]:
        """From the first point to the last."""
        return self.table[0][0], self.table[-1][0]

    def amplitude(self, frequency: Floats, bandwidth: float) -> Floats:
        """Linear between the points."""
        at, amplitude = np.array(self.table).T
        return np.asarray(np.interp(frequency, at, amplitude, left=0.0, right=0.0))


@dataclass(frozen=True)
class Waveform:
    """No spectrum, but the wave itself: real, and far from Gaussian (section 6.2, Fig. 10).

    Attributes:
        steps: plateaus of random height (crystals); else impulses (webs).
    """

    steps: bool


# Per period along a direction: plateaus and impulses. How wide an impulse is, in periods:
# far from it a wave falls off as 1/distance, so that no two places need have the same value.
STEPS, IMPULSES, IMPULSE_WIDTH = 2.0, 0.35, 0.06
SPECTRA: dict[str, Spectrum | Waveform] = {
    "laminate": Laminate(),
    "white": Power(power=0),
    "blue": Power(power=1),
    "brown": Power(power=-2),
    "crystal": Waveform(steps=True),
    "web": Waveform(steps=False),
}
BASIC: dict[str, type[Shape]] = {"power": Power, "gaussian": GaussianShape, "table": TableShape}


def describe_spectra() -> str:
    """What a spectrum can be, for messages."""
    return ", ".join([*SPECTRA, *(f"{{{name}: …}}" for name in _shapes())])


def _kind(value: Any) -> str | None:
    if isinstance(value, str):
        return "name"
    if isinstance(value, Shape):
        return next(name for name, kind in _shapes().items() if isinstance(value, kind))
    if isinstance(value, dict):
        named = [name for name in _shapes() if name in value]
        return named[0] if len(named) == 1 else None
    return None


def _known(name: str) -> str:
    if name not in SPECTRA:
        raise PydanticCustomError("spectrum", "is not a spectrum; one is {spectra}", {"spectra": describe_spectra()})
    return name


def _shapes() -> dict[str, type[Shape]]:
    return SHAPES


SAID = "is not a spectrum; there are laminate, white, blue, brown, {power: …}, {gaussian: …} and {table: …}"
if TYPE_CHECKING:
    BasicSpec: TypeAlias = str | Power | GaussianShape | TableShape
else:
    _Name = Annotated[str, AfterValidator(_known), Field(json_schema_extra={"enum": list(SPECTRA)}), Tag("name")]
    _Basic = [Annotated[kind, Tag(name)] for name, kind in BASIC.items()]
    BasicSpec = Annotated[
        Union[(_Name, *_Basic)],
        Discriminator(_kind, custom_error_type="spectrum", custom_error_message=SAID),
    ]


def make_basic(spec: BasicSpec) -> Spectrum | Waveform:
    """The spectrum of a specification that depends on no direction."""
    return SPECTRA[spec] if isinstance(spec, str) else spec


def _spectrum_of(spec: BasicSpec) -> Spectrum:
    found = make_basic(spec)
    assert not isinstance(found, Waveform)
    return found


class DirectionalShape(Shape):
    """Base of the spectra that depend on the direction."""

    @property
    def length_periods(self) -> float | None:
        """As the band asks for."""
        return None


class SectorsShape(DirectionalShape):
    """One spectrum in some directions, nothing in the others (section 4.3, Fig. 5 right)."""

    sectors: tuple[tuple[Number, Number], ...] = Field(
        min_length=1,
        max_length=64,
        description="[from, to] of azimuths in degrees, from +x towards +y; as lines, by 180",
    )
    of: BasicSpec = Field(default="white", description="the spectrum in them")
    elevation: tuple[Number, Number] = Field(default=(0.0, 90.0), description="in space: above or below the xy plane")

    @model_validator(mode="after")
    def _usable(self) -> SectorsShape:
        for low, high in (*self.sectors, self.elevation):
            if not low < high:
                raise ValueError(f"has a sector from {low:g} to {high:g}; the first is below the second")
        if isinstance(make_basic(self.of), Waveform):
            raise ValueError(f"is of {self.of}, which is no spectrum but a wave")
        return self

    def band(self, bandwidth: float) -> tuple[float, float]:
        """That of the spectrum."""
        return _spectrum_of(self.of).band(bandwidth)

    def amplitude_along(self, direction: Floats, frequency: Floats, bandwidth: float) -> Floats:
        """The spectrum's, or 0."""
        azimuth = np.rad2deg(np.arctan2(direction[1], direction[0]))
        rise = abs(np.rad2deg(np.arcsin(np.clip(direction[2], -1, 1))))
        inside = any((azimuth - low) % 180 <= high - low for low, high in self.sectors)
        inside &= self.elevation[0] <= rise <= self.elevation[1]
        return np.asarray(_spectrum_of(self.of).amplitude(frequency, bandwidth) * inside)


class AlongShape(DirectionalShape):
    """A spectrum for each axis, mixed by how much a direction lies along it (section 4.3, Fig. 5 left)."""

    along: tuple[BasicSpec, BasicSpec, BasicSpec] = Field(description="spectra of waves along x, y and z")

    @model_validator(mode="after")
    def _usable(self) -> AlongShape:
        for spec in self.along:
            if isinstance(make_basic(spec), Waveform):
                raise ValueError(f"has {spec}, which is no spectrum but a wave")
        return self

    def band(self, bandwidth: float) -> tuple[float, float]:
        """The widest."""
        bands = [_spectrum_of(spec).band(bandwidth) for spec in self.along]
        return min(low for low, _ in bands), max(high for _, high in bands)

    def amplitude_along(self, direction: Floats, frequency: Floats, bandwidth: float) -> Floats:
        """Σ |ω_i| A_i(f): phases are the same, so amplitudes add."""
        parts = [
            abs(c) * _spectrum_of(spec).amplitude(frequency, bandwidth)
            for c, spec in zip(direction, self.along, strict=True)
        ]
        return np.asarray(np.sum(parts, axis=0))


SHAPES: dict[str, type[Shape]] = {**BASIC, "sectors": SectorsShape, "along": AlongShape}

if TYPE_CHECKING:
    SpectrumSpec: TypeAlias = BasicSpec | SectorsShape | AlongShape
else:
    SpectrumSpec = Annotated[
        Union[(_Name, *(Annotated[kind, Tag(name)] for name, kind in SHAPES.items()))],
        Discriminator(
            _kind, custom_error_type="spectrum", custom_error_message=f"is not a spectrum; one is {describe_spectra()}"
        ),
    ]


def make_spectrum(spec: SpectrumSpec) -> Spectrum | Directional | Waveform:
    """The spectrum of a job's specification."""
    return SPECTRA[spec] if isinstance(spec, str) else spec
