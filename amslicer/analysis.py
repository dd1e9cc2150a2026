"""Measures laminates: direction, period, spectra, autocovariance, local ratio, singularities.

For arrays from anywhere – layers of a stack, G of `amslicer.field` or `amslicer.noise.sample`, pictures of other
programs: nothing here knows what made them, which is why the tests can judge by it.

Arrays are bitmaps, (H, W) with row 0 at the largest y, or blocks of them, (L, H, W) with layer 0 lowest. A
`pitch_mm` is (x, y) or (x, y, z), so pixels need not be square. Angles are degrees from +x towards +y; directions are
lines, 0° = 180°. A laminate's field is anything that oscillates along its normal: labels made ±1 by `signed`, or
the sine of the phase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal.windows import tukey

Floats = NDArray[np.float64]
Pitch = tuple[float, float]
Pitch3 = tuple[float, float, float]

SMOOTHING = 0.1  # periods: of the derivative, wide enough to see across a pixel's staircase
WINDOW = 1.5  # periods: the structure tensor's Gaussian window
BAND = (0.6, 1.4)  # carriers: where the period's power is looked for
# Of each side falls to zero in a spectrum; a Hann window throws away so much that seeds scatter twice as far.
TAPER = 0.25
DECADES = 3.0  # of power that a picture of a spectrum shows


def signed(labels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """+1 in the first material, -1 in the others, 0 where nothing is."""
    return np.where(labels == 1, 1, np.where(labels == 0, 0, -1)).astype(np.float32)


def phase_sine(g: NDArray[np.complex64]) -> Floats:
    """sin arg G: the laminate's wave at full contrast."""
    return np.sin(np.angle(g))


def inner(shape: tuple[int, int], pitch_mm: Pitch, border_mm: float) -> tuple[slice, slice]:
    """The window that leaves out a border on each side."""
    rows, columns = int(np.ceil(border_mm / pitch_mm[1])), int(np.ceil(border_mm / pitch_mm[0]))
    return slice(rows, shape[0] - rows), slice(columns, shape[1] - columns)


# --- direction ---------------------------------------------------------------------------------------------


def gradient(field: Floats, pitch_mm: Pitch, smooth_mm: float) -> tuple[Floats, Floats]:
    """Derivatives per mm along x and y (up)."""
    sigma = smooth_mm / pitch_mm[1], smooth_mm / pitch_mm[0]
    along_x = ndimage.gaussian_filter(field, sigma, order=(0, 1), mode="nearest") / pitch_mm[0]
    along_y = -ndimage.gaussian_filter(field, sigma, order=(1, 0), mode="nearest") / pitch_mm[1]
    return along_x, along_y


def line_direction(xx: Floats, xy: Floats, yy: Floats) -> Floats:
    """Degrees of the strongest direction of 2 x 2 tensors."""
    return np.rad2deg(0.5 * np.arctan2(2 * xy, xx - yy)) % 180


def directions(field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float) -> Floats:
    """The local normal at each pixel, degrees: structure tensor with a Gaussian window of 1.5 periods."""
    gx, gy = gradient(np.asarray(field, np.float64), pitch_mm, SMOOTHING * period_mm)
    sigma = WINDOW * period_mm / pitch_mm[1], WINDOW * period_mm / pitch_mm[0]
    tensor = (ndimage.gaussian_filter(p, sigma, mode="nearest", truncate=3) for p in (gx * gx, gx * gy, gy * gy))
    return line_direction(*tensor)


def mean_direction(field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float) -> float:
    """The one normal of a whole bitmap, its outermost period left out, degrees."""
    gx, gy = gradient(np.asarray(field, np.float64), pitch_mm, SMOOTHING * period_mm)
    part = inner(gx.shape, pitch_mm, period_mm)
    gx, gy = gx[part], gy[part]
    return float(line_direction((gx * gx).mean(), (gx * gy).mean(), (gy * gy).mean()))


def line_error(a_deg: Floats | float, b_deg: Floats | float) -> Floats:
    """Angle between lines, 0 to 90 degrees."""
    return np.asarray(np.abs((np.asarray(a_deg) - np.asarray(b_deg) + 90) % 180 - 90))


def normal(azimuth_deg: Floats | float, elevation_deg: Floats | float) -> Floats:
    """(..., 3) unit vectors."""
    a, e = np.broadcast_arrays(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)


def normal_error(a: Floats, b: Floats) -> Floats:
    """Angle between lines in space, degrees, of (..., 3) unit vectors."""
    return np.asarray(np.rad2deg(np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))))


def line_mean(normals: Floats, weights: Floats) -> Floats:
    """The mean line of (N, 3) unit vectors."""
    return np.linalg.eigh(np.einsum("n,ni,nj->ij", weights, normals, normals))[1][:, -1]


def gradient_3d(field: NDArray[np.floating], pitch_mm: Pitch3, smooth_mm: float) -> Floats:
    """(3, L, H, W) derivatives per mm along x, y (up) and z (up)."""
    block = np.asarray(field, np.float32)
    sigma = tuple(smooth_mm / p for p in pitch_mm[::-1])
    out = []
    for axis, sign in ((2, 1), (1, -1), (0, 1)):
        order = tuple(int(a == axis) for a in range(3))
        derivative = ndimage.gaussian_filter(block, sigma, order=order, mode="nearest", truncate=3)
        out.append(derivative * (sign / pitch_mm[2 - axis]))
    return np.stack(out)


def normal_of_block(
    field: NDArray[np.floating], weights: NDArray[np.floating], pitch_mm: Pitch3, period_mm: float
) -> Floats:
    """The normal of a block: the strongest direction of its weighted 3-D structure tensor."""
    g = gradient_3d(field, pitch_mm, SMOOTHING * period_mm).reshape(3, -1)
    return np.linalg.eigh(g @ (g * np.ravel(weights)).T)[1][:, -1]


def normal_from_cuts(field: NDArray[np.floating], pitch_mm: Pitch3, period_mm: float) -> Floats:
    """The normal of a block from three plane pictures alone: its middle xy, xz and yz cuts.

    The stripes of a cut run within the laminate's sheets, so the normal is perpendicular to all three of them; a cut
    counts by how much stronger its gradient is across its stripes than along. Its outermost half period is left out.
    """
    middle = [n // 2 for n in field.shape]
    cuts = (  # picture with row 0 at the top, axis across, axis up
        (field[middle[0]], 0, 1),
        (field[::-1, middle[1], :], 0, 2),
        (field[::-1, ::-1, middle[2]], 1, 2),
    )
    stripes = np.zeros((3, 3))
    for cut, across, up in cuts:
        pitch = pitch_mm[across], pitch_mm[up]
        part = inner(cut.shape, pitch, period_mm / 2)
        g = [d[part] for d in gradient(np.asarray(cut, np.float64), pitch, SMOOTHING * period_mm)]
        strength, axes = np.linalg.eigh(np.array([[(a * b).mean() for b in g] for a in g]))
        along = np.zeros(3)
        along[[across, up]] = axes[:, 0]
        stripes += (strength[1] - strength[0]) * np.outer(along, along)
    return np.linalg.eigh(stripes)[1][:, 0]


# --- spectrum ----------------------------------------------------------------------------------------------


def power(field: NDArray[np.floating], pitch_mm: Pitch) -> tuple[Floats, Floats]:
    """Power spectrum under a window, the mean removed, and its frequencies |f| per mm."""
    rows, columns = field.shape
    window = tukey(rows, TAPER)[:, None] * tukey(columns, TAPER)[None, :]
    values = np.asarray(field, np.float64)
    values = values - (values * window).sum() / window.sum()
    fy, fx = np.fft.fftfreq(rows, pitch_mm[1]), np.fft.rfftfreq(columns, pitch_mm[0])
    spectrum = np.abs(np.fft.rfft2(values * window)) ** 2
    mirrored = slice(1, (columns + 1) // 2)  # columns whose mirror image rfft2 leaves out
    spectrum[:, mirrored] *= 2
    return spectrum, np.hypot(fy[:, None], fx[None, :])


def power_map(field: NDArray[np.floating]) -> Floats:
    """(H, W) power under a Hann window, the mean removed, frequency 0 in the middle: a spectrum to look at."""
    values = np.asarray(field, np.float64)
    window = np.hanning(values.shape[0])[:, None] * np.hanning(values.shape[1])
    centred = values - np.sum(values * window) / np.sum(window)
    return np.asarray(np.abs(np.fft.fftshift(np.fft.fft2(centred * window))) ** 2)


def decades(power: Floats) -> Floats:
    """Logarithms to the base 10 of powers as shares of the most, -12 at the least."""
    return np.asarray(np.log10(np.maximum(power / max(float(power.max()), np.finfo(float).tiny), 1e-12)))


def measured_period(field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float) -> float:
    """1 / centroid of the power within 0.6 to 1.4 carriers of an expected period, mm."""
    spectrum, frequency = power(field, pitch_mm)
    band = (frequency > BAND[0] / period_mm) & (frequency < BAND[1] / period_mm)
    return float(spectrum[band].sum() / (spectrum[band] * frequency[band]).sum())


def low_variance_share(field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float) -> float:
    """Spectrum of variance: share of the energy of field² (mean removed) below half the carrier."""
    spectrum, frequency = power(np.asarray(field, np.float64) ** 2, pitch_mm)
    return float(spectrum[frequency < 0.5 / period_mm].sum() / spectrum.sum())


def radial_power(field: NDArray[np.floating], pitch_mm: Pitch, bins: int = 64) -> tuple[Floats, Floats]:
    """Mean power spectral density in rings of frequency up to the coarser pitch's Nyquist frequency.

    Returns:
        (bins,) middles of the rings, cycles per mm; (bins,) density, in the field's unit² mm².
    """
    spectrum, frequency = power(field, pitch_mm)
    rows, columns = field.shape
    window = tukey(rows, TAPER)[:, None] * tukey(columns, TAPER)[None, :]
    edges = np.linspace(0.0, 0.5 / max(pitch_mm), bins + 1)
    mirrored = np.ones_like(frequency)
    mirrored[:, 1 : (columns + 1) // 2] = 2
    total = np.histogram(frequency, edges, weights=spectrum)[0]
    count = np.histogram(frequency, edges, weights=mirrored)[0]
    density = total / np.maximum(count, 1) * (pitch_mm[0] * pitch_mm[1]) / np.sum(window**2)
    return (edges[:-1] + edges[1:]) / 2, density


def angular_power(
    field: NDArray[np.floating], pitch_mm: Pitch, period_mm: float, sectors: int = 36
) -> tuple[Floats, Floats]:
    """Share of the power within 0.6 to 1.4 carriers in equal sectors of direction.

    Returns:
        (sectors,) their middles, degrees, 0 to 180; (sectors,) shares, which sum to 1.
    """
    spectrum, frequency = power(field, pitch_mm)
    rows, columns = field.shape
    fy, fx = np.fft.fftfreq(rows, pitch_mm[1]), np.fft.rfftfreq(columns, pitch_mm[0])
    angle = np.rad2deg(np.arctan2(-fy[:, None], fx[None, :])) % 180  # rows run towards smaller y
    band = (frequency > BAND[0] / period_mm) & (frequency < BAND[1] / period_mm)
    shares = np.histogram(angle[band], sectors, (0, 180), weights=spectrum[band])[0]
    return (np.arange(sectors) + 0.5) * 180 / sectors, shares / shares.sum()


def autocovariance(field: NDArray[np.floating]) -> Floats:
    """Mean product of the field, its mean removed, with itself shifted by whole pixels; unbiased.

    Returns:
        (2 H - 1, 2 W - 1), no shift in the middle.
    """
    values = np.asarray(field, np.float64)
    values = values - values.mean()
    shape = tuple(2 * n - 1 for n in values.shape)
    products = np.fft.irfft2(np.abs(np.fft.rfft2(values, shape)) ** 2, shape)
    ones = np.fft.irfft2(np.abs(np.fft.rfft2(np.ones_like(values), shape)) ** 2, shape)
    return np.asarray(np.fft.fftshift(products / np.maximum(ones, 0.5)))


def local_ratio(labels: NDArray[np.uint8], pitch_mm: Pitch, window_mm: float, material: int = 1) -> Floats:
    """Share of a material (1-based) of the solid in a square window around each pixel; NaN where nothing is solid."""
    size = max(1, round(window_mm / pitch_mm[1])), max(1, round(window_mm / pitch_mm[0]))
    some, solid = (
        ndimage.uniform_filter(np.asarray(mask, np.float64), size, mode="constant")
        for mask in (labels == material, labels > 0)
    )
    share = np.full(labels.shape, np.nan)
    np.divide(some, solid, out=share, where=solid > 1e-9)
    return share


# --- the complex field -------------------------------------------------------------------------------------


def contrast(g: NDArray[np.complex64]) -> float:
    """σ(|G|) / mean(|G|): 0 for a grating, √(4/π - 1) = 0.523 for a complex Gaussian field."""
    intensity = np.abs(g)
    return float(intensity.std() / intensity.mean())


def singularities(g: NDArray[np.complex64]) -> int:
    """Number of pixel squares around which arg G turns by ±2π."""
    phase = np.angle(g).astype(np.float64)

    def step(a: Floats, b: Floats) -> Floats:
        return (b - a + np.pi) % (2 * np.pi) - np.pi

    turn = (
        step(phase[:-1, :-1], phase[:-1, 1:])
        + step(phase[:-1, 1:], phase[1:, 1:])
        + step(phase[1:, 1:], phase[1:, :-1])
        + step(phase[1:, :-1], phase[:-1, :-1])
    )
    return int(np.count_nonzero(np.abs(turn) > np.pi))
