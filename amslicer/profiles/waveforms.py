"""Waveforms: real functions f of the phase, as drawn in books on synthesizers. t = ϕ/2π is a share of a turn, 0…1.

`WAVES` are those with a name, `SHAPES` those with parameters, by their key in the job file. A new one is one function
and one line.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from amslicer.fields import FieldSpec
from amslicer.fields.source import Number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Waveform = Callable[[Any], Any]
"""f of shares of a turn, float64, any shape; what lies outside 0…1 is taken modulo 1."""

MAX_SAMPLES, MAX_HARMONICS = 1024, 64
Highest = Annotated[Number, Field(ge=-1e6, le=1e6)]
"""A value of a waveform: larger ones lose the digits that tell them apart."""


def sine(t: Floats) -> Floats:
    """cos 2πt: the paper's sine, a quarter of a turn on, so that it is the same for ϕ and -ϕ."""
    return np.cos(2 * np.pi * t)


def triangle(t: Floats) -> Floats:
    """From 1 at t = 0 to -1 at ½ and back."""
    return 1 - 4 * np.abs(t - np.round(t))


def sawtooth(t: Floats) -> Floats:
    """From 1 at t = 0 to -1 at 1: Σ (2/πh) sin(2πht)."""
    return 1 - 2 * (t - np.floor(t))


def square(t: Floats, duty: float = 0.5) -> Floats:
    """1 where t is within duty/2 of a whole number, else -1."""
    return np.where(np.abs(t - np.round(t)) < duty / 2, 1.0, -1.0)


# pwm and symmetric have no waveform but their rank, which is the triangle's; so is cyclic's the sawtooth's.
WAVES: dict[str, Waveform] = {
    "pwm": triangle,
    "symmetric": triangle,
    "cyclic": sawtooth,
    "sine": sine,
    "triangle": triangle,
    "sawtooth": sawtooth,
    "square": square,
}


class Shape(BaseModel):
    """Base of waveforms with parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    def waves(self) -> tuple[Waveform, ...]:
        """One waveform, or the two that a field blends."""
        raise NotImplementedError

    def axes(self) -> list[float]:
        """Shares of a turn about which the waveform may be even, 0 first."""
        return [0.0]


class SquareShape(Shape):
    """A square wave."""

    square: Annotated[Number, Field(gt=0, lt=1)] = Field(description="share of a turn that it is high: its duty")

    def waves(self) -> tuple[Waveform, ...]:
        """The square wave with this duty."""
        return (lambda t: square(t, self.square),)


class TableShape(Shape):
    """A waveform by its values, evenly spread over a turn, with straight lines between them."""

    table: tuple[Highest, ...] = Field(
        min_length=2, max_length=MAX_SAMPLES, description="values over a period, the first one at its start"
    )

    @model_validator(mode="after")
    def _not_constant(self) -> TableShape:
        if min(self.table) == max(self.table):
            raise ValueError(f"all {len(self.table)} values are {self.table[0]:g}: none is above another")
        return self

    def waves(self) -> tuple[Waveform, ...]:
        """Linear between the values, and from the last one to the first."""
        values = np.array([*self.table, self.table[0]])
        place = np.arange(len(values)) / len(self.table)
        return (lambda t: np.interp(np.asarray(t) % 1, place, values),)

    def axes(self) -> list[float]:
        """At a value, or halfway between two."""
        return [k / (2 * len(self.table)) for k in range(2 * len(self.table))]


class Harmonic(BaseModel):
    """One sine of a sum."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    amplitude: Highest = Field(description="of amplitude·cos(h ϕ + phase)")
    phase: Number = Field(default=0.0, description="degrees; -90 makes it a sine")


class HarmonicsShape(Shape):
    """Additive synthesis (Tricard et al. 2019, Fig. 13): Σ amplitude_h cos(h ϕ + phase_h), h = 1, 2, …"""

    harmonics: tuple[Harmonic, ...] = Field(
        min_length=1, max_length=MAX_HARMONICS,
        description="amplitudes of the first, second, … harmonic, or {amplitude, phase} each",
    )  # fmt: skip

    @model_validator(mode="before")
    @classmethod
    def _bare_amplitudes(cls, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(value.get("harmonics"), list | tuple):
            bare = [{"amplitude": v} if not isinstance(v, dict | Harmonic) else v for v in value["harmonics"]]
            return {**value, "harmonics": bare}
        return value

    @model_validator(mode="after")
    def _not_constant(self) -> HarmonicsShape:
        if not any(harmonic.amplitude for harmonic in self.harmonics):
            raise ValueError("all amplitudes are 0: no part of the turn is above another")
        return self

    def waves(self) -> tuple[Waveform, ...]:
        """The sum."""

        def wave(t: Floats) -> Floats:
            terms = enumerate(self.harmonics, 1)
            return np.asarray(sum(a.amplitude * np.cos(2 * np.pi * h * t + np.deg2rad(a.phase)) for h, a in terms))

        return (wave,)

    def axes(self) -> list[float]:
        """Where the strongest harmonic is even."""
        h, strongest = max(enumerate(self.harmonics, 1), key=lambda pair: abs(pair[1].amplitude))
        return [0.0, *((k / 2 - strongest.phase / 360) / h % 1 for k in range(2 * h))]


def _wave_kind(value: Any) -> str | None:
    if isinstance(value, str):
        return "name"
    if isinstance(value, Shape):
        return next(key for key, kind in SHAPES.items() if isinstance(value, kind))
    named = [key for key in SHAPES if isinstance(value, dict) and key in value]
    return named[0] if len(named) == 1 else None


WaveName = Literal[tuple(WAVES)]  # type: ignore[valid-type]

if TYPE_CHECKING:
    PlainWave = str | Shape
else:
    PlainWave = Annotated[
        Annotated[WaveName, Tag("name")]
        | Annotated[SquareShape, Tag("square")]
        | Annotated[TableShape, Tag("table")]
        | Annotated[HarmonicsShape, Tag("harmonics")],
        Discriminator(
            _wave_kind, custom_error_type="waveform",
            custom_error_message=f"is no waveform; one is {', '.join(WAVES)}, {{square: duty}}, {{table: [...]}} or "
            "{harmonics: [...]}",
        ),
    ]  # fmt: skip


class Blend(BaseModel):
    """Two waveforms and a field."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    start: PlainWave = Field(alias="from", description="where the field is 0")
    end: PlainWave = Field(alias="to", description="where the field is 1")
    by: FieldSpec = Field(description="0 to 1; a field")


class BlendShape(Shape):
    """From one waveform to another, as a field says (Tricard et al. 2019, Figs 1 and 15)."""

    blend: Blend = Field(description="{from: WAVEFORM, to: WAVEFORM, by: FIELD}")

    def waves(self) -> tuple[Waveform, ...]:
        """Both."""
        return *waves_of(self.blend.start), *waves_of(self.blend.end)

    def axes(self) -> list[float]:
        """Those of either."""
        ends = self.blend.start, self.blend.end
        return [axis for end in ends for axis in ([0.0] if isinstance(end, str) else end.axes())]


SHAPES: dict[str, type[Shape]] = {
    "square": SquareShape,
    "table": TableShape,
    "harmonics": HarmonicsShape,
    "blend": BlendShape,
}

if TYPE_CHECKING:
    ProfileSpec = str | Shape
else:
    union = Annotated[WaveName, Tag("name")]
    for _name, _kind in SHAPES.items():
        union = union | Annotated[_kind, Tag(_name)]
    ProfileSpec = Annotated[
        union,
        Discriminator(
            _wave_kind,
            custom_error_type="profile",
            custom_error_message=f"is no profile; one is {', '.join(WAVES)}, "
            + ", ".join(f"{{{name}: …}}" for name in SHAPES),
        ),
    ]


def waves_of(spec: str | Shape) -> tuple[Waveform, ...]:
    """The waveforms that a specification names."""
    return (WAVES[spec],) if isinstance(spec, str) else spec.waves()
