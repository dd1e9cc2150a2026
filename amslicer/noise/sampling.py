"""Noises at any points, by their parameters alone: the reference in amslicer/reference.py under the noises' names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer import reference, wavereference
from amslicer.errors import UsageError
from amslicer.noise import NOISES
from amslicer.noise.gabor import Gabor, IsotropicGabor
from amslicer.noise.lobes import MOST as MAX_LOBES
from amslicer.noise.phacelle import Phacelle, SimplePhacelle
from amslicer.noise.phasor import Phasor
from amslicer.noise.spectra import Spectrum, SpectrumSpec, Waveform, describe_spectra, make_spectrum
from amslicer.noise.waves import Wave
from amslicer.specification import MAX_DIRECTIONS, MAX_SEED, MIN_DIRECTIONS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from amslicer.reference import Lobes, Scalar

    Floats = NDArray[np.float64]

SAMPLED = 17  # per axis of the points' box where a function's bounds are looked for
ROOM = 1.25  # that the bounds get beyond what was seen
COUNTED = f"a whole number from {MIN_DIRECTIONS} to {MAX_DIRECTIONS}"
KERNEL_NOISES = {
    "phasor": Phasor, "gabor": Gabor, "gabor-isotropic": IsotropicGabor, "phacelle": Phacelle,
    "phacelle-simple": SimplePhacelle,
}  # fmt: skip


def sample(
    name: str, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, period: Scalar, bandwidth: float, orientation: Scalar,
    elevation: Scalar, isotropy: Scalar, seed: int, dimensions: int | None, impulses: float | None, lobes: Lobes,
    directions: int | None, spectrum: object, time: float, fourth: float,
) -> NDArray[np.complex128]:  # fmt: skip
    """As amslicer.noise.sample says."""
    if name not in NOISES:
        raise UsageError(f"there is no noise '{name}'", hint=f"there are: {', '.join(NOISES)}")
    if dimensions is None:
        flat = np.ndim(z) == 0 and z == 0 and not callable(elevation) and elevation == 0
        dimensions = 2 if flat else 3
    if name.startswith("phacelle") and impulses is not None:
        raise UsageError(f"impulses is {impulses}, but {name} has one splat per cell", hint="leave it out")
    for key, value, paintable, accepted, said in (
        ("period", period, True, lambda v: 0 < v < np.inf, "greater than 0 mm"),
        ("bandwidth", bandwidth, False, lambda v: 0 < v <= 2, "above 0 up to 2"),
        ("orientation", orientation, True, np.isfinite, "degrees"),
        ("elevation", elevation, True, np.isfinite, "degrees"),
        ("isotropy", isotropy, True, lambda v: 0 <= v <= 1, "between 0 and 1"),
        ("seed", seed, False, _is_seed, "a whole number from 0 to 2^64 - 1"),
        ("dimensions", dimensions, False, lambda v: v in (2, 3), "2 or 3"),
        ("impulses", 1.0 if impulses is None else impulses, False, lambda v: 0 < v < np.inf, "greater than 0"),
        ("directions", MIN_DIRECTIONS if directions is None else directions, False, _is_count, COUNTED),
        ("time", time, False, np.isfinite, "a number of periods"),
        ("fourth", fourth, False, np.isfinite, "a number of periods"),
    ):
        if paintable and callable(value):
            continue
        if not isinstance(value, Real) or not accepted(value):
            hint = "give a number, or a function of (N, 3) places" if paintable else "give one number"
            raise UsageError(f"{key} is {value!r}; it is {said}", hint=hint)
    kind = NOISES[name]
    if lobes and "lobes" not in kind.keys:
        has = "reads its direction at each point" if name != "gabor-isotropic" else "has no direction"
        raise UsageError(f"lobes are {lobes!r}, but {name} {has}", hint="leave them out")
    _check_lobes(lobes)
    points = np.stack(np.broadcast_arrays(*(np.asarray(c, np.float64) for c in (x, y, z))), axis=-1).reshape(-1, 3)
    if not len(points):
        return np.zeros(np.broadcast_shapes(*(np.shape(c) for c in (x, y, z))), np.complex128)
    periods = _bounds(period, points) if callable(period) else (float(period), float(period))
    given: dict[str, Any] = {} if impulses is None else {"impulses": impulses}
    if kind is not Wave and (directions, spectrum, time, fourth) != (None, "laminate", 0.0, 0.0):
        raise UsageError(
            f"directions, spectrum, time and fourth mean nothing to {name}", hint="leave them out, or sample wave"
        )
    if kind is Wave and impulses is not None:
        raise UsageError(f"impulses is {impulses}, but {name} has directions", hint="leave it out")

    def normal(places: Floats) -> Floats:
        azimuth, tilt = (np.deg2rad(v(places) if callable(v) else v) for v in (orientation, elevation))
        azimuth, tilt = (np.broadcast_to(v, len(places)) for v in (azimuth, tilt))
        return np.stack([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)], axis=-1)

    def clipped(places: Floats) -> Floats:
        return np.clip(period(places), *periods) if callable(period) else np.full(len(places), period)

    if kind is Wave:
        wave = Wave(
            periods, bandwidth, dimensions, seed, directions or 0, _spectrum(spectrum), time=time, fourth=fourth
        )
        return _sampled_wave(wave, (x, y, z), clipped, normal, isotropy)
    noise = KERNEL_NOISES[name](periods_mm=periods, bandwidth=bandwidth, dimensions=dimensions, seed=seed, **given)
    if isinstance(noise, Phacelle):
        return reference.phacelle(
            x, y, z, period=clipped, side_mm=noise.side_mm, dimensions=dimensions, seed=seed, normal=normal,
            isotropy=isotropy, lobes=lobes, simple=noise.at_nodes,
        )  # fmt: skip
    if isinstance(noise, IsotropicGabor):
        if callable(period):
            raise UsageError(f"period is {period!r}; that of {name} is one number", hint="sample one period at a time")
        return reference.isotropic_gabor(
            x, y, z, period=float(period), bandwidth=bandwidth, dimensions=dimensions, seed=seed,
            impulses=noise.impulses,
        )  # fmt: skip
    return reference.phasor(
        x, y, z, period=clipped, bandwidth=bandwidth, dimensions=dimensions, seed=seed, normal=normal,
        isotropy=isotropy, impulses=noise.impulses, periods=periods, lobes=lobes,
    )  # fmt: skip


def _sampled_wave(
    wave: Wave, at: tuple[ArrayLike, ArrayLike, ArrayLike], period: Callable[[Floats], Floats],
    normal: Callable[[Floats], Floats], isotropy: Scalar,
) -> NDArray[np.complex128]:  # fmt: skip
    form = isinstance(wave.spectrum, Waveform)
    return wavereference.wave(
        *at, period=period, bandwidth=wave.bandwidth, dimensions=wave.dimensions, seed=wave.seed, normal=normal,
        isotropy=isotropy, directions=wave.directions, length_mm=wave.length_mm, samples=wave.samples,
        periods=wave.table_periods_mm, table=wave.tables[0] if form else None, time=wave.time, fourth=wave.fourth,
        amplitude=lambda f: wave.spectrum.amplitude(f, wave.bandwidth),  # type: ignore[union-attr]
        band=(0.0, 0.0) if isinstance(wave.spectrum, Waveform) else wave.spectrum.band(wave.bandwidth),
    )  # fmt: skip


def _spectrum(spec: object) -> Spectrum | Waveform:
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


def _is_count(value: object) -> bool:
    return isinstance(value, Integral) and MIN_DIRECTIONS <= int(value) <= MAX_DIRECTIONS


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


def _is_seed(value: object) -> bool:
    return isinstance(value, Integral) and 0 <= int(value) <= MAX_SEED


def _bounds(period: object, points: Floats) -> tuple[float, float]:
    """The shortest and longest period in the points' box, with some room."""
    assert callable(period)
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.linspace(a, b, SAMPLED if b > a else 1) for a, b in zip(low, high, strict=True)]
    seen = np.asarray(period(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)))
    if not np.min(seen) > 0:
        raise UsageError(f"period falls to {np.min(seen):.3g} mm; it is greater than 0 mm", hint="clip the function")
    return float(np.min(seen)) / ROOM, float(np.max(seen)) * ROOM
