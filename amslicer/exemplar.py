"""A picture that shows what a texture looks like, and its periodic component, which textures are made from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.pictures import GREY, read_picture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MIN_SIDE = 8  # pixels: fewer frequencies than that are no texture
CHOOSE_HINT = "choose a picture that is filled with the texture, such as a photograph of a surface"
WANTED = replace(
    GREY,
    kind="grey or RGB",
    modes=(*GREY.modes, "RGB"),
    most=16_000_000,  # a few copies of it as float64, and as spectra, fit in memory
    why_less="a micro-texture needs no more",
    convert="convert it to a plain picture: magick IN -auto-orient -colorspace sRGB -type TrueColor -alpha off "
    "-interlace none -depth 8 OUT.png, or to a grey one with -colorspace Gray -depth 16",
)


@dataclass(frozen=True, eq=False)
class Exemplar:
    """What a picture shows.

    Attributes:
        values: (rows, columns, channels), 0…1; row 0 is the lowest. One channel, or red, green, blue.
        name: as the job file writes it.
    """

    values: Floats
    name: str

    @property
    def is_grey(self) -> bool:
        """Whether it has one channel."""
        return int(self.values.shape[2]) == 1


def read_exemplar(content: bytes, name: str) -> Exemplar:
    """Reads an 8 or 16-bit grey or 8-bit RGB picture as an exemplar, its full scale as 1.

    Raises:
        JobError: not a readable plain PNG or TIFF of these, more than 16 million pixels, less than 8 on a side, or
            without any texture.
    """
    texels, full_scale = read_picture(content, name, WANTED)
    rows, columns = texels.shape[:2]
    if min(rows, columns) < MIN_SIDE:
        raise JobError(
            f"the picture '{name}' has {columns} × {rows} pixels; a texture is read from {MIN_SIDE} or more a side",
            hint=CHOOSE_HINT,
        )
    values = np.atleast_3d(texels)[::-1].astype(np.float64) / full_scale
    # Only then is the periodic component constant, too: within the picture it has the same differences.
    if (values == values[0, 0]).all():
        shown = ", ".join(f"{value:g}" for value in values[0, 0])
        raise JobError(f"the picture '{name}' shows nothing: it is {shown} everywhere (of 0…1)", hint=CHOOSE_HINT)
    return Exemplar(values, name)


def periodic_component(h: Floats) -> Floats:
    """What of a picture repeats without a seam: p of h = p + s, where s is smooth and takes the jumps between opposite
    borders.

    The one p that has h's mean, and whose periodic Laplacian is that of h without the differences across the borders.
    (Galerne, Gousseau and Morel 2011, "Random Phase Textures", (3); the decomposition is Moisan's.)

    Args:
        h: (rows, columns) or (rows, columns, channels).

    Returns:
        p, in the shape of h.
    """
    from scipy import fft

    values = h.reshape(*h.shape[:2], -1)
    rows, columns = values.shape[:2]
    inner = np.zeros(values.shape)  # at each pixel the sum of its differences from the neighbours in the picture
    for axis in (0, 1):
        step = np.diff(values, axis=axis)
        below, above = (slice(None),) * axis + (slice(-1),), (slice(None),) * axis + (slice(1, None),)
        inner[below] -= step
        inner[above] += step
    # 4 - 2 cos(2πη/M) - 2 cos(2πξ/N), as squares of sines: low frequencies keep their digits.
    along_rows = np.sin(np.pi * np.arange(rows) / rows) ** 2
    along_columns = np.sin(np.pi * np.arange(columns // 2 + 1) / columns) ** 2
    laplacian = 4 * (along_rows[:, None] + along_columns)
    laplacian[0, 0] = 1.0  # of a sum that is 0
    spectrum = fft.rfft2(inner, axes=(0, 1)) / laplacian[..., None]
    spectrum[0, 0] = values.sum(axis=(0, 1))
    p: Floats = fft.irfft2(spectrum, s=(rows, columns), axes=(0, 1))
    return p.reshape(h.shape)
