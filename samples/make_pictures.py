"""Makes the README's pictures: each sample's painted fields beside layers of its laminate, and the example jobs.

python samples/make_pictures.py
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

import amslicer
from amslicer import Layer, Run
from amslicer.pictures import BACKGROUND, INK, layer_picture
from amslicer.pipeline import prepare

SAMPLES = Path(__file__).resolve().parent
EXAMPLES = SAMPLES.parent / "configs" / "examples"
GAP, TEXT = 14, 24  # px between pictures, and for a line of text
SHEET = 1180  # px: the width of a page
COLUMNS = 4
# Example jobs, what they show, and at which share of the height.
SHOWN = (
    ("expression", "formulas", 0.5), ("radial", "gradients around points", 0.5),
    ("pictures", "heights, and a relief", 0.5), ("map", "a map of materials", 0.5),
    ("volume", "numbers, and vectors", 0.5), ("stress", "a stress analysis", 0.5),
    ("vertex", "colours of the part's vertices", 0.5), ("distance", "shells parallel to the skin", 0.5),
    ("points", "scattered points", 0.5), ("strokes", "brush strokes", 0.5), ("mix", "fields of fields", 0.5),
    ("bodies", "a field for each body", 0.5), ("texture", "grain of a picture", 0.5),
    ("planes", "pictures from aside", 0.5),
    ("cells", "cells", 0.5), ("relief", "a surface that the pattern moves", 0.5),
)  # fmt: skip


def layers_at(sample: str, shares: tuple[float, ...]) -> tuple[list[Layer], tuple[str, ...], tuple[float, float]]:
    """Layers at shares of the height, the materials' colours and the pitch."""
    folder = SAMPLES / sample
    job = amslicer.load_job(folder / "fields.yaml", folder / f"{sample}.stl")
    count = prepare(job).grid.layers
    found = []
    for share in shares:
        index = round(share * (count - 1))
        found.extend(amslicer.layers(job, Run(layers=(index, index + 1))))
    return found, tuple(m.color for m in job.spec.materials), job.spec.printer.pitch_mm


def grey(file: Path, width: int) -> Image.Image:
    """A painted field as 8-bit grey, framed."""
    picture = np.asarray(Image.open(file)).astype(float)
    full = 65535 if picture.max() > 255 else 255
    small = Image.fromarray((picture / full * 255).astype(np.uint8)).convert("RGB")
    small = small.resize((width, round(width * small.height / small.width)), Image.Resampling.BILINEAR)
    ImageDraw.Draw(small).rectangle((0, 0, small.width - 1, small.height - 1), outline=INK)
    return small


def stack_up(tiles: list[tuple[Image.Image, str]], places: list[tuple[int, int]]) -> Image.Image:
    """Pictures with captions under them, at places."""
    height = max(y + tile.height + TEXT for (tile, _), (_, y) in zip(tiles, places, strict=True)) + GAP
    sheet = Image.new("RGB", (SHEET, height), BACKGROUND)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=15)
    for (tile, caption), (x, y) in zip(tiles, places, strict=True):
        sheet.paste(tile, (x, y))
        draw.text((x, y + tile.height + 2), caption, fill=INK, font=font)
    return sheet


def cross_plate() -> Image.Image:
    """Three painted fields on the left, the laminate on the right."""
    folder, small = SAMPLES / "cross_plate", 265
    (layer,), colors, pitch = layers_at("cross_plate", (0.5,))
    large = layer_picture(layer, colors, pitch, SHEET - small - 3 * GAP)
    tiles = [
        (grey(folder / "ratio.png", small), "painted ratio of rigid (black 15 %, white 80 %)"),
        (grey(folder / "orientation.png", small), "painted normal (black -90°, white 90°)"),
        (grey(folder / "isotropy.png", small), "painted isotropy (black 0, white 0.9)"),
        (large, "one layer at 600 dpi, 60 mm across: rigid blue, flexible orange"),
    ]
    left = [(GAP, GAP + i * (small + TEXT + GAP)) for i in range(3)]
    return stack_up(tiles, [*left, (small + 2 * GAP, GAP)])


def insole() -> Image.Image:
    """Three layers of the solid laminate under its painted fields."""
    folder, width = SAMPLES / "insole", (SHEET - 3 * GAP) // 2
    found, colors, pitch = layers_at("insole", (0.1, 0.2, 0.35, 0.55))
    fields = [
        (grey(folder / "ratio.png", width), "painted ratio of rigid (black 15 %, white 75 %)"),
        (grey(folder / "azimuth.png", width), "painted azimuth of the normal (black -90°, white 90°)"),
    ]
    pictures = [
        (layer_picture(layer, colors, pitch, width), f"layer {layer.index}, z = {layer.z_mm:.2f} mm") for layer in found
    ]
    step = fields[0][0].height + TEXT + GAP
    places = [(GAP + i % 2 * (width + GAP), GAP + i // 2 * step) for i in range(6)]
    return stack_up(fields + pictures, places)


def examples() -> Image.Image:
    """A layer of each example job."""
    width = (SHEET - (COLUMNS + 1) * GAP) // COLUMNS
    tiles = []
    with TemporaryDirectory() as folder:
        box = Path(folder) / "part.stl"
        trimesh.creation.box(bounds=[[-10, -10, 0], [10, 10, 5]]).export(box)
        for name, shows, share in SHOWN:
            file = EXAMPLES / f"{name}.yaml"
            part = next((p for p in sorted(EXAMPLES.glob(f"{name}.*")) if p.suffix in (".ply", ".obj")), box)
            job = amslicer.load_job(file, part)
            index = round(share * (prepare(job).grid.layers - 1))
            (layer,) = amslicer.layers(job, Run(layers=(index, index + 1)))
            colors = tuple(m.color for m in job.spec.materials)
            tile = layer_picture(layer, colors, job.spec.printer.pitch_mm)
            tile.thumbnail((width, width), Image.Resampling.BOX)
            tiles.append((tile, f"{name}: {shows}"))
    step = width + TEXT + GAP
    return stack_up(tiles, [(GAP + i % COLUMNS * (width + GAP), GAP + i // COLUMNS * step) for i in range(len(tiles))])


if __name__ == "__main__":
    sheet = examples().quantize(128, dither=Image.Dither.NONE)
    sheet.save(SAMPLES / "fields.png", optimize=True)
    for name, make in (("cross_plate", cross_plate), ("insole", insole)):
        file = SAMPLES / name / "laminate.png"
        make().quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)
        print(f"{file}: {file.stat().st_size // 1024} kB")
