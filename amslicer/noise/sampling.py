"""Noises at any points, by their parameters alone: the references' definitions under the noises' names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard, cast

import numpy as np

from amslicer import planereference, reference, wavereference
from amslicer.errors import UsageError
from amslicer.exemplar import MIN_SIDE, periodic_component
from amslicer.noise import NOISES
from amslicer.noise.example import WaveByExample
from amslicer.noise.gabor import Gabor, IsotropicGabor
from amslicer.noise.hyperplanes import DEPTH, PROBABILITY
from amslicer.noise.hyperplanes import DIRECTIONS as FAMILIES
from amslicer.noise.lobes import MOST as MAX_LOBES
from amslicer.noise.phacelle import Phacelle, SimplePhacelle
from amslicer.noise.phasor import Phasor
from amslicer.noise.setting import Setting
from amslicer.noise.spectra import Directional, Spectrum, SpectrumSpec, Waveform, describe_spectra, make_spectrum
from amslicer.noise.textures import AsymptoticSpot, RandomPhase
from amslicer.noise.waves import MAX_DIRECTIONS, Wave
from amslicer.randomphase import sample_bilinear
from amslicer.specification import MAX_DEPTH, MAX_SEED, MIN_DIRECTIONS, Pattern

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from amslicer.reference import Scalar

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

SAMPLED = 17  # per axis of the points' box where a function's bounds are looked for
ROOM = 1.25  # that the bounds get beyond what was seen
ONE_NUMBER = "give one number"


@dataclass(frozen=True)
class Asked:
    """What `sample` was asked for, checked.

    Attributes:
        at: x, y, z, which broadcast.
        period: as given; of_place: as a function of (N, 3) places, within the bounds.
        normal: (N, 3) places to (N, 3) unit normals.
        of_noise: what means something to some noises only; None where it was left out.
    """

    name: str
    at: tuple[ArrayLike, ArrayLike, ArrayLike]
    period: Scalar
    of_place: Callable[[Floats], Floats]
    bounds: tuple[float, float]
    bandwidth: float
    normal: Callable[[Floats], Floats]
    isotropy: Scalar
    seed: int
    dimensions: int
    turns: bool
    of_noise: Mapping[str, Any]

    def of(self, key: str, default: Any) -> Any:
        """What was given, or a default."""
        return default if self.of_noise[key] is None else self.of_noise[key]

    @property
    def one_period(self) -> float:
        """The period of noises that have only one.

        Raises:
            UsageError: it is a function.
        """
        if callable(self.period):
            said = f"period is {self.period!r}; that of {self.name} is one number"
            raise UsageError(said, hint="sample one period at a time")
        return float(self.period)


def sample(
    name: str, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: Scalar, bandwidth: float, orientation: Scalar,
    elevation: Scalar, isotropy: Scalar, seed: int, dimensions: int | None, of_noise: Mapping[str, Any],
) -> Complexes:  # fmt: skip
    """As amslicer.noise.sample says; of_noise: what means something to some noises only, None where it is left out."""
    if name not in NOISES:
        raise UsageError(f"there is no noise '{name}'", hint=f"there are: {', '.join(NOISES)}")
    if dimensions is None:
        flat = np.ndim(z) == 0 and z == 0 and not callable(elevation) and elevation == 0
        dimensions = 2 if flat else 3
    for key, value, paintable, accepted, said in (
        ("period", period, True, lambda v: 0 < v < np.inf, "greater than 0 mm"),
        ("bandwidth", bandwidth, False, lambda v: 0 < v <= 2, "above 0 up to 2"),
        ("orientation", orientation, True, np.isfinite, "degrees"),
        ("elevation", elevation, True, np.isfinite, "degrees"),
        ("isotropy", isotropy, True, lambda v: 0 <= v <= 1, "between 0 and 1"),
        ("seed", seed, False, lambda v: _is_whole(v, 0, MAX_SEED), "a whole number from 0 to 2^64 - 1"),
        ("dimensions", dimensions, False, lambda v: v in (2, 3), "2 or 3"),
    ):
        if paintable and callable(value):
            continue
        if not isinstance(value, Real) or not accepted(value):
            hint = "give a number, or a function of (N, 3) places" if paintable else ONE_NUMBER
            raise UsageError(f"{key} is {value!r}; it is {said}", hint=hint)
    _check_of_noise(name, of_noise)
    shape = np.broadcast_shapes(*(np.shape(c) for c in (x, y, z)))
    points = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1).reshape(-1, 3)
    if not len(points):
        return np.zeros(shape, np.complex128)
    bounds = _bounds(period, points) if callable(period) else (float(period), float(period))

    def normal(places: Floats) -> Floats:
        azimuth, tilt = (np.deg2rad(v(places) if callable(v) else v) for v in (orientation, elevation))
        azimuth, tilt = (np.broadcast_to(v, len(places)) for v in (azimuth, tilt))
        return np.stack([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)], axis=-1)

    def clipped(places: Floats) -> Floats:
        return np.clip(period(places), *bounds) if callable(period) else np.full(len(places), period)

    asked = Asked(
        name, (x, y, z), period, clipped, bounds, bandwidth, normal, isotropy, seed, dimensions,
        callable(orientation) or callable(elevation), of_noise,
    )  # fmt: skip
    return SAMPLERS[name](asked)


def _phasor(asked: Asked) -> Complexes:
    default = {"phasor": Phasor, "gabor": Gabor}[asked.name].impulses
    return reference.phasor(
        *asked.at, period=asked.of_place, bandwidth=asked.bandwidth, dimensions=asked.dimensions, seed=asked.seed,
        normal=asked.normal, isotropy=asked.isotropy, impulses=asked.of("impulses", default), periods=asked.bounds,
        lobes=asked.of("lobes", ()),
    )  # fmt: skip


def _isotropic_gabor(asked: Asked) -> Complexes:
    return reference.isotropic_gabor(
        *asked.at, period=asked.one_period, bandwidth=asked.bandwidth, dimensions=asked.dimensions, seed=asked.seed,
        impulses=asked.of("impulses", IsotropicGabor.impulses),
    )  # fmt: skip


def _phacelle(asked: Asked) -> Complexes:
    kind = {"phacelle": Phacelle, "phacelle-simple": SimplePhacelle}[asked.name]
    noise = kind(
        periods_mm=asked.bounds, bandwidth=asked.bandwidth, dimensions=asked.dimensions, seed=asked.seed
    )  # fmt: skip
    return reference.phacelle(
        *asked.at, period=asked.of_place, side_mm=noise.side_mm, dimensions=asked.dimensions, seed=asked.seed,
        normal=asked.normal, isotropy=asked.isotropy, lobes=asked.of("lobes", ()), simple=noise.at_nodes,
    )  # fmt: skip


def _wave(asked: Asked) -> Complexes:
    spectrum = _spectrum(asked.of("spectrum", "laminate"))
    wave = Wave(
        asked.bounds, asked.bandwidth, asked.dimensions, asked.seed, asked.of("directions", 0), spectrum,
        time=asked.of("time", 0.0), fourth=asked.of("fourth", 0.0),
    )  # fmt: skip
    return sampled_wave(wave, asked)


def sampled_wave(wave: Wave, asked: Asked) -> Complexes:
    """The reference's definition of a wave noise."""
    spectrum, b = wave.spectrum, wave.bandwidth
    form = isinstance(spectrum, Waveform)
    return wavereference.wave(
        *asked.at, period=asked.of_place, bandwidth=b, dimensions=wave.dimensions, seed=wave.seed, normal=asked.normal,
        isotropy=asked.isotropy, directions=wave.directions, length_mm=wave.length_mm, samples=wave.samples,
        periods=wave.table_periods_mm, time=wave.time, fourth=wave.fourth, table=wave.tables[0] if form else None,
        amplitude=lambda f: cast("Spectrum", spectrum).amplitude(f, b),
        band=(0.0, 0.0) if form else cast("Spectrum", spectrum).band(b),
        along=(lambda d, f: cast("Directional", spectrum).amplitude_along(d, f, b)) if wave.by_part else None,
        fading=asked.turns,
        rise=(getattr(spectrum, "dimensions", wave.dimensions) - 1) / 2,
    )  # fmt: skip


def _by_example(asked: Asked) -> Complexes:
    pattern = _pattern(asked, directions=asked.of("directions", None), planes=tuple(asked.of("planes", ("xy",))))
    pattern = pattern.model_copy(update={"time": asked.of("time", 0.0), "fourth": asked.of("fourth", 0.0)})
    return sampled_wave(WaveByExample.of_pattern(pattern, _setting(asked)), asked)


def _texture(asked: Asked) -> Complexes:
    """Of the size that the points' box from 0 on asks for, as of a part."""
    kind = {"random-phase": RandomPhase, "asymptotic-spot": AsymptoticSpot}[asked.name]
    noise = kind.of_pattern(_pattern(asked), _setting(asked))
    x, y, z = (np.asarray(c, np.float64) for c in np.broadcast_arrays(*asked.at))
    values = np.empty(z.shape)
    for height in np.unique(z) if asked.dimensions == 3 else (0.0,):
        here = (z == height) | (asked.dimensions == 2)
        step, share = noise.place(float(height))
        low, high = (
            sample_bilinear(
                noise.texture(step + up).astype(np.float64), x[here] / noise.pixel_mm, y[here] / noise.pixel_mm
            )
            for up in ((0, 1) if share else (0, 0))
        )
        values[here] = low + share * (high - low)
    return values.astype(np.complex128)


def _pattern(asked: Asked, **keys: Any) -> Pattern:
    given = {"bandwidth": asked.bandwidth, "dimensions": asked.dimensions, "seed": asked.seed, **keys}
    return Pattern.model_validate({"noise": asked.name, **{k: v for k, v in given.items() if v is not None}})


def _setting(asked: Asked) -> Setting:
    """Raises UsageError where there is no exemplar that can be imitated."""
    picture = asked.of("exemplar", None)
    if picture is None:
        raise UsageError(f"{asked.name} imitates a picture, and exemplar is None", hint="give an array of its values")
    picture = np.asarray(picture, np.float64)
    wrong = picture.ndim != 2 or min(picture.shape) < MIN_SIDE or not np.isfinite(picture).all()
    if wrong or (picture == picture.flat[0]).all():
        said = f"exemplar has the shape {picture.shape}; it is (rows, columns) of {MIN_SIDE} or more, and not constant"
        raise UsageError(said, hint="row 0 is the lowest; of colours give the brightness")
    size = [float(np.max(c, initial=0.0)) for c in asked.at[:2]]
    return Setting(
        asked.bounds if asked.name == "wave-by-example" else (asked.one_period,) * 2, size_mm=(size[0], size[1]),
        exemplar=periodic_component(picture), pixel_mm=asked.of("exemplar_pixel_mm", 1.0),
    )  # fmt: skip


def _cells(asked: Asked) -> Complexes:
    value, _ = planereference.values(
        asked.name.removeprefix("wave-"), *asked.at, period=asked.one_period, dimensions=asked.dimensions,
        seed=asked.seed, directions=asked.of("directions", FAMILIES), probability=asked.of("probability", PROBABILITY),
        depth=asked.of("depth", DEPTH),
    )  # fmt: skip
    return value.astype(np.complex128)


SAMPLERS: dict[str, Callable[[Asked], Complexes]] = {
    "phasor": _phasor, "gabor": _phasor, "gabor-isotropic": _isotropic_gabor, "phacelle": _phacelle,
    "phacelle-simple": _phacelle, "wave": _wave, "wave-cellular": _cells, "wave-polytope": _cells, "wave-stit": _cells,
    "wave-by-example": _by_example, "random-phase": _texture, "asymptotic-spot": _texture,
}  # fmt: skip


def _check_of_noise(name: str, of_noise: Mapping[str, Any]) -> None:
    """Whether each means something to the noise, and is in its range."""
    kind = NOISES[name]
    for key, value in of_noise.items():
        if value is None or (key == "lobes" and not value):
            continue
        if key not in kind.keys:
            raise UsageError(f"{key} is {value!r}, which means nothing to {name}", hint="leave it out")
        if key in NUMBERS:
            accepted, said = NUMBERS[key]
            if not isinstance(value, Real) or isinstance(value, bool) or not accepted(value):
                raise UsageError(f"{key} is {value!r}; it is {said}", hint=ONE_NUMBER)
    if of_noise["lobes"]:
        _check_lobes(of_noise["lobes"])


def _is_whole(value: object, low: int, high: int) -> TypeGuard[int]:
    return isinstance(value, Integral) and low <= int(value) <= high


NUMBERS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "impulses": (lambda v: 0 < v < np.inf, "greater than 0"),
    "directions": (
        lambda v: _is_whole(v, MIN_DIRECTIONS, MAX_DIRECTIONS),
        f"a whole number from {MIN_DIRECTIONS} to {MAX_DIRECTIONS}",
    ),
    "time": (lambda v: bool(np.isfinite(v)), "a number of periods"),
    "fourth": (lambda v: bool(np.isfinite(v)), "a number of periods"),
    "probability": (lambda v: 0 <= v <= 1, "between 0 and 1"),
    "exemplar_pixel_mm": (lambda v: 0 < v < np.inf, "greater than 0 mm"),
    "depth": (lambda v: _is_whole(v, 0, MAX_DEPTH), f"a whole number from 0 to {MAX_DEPTH}"),
}


def _spectrum(spec: object) -> Spectrum | Directional | Waveform:
    """A spectrum as the job file writes it.

    Raises:
        UsageError: it is none.
    """
    from pydantic import TypeAdapter, ValidationError

    try:
        return make_spectrum(TypeAdapter(SpectrumSpec).validate_python(spec))
    except ValidationError as error:
        said = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise UsageError(f"spectrum is {spec!r}: {said}", hint=f"there are: {describe_spectra()}") from None


def _check_lobes(lobes: object) -> None:
    said = f"lobes are {lobes!r}; they are up to {MAX_LOBES} pairs of (degrees, weight above 0)"
    hint = "for example [(0, 1), (90, 1)]"
    if not isinstance(lobes, Sequence) or len(lobes) > MAX_LOBES:
        raise UsageError(said, hint=hint)
    for lobe in lobes:
        if not isinstance(lobe, Sequence) or len(lobe) != 2 or not all(isinstance(v, Real) for v in lobe):
            raise UsageError(said, hint=hint)
        if not np.isfinite(lobe[0]) or not 0 < lobe[1] < np.inf:
            raise UsageError(said, hint=hint)


def _bounds(period: object, points: Floats) -> tuple[float, float]:
    """The shortest and longest period in the points' box, with some room."""
    assert callable(period)
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.linspace(a, b, SAMPLED if b > a else 1) for a, b in zip(low, high, strict=True)]
    seen = np.asarray(period(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)))
    if not np.min(seen) > 0:
        raise UsageError(f"period falls to {np.min(seen):.3g} mm; it is greater than 0 mm", hint="clip the function")
    return float(np.min(seen)) / ROOM, float(np.max(seen)) * ROOM
