"""The starter job file that `amslicer init` writes: every key, its default, and what it means."""

from __future__ import annotations

from amslicer.fields import SOURCES
from amslicer.jobfile import DEFAULT_PRINTER
from amslicer.noise.phasor import DEFAULT_IMPULSES
from amslicer.schema import SCHEMA_FILE
from amslicer.specification import DEFAULT_COLORS, Output, Pattern

STARTER = """\
# yaml-language-server: $schema={schema}
# (for editors: `amslicer schema > {schema}` beside this file, and they check and complete what you type)
#
# A job for amslicer: `amslicer part.stl --fields {name} -o out`
# Lengths are mm and angles degrees. What is commented out shows the default.

printer: {printer}            # a profile: `amslicer printers` lists them, DLP and PolyJet machines too;
                                   # or a .yaml file, or inline: {{dpi: [600, 300], layer_mm: 0.027}},
                                   # {{pitch_um: [42.3, 84.7], layer_um: 27, margin_px: 0}}
# part:
#   units: mm                      # mm, cm, m or inch; a 3MF file says its own
#   scale: 1
#   rotate: [0, 0, 0]              # about the file's x, then y, then z axis
#   on_bed: true                   # lowest point to z = 0

materials:                         # 2 to 8; with two, the first is what fields.ratio counts
  - {{name: rigid,    color: "{colors[0]}", density_g_cm3: 1.18}}
  - {{name: flexible, color: "{colors[1]}", density_g_cm3: 1.12}}

pattern:
  # noise: {pattern.noise}
  dimensions: {pattern.dimensions}                    # 3: solid laminate; 2: the same pattern in every layer
  period: {pattern.period}                      # mm from one sheet of a material to the next; a FIELD
  bandwidth: {pattern.bandwidth}                   # smaller: straighter, more regular sheets; larger: quicker to turn
  # impulses: {impulses:g}                    # kernels per bandwidth^dimensions
  # profile: {pattern.profile}                   # of several materials: symmetric A B C B A, or cyclic A B C A B C;
                                   # or a waveform: {{table: [0, 1, 0.5, 0.5, 1]}}, {{harmonics: [1, 0, 0.4]}} …
  # lobes: []                      # several directions: [{{angle: 0}}, {{angle: 90, weight: 0.5}}]
  # alignment: {pattern.alignment}                   # 20 brings the kernels in step: sheets that run through unbroken
  # edges: {pattern.edges}                   # or dithered, for very regular sheets along the pixel rows
  # evaluate: {pattern.evaluate}              # or exact: at every pixel, several times slower
  seed: {pattern.seed}                          # another seed, another laminate of the same kind

fields:
  # A field is a number, or one of ({sources}):
  #   {{gradient: {{axis: x, from: 0.1, to: 0.9}}}}      linear over the part's bounding box,
  #                                                    or between start: and end: in mm
  #                                                    or around a point: center: [x, y, z], radius: 8
  #   {{image: paint/ratio.png, range: [0, 1]}}         8 or 16-bit grey, black = range[0], stretched over the
  #                                                    part seen from above, or over box: [x0, y0, x1, y1];
  #                                                    plane: xz or yz for a picture of its side
  #   {{expression: "0.5 + 0.4*sin(2*pi*x/20)"}}        x y z in mm, u v w from 0 to 1 over the bounding box
  ratio: {{gradient: {{axis: x, from: 0.2, to: 0.8}}}} # share of the first material, 0 to 1;
                                   # or per material: {{rigid: FIELD, flexible: 0.2, soft: rest}}
  orientation: 30                  # the sheets' normal, from +x towards +y; or in 3D
                                   # {{azimuth: FIELD, elevation: FIELD}}, or {{vector: [FIELD, FIELD, FIELD]}}
  # isotropy: 0                    # a FIELD: 0 laminate … 1 gives way alike in all directions

# output: {{format: {output.format}, compression: {output.compression}}}          # compression: fast or small
"""


def starter_file(name: str) -> str:
    """The text of a commented job file, to be written under this name."""
    return STARTER.format(
        name=name, printer=DEFAULT_PRINTER, sources=", ".join(SOURCES),
        schema=SCHEMA_FILE, colors=DEFAULT_COLORS, pattern=Pattern(), impulses=DEFAULT_IMPULSES, output=Output(),
    )  # fmt: skip
