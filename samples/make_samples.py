"""Make the sample parts, their painted pictures and job files: python samples/make_samples.py [--out DIR].

Everything follows from the constants and formulas below, without randomness: twice gives the same bytes.
Lengths are mm, angles degrees; x runs along a part's length, y across, z up.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from string import Template

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Blob = tuple[float, tuple[float, float], tuple[float, float]]

PICTURE_TEXEL_MM = 0.375
"""Well below the period: finer paint could not show in the laminate."""
ANGLE_RANGE_DEG = (-90.0, 90.0)
"""A laminate's normal is a line, so half a turn names every direction in the plane."""

# The cross-shaped plate, centred on the origin.
PLATE_RADIUS_MM = 30.0
ARM_HALF_WIDTH_MM = 9.0
INNER_CORNER_MM = 6.0
OUTER_CORNER_MM = 2.5
CORNER_STEPS = 16
PLATE_THICKNESS_MM = 3.0
PLATE_RATIO_RANGE = (0.15, 0.80)
PLATE_CENTRE_MM = 8.0
"""Distance from the centre at which the normals have turned half way from the diagonal to the arms."""
PLATE_TWIST_DEG = 80.0
"""Turn of the normals along the arms in y: this much at the upper tip, its opposite at the lower one."""
PLATE_TWIST_START_MM = 8.0
PLATE_ISOTROPY_RANGE = (0.0, 0.9)
PLATE_ISOTROPIC_MM, PLATE_LAMINATE_MM = 5.0, 15.0
"""Distances from the centre up to which the hub is isotropic, and from which on the plate is a laminate."""
PLATE_RATIO_BASE = 0.45
PLATE_STRIPE_MM = 12.0
PLATE_STRIPE_RATIO = 0.22
PLATE_BLOBS = (
    (0.33, (0.0, 0.0), (9.0, 9.0)),  # hub
    (0.34, (2.0, 24.0), (9.0, 5.0)),  # upper arm, stiff tip
    (-0.22, (-2.0, 13.0), (9.0, 4.5)),
    (0.22, (2.0, -14.0), (9.0, 4.0)),
    (-0.30, (-1.0, -25.0), (9.0, 5.5)),  # lower arm, soft tip
)
"""Height in ratio, centre and radii along x and y (mm)."""

# The insole: a right foot seen from above, heel at x = 0, big toe and arch towards +y.
INSOLE_LENGTH_MM = 120.0
INSOLE_STATIONS = 84
INSOLE_COLUMNS = 30
INSOLE_RATIO_RANGE = (0.15, 0.75)
PRESSURE_POINTS = (
    (0.98, (17.0, 0.0), (13.0, 9.5)),  # heel
    (0.90, (86.0, 11.5), (9.0, 7.5)),  # ball of the foot, medial to lateral
    (0.82, (84.0, -1.5), (9.0, 7.5)),
    (0.60, (77.0, -14.0), (10.0, 6.0)),
    (0.80, (109.0, 11.0), (6.5, 5.5)),  # big toe
    (0.30, (105.0, -6.0), (6.0, 9.0)),  # small toes
    (0.35, (48.0, -13.0), (24.0, 5.0)),  # lateral edge
)
"""Pressure, centre and radii along x and y (mm): where a standing foot rests."""
SOFTENING = 1.6
"""How quickly pressure saturates into softness: neighbouring pressure points merge without a step."""
INSOLE_HALF_WIDTH_MM = 22.5
INSOLE_ELEVATION_DEG = (20, 70)
ARCH_X_MM = 53.0
ARCH_RADIUS_MM = 17.0
OUTLINE_HEEL_Y_MM = -0.4
OUTLINE_TOE_Y_MM = 5.5
OUTLINE = (
    # share of the length, lateral edge y, medial edge y
    (0.04, -11.0, 10.2),
    (0.13, -14.9, 14.0),
    (0.25, -16.3, 13.9),
    (0.37, -17.6, 11.6),
    (0.48, -19.2, 11.0),
    (0.59, -21.3, 14.2),
    (0.68, -22.4, 18.9),
    (0.76, -22.3, 21.9),
    (0.85, -18.8, 21.9),
    (0.93, -11.4, 18.6),
)

MATERIALS_YAML = """\
printer: generic-600dpi        # 42.3 um pixels, 27 um layers

materials:                     # the first one is what fields.ratio counts
  - {name: rigid,    color: "#2b6cb0", density_g_cm3: 1.18}
  - {name: flexible, color: "#f6ad55", density_g_cm3: 1.12}
"""

PLATE_YAML = """\
# A flat cross whose sheets of two materials follow three painted pictures.
#   amslicer samples/cross_plate/cross_plate.stl --fields samples/cross_plate/fields.yaml -o out

$materials
pattern:
  dimensions: 2                # the same pattern in every layer: the sheets stand upright in the plate
  period: 1.0                  # mm from one rigid sheet to the next
  bandwidth: 0.5               # smaller: straighter and more regular sheets; larger: quicker to turn

fields:
  # The share of rigid at each place. Pictures are stretched over the part's bounding box, seen from
  # above; black paints the first number of range, white the second, greys what lies between.
  ratio: {image: ratio.png, range: [$ratio_low, $ratio_high]}
  # Where the sheets' normal points, in degrees from +x towards +y: the part gives way along the normal
  # and is stiff across it. -90 and 90 are the same direction. Mid-grey is 0: sheets parallel to y.
  orientation: {image: orientation.png, range: [$angle_low, $angle_high]}
  # How freely the sheets' directions scatter about that: 0 is a laminate, 1 has no direction left. The
  # hub should give way alike in all directions.
  isotropy: {image: isotropy.png, range: [$isotropy_low, $isotropy_high]}
"""

INSOLE_YAML = """\
# A miniature shoe insole: a solid laminate, softer under heel, ball and big toe, that tilts along the foot.
#   amslicer samples/insole/insole.stl --fields samples/insole/fields.yaml -o out_insole

$materials
pattern:
  dimensions: 3                # the sheets may lean: a solid laminate
  period: 1.0                  # mm from one rigid sheet to the next, measured along the normal
  bandwidth: 0.5

fields:
  # The share of rigid, like the negative of a pressure map: dark (soft) where a foot presses most.
  ratio: {image: ratio.png, range: [$ratio_low, $ratio_high]}
  # In 3D the sheets' normal has two angles.
  orientation:
    # Around z, from +x towards +y. Painted pictures reach through the whole thickness of the part.
    azimuth: {image: azimuth.png, range: [$angle_low, $angle_high]}
    # Up from the horizontal: 0 is upright sheets, 90 is sheets lying flat like the layers. A gradient
    # needs no picture: here from the heel (smallest x) to the toes (largest x).
    elevation: {gradient: {axis: x, from: $elevation_heel, to: $elevation_toe}}
"""


@dataclass(frozen=True)
class Picture:
    """A painted field as grey values in 0..1, row 0 at the largest y, and the bits they are stored with."""

    file: str
    grey: Array
    bits: int


def smooth_step(value: Array, start: float, end: float) -> Array:
    """0 before start, 1 after end (which may be the smaller one), with a continuous slope between."""
    t = np.clip((value - start) / (end - start), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def blobs(x: Array, y: Array, table: Iterable[Blob]) -> Array:
    """Sum of Gaussian blobs: each its height at its centre, height / e at its radius along x and along y."""
    total = np.zeros_like(x)
    for height, (cx, cy), (rx, ry) in table:
        total += height * np.exp(-(((x - cx) / rx) ** 2) - ((y - cy) / ry) ** 2)
    return total


def texel_centres(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """The x and y (mm) of every texel of a picture stretched over the part's bounding box, top row first."""
    low, high = np.asarray(mesh.bounds, dtype=np.float64)[:, :2]
    columns, rows = np.rint((high - low) / PICTURE_TEXEL_MM).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * (high[0] - low[0]) / columns
    y = high[1] - (np.arange(rows) + 0.5) * (high[1] - low[1]) / rows
    grid_x, grid_y = np.meshgrid(x, y)
    return grid_x, grid_y


def to_grey(value: Array, value_range: tuple[float, float]) -> Array:
    """Map a painted value to 0..1 as the job file's range maps it back; clipped at both ends."""
    return np.clip((value - value_range[0]) / (value_range[1] - value_range[0]), 0.0, 1.0)


def plate_quarter() -> list[tuple[float, float]]:
    """The arm towards +x, counter-clockwise: two rounded outer corners, then the inner corner towards +y."""
    tip, half = PLATE_RADIUS_MM - OUTER_CORNER_MM, ARM_HALF_WIDTH_MM - OUTER_CORNER_MM
    inner = ARM_HALF_WIDTH_MM + INNER_CORNER_MM
    corners = (
        ((tip, -half), OUTER_CORNER_MM, -90.0, 0.0),
        ((tip, half), OUTER_CORNER_MM, 0.0, 90.0),
        ((inner, inner), INNER_CORNER_MM, -90.0, -180.0),
    )
    points: list[tuple[float, float]] = []
    for (cx, cy), radius, start, end in corners:
        angles = np.radians(np.linspace(start, end, CORNER_STEPS + 1))
        points += [(float(cx + radius * np.cos(a)), float(cy + radius * np.sin(a))) for a in angles]
    return points


def plate_mesh() -> trimesh.Trimesh:
    """The plate: one quarter of the outline turned four times, extruded from z = 0."""
    outline: list[tuple[float, float]] = []
    points = plate_quarter()
    for _ in range(4):
        outline += points
        points = [(-y, x) for x, y in points]
    solid = manifold3d.CrossSection([np.asarray(outline)]).extrude(PLATE_THICKNESS_MM).to_mesh()
    return trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts, process=False)


def plate_ratio(x: Array, y: Array) -> Array:
    """Share of rigid: stripes in the arms along x, a stiff hub, stiff and soft blobs in the arms along y."""
    stripes = np.cos(2.0 * np.pi * (np.abs(x) - 0.35 * y) / PLATE_STRIPE_MM)
    in_arms = smooth_step(np.abs(x), ARM_HALF_WIDTH_MM, ARM_HALF_WIDTH_MM + INNER_CORNER_MM)
    return PLATE_RATIO_BASE + PLATE_STRIPE_RATIO * stripes * in_arms + blobs(x, y, PLATE_BLOBS)


def plate_orientation(x: Array, y: Array) -> Array:
    """Normal (degrees): the sheets follow the arms, bend round two corners and twist towards the y tips.

    A smooth plain number between -90 and 90, hence a field of lines without any singular point.
    """
    towards_y = (y**2 - x**2) / (x**2 + y**2 + PLATE_CENTRE_MM**2)
    twist = np.sign(y) * smooth_step(np.abs(y), PLATE_TWIST_START_MM, PLATE_RADIUS_MM)
    return -45.0 + 45.0 * towards_y + PLATE_TWIST_DEG * twist * (1.0 + towards_y) / 2.0


def plate_isotropy(x: Array, y: Array) -> Array:
    """Isotropy: without direction in the hub, a laminate in the arms."""
    low, high = PLATE_ISOTROPY_RANGE
    return high - (high - low) * smooth_step(np.hypot(x, y), PLATE_ISOTROPIC_MM, PLATE_LAMINATE_MM)


def plate_pictures(mesh: trimesh.Trimesh) -> list[Picture]:
    """The plate's painted ratio, orientation and isotropy."""
    x, y = texel_centres(mesh)
    return [
        Picture("ratio.png", to_grey(plate_ratio(x, y), PLATE_RATIO_RANGE), 16),
        Picture("orientation.png", to_grey(plate_orientation(x, y), ANGLE_RANGE_DEG), 8),
        Picture("isotropy.png", to_grey(plate_isotropy(x, y), PLATE_ISOTROPY_RANGE), 8),
    ]


def outline_spline() -> CubicSpline[np.float64]:
    """The insole's edge y (mm), smooth and closed, over psi in -pi..pi, where x = length (1 - cos psi) / 2.

    Negative psi is the lateral edge, positive the medial one; the ends come out round: x is even in psi.
    """
    lateral = [(-float(np.arccos(1.0 - 2.0 * t)), y) for t, y, _ in OUTLINE]
    medial = [(float(np.arccos(1.0 - 2.0 * t)), y) for t, _, y in OUTLINE]
    toe = [(-np.pi, OUTLINE_TOE_Y_MM)]
    knots = np.array(toe + lateral[::-1] + [(0.0, OUTLINE_HEEL_Y_MM)] + medial + [(np.pi, OUTLINE_TOE_Y_MM)])
    return CubicSpline(knots[:, 0], knots[:, 1], bc_type="periodic")


def insole_plan() -> tuple[Array, Array]:
    """The x and y (mm) of the grid from above: stations from heel to toe, columns from lateral to medial."""
    psi = np.linspace(0.0, np.pi, INSOLE_STATIONS + 1)
    edge = outline_spline()
    lateral, medial = edge(-psi), edge(psi)
    across = np.linspace(0.0, 1.0, INSOLE_COLUMNS + 1)
    y = lateral[:, None] + (medial - lateral)[:, None] * across
    x = np.repeat(INSOLE_LENGTH_MM * (1.0 - np.cos(psi[:, None])) / 2.0, INSOLE_COLUMNS + 1, axis=1)
    return x, y


def distance_to_edge(x: Array, y: Array) -> Array:
    """Distance (mm) from each grid point to the insole's outline, from a dense polyline of it."""
    psi = np.linspace(-np.pi, np.pi, 4001)
    outline = np.stack([INSOLE_LENGTH_MM * (1.0 - np.cos(psi)) / 2.0, outline_spline()(psi)], axis=1)
    distance, _ = cKDTree(outline).query(np.stack([x, y], axis=-1))
    return np.asarray(distance, dtype=np.float64)


def arch_vault(x: Array, y: Array) -> Array:
    """Where the arch is: 1 at the medial edge behind mid-length, 0 under heel, ball and lateral edge."""
    return np.asarray(np.exp(-(((x - ARCH_X_MM) / ARCH_RADIUS_MM) ** 2)) * smooth_step(y, -9.0, 11.0))


def insole_bottom(x: Array, y: Array) -> Array:
    """Height (mm) of the underside: flat under heel and ball, rolled up at both ends, hollow at the arch."""
    t = x / INSOLE_LENGTH_MM
    toe_spring = 7.0 * np.clip((t - 0.66) / 0.34, 0.0, None) ** 2
    heel_roll = 2.0 * np.clip((0.13 - t) / 0.13, 0.0, None) ** 2
    rocker = 0.8 * (y / INSOLE_HALF_WIDTH_MM) ** 2
    return toe_spring + heel_roll + rocker + 4.0 * arch_vault(x, y)


def insole_thickness(x: Array, y: Array) -> Array:
    """Thickness (mm), 3 to 8: thin toes, a pad under the heel, arch support, and a rim that cups the heel."""
    t = x / INSOLE_LENGTH_MM
    pad = 3.0 + 1.0 * smooth_step(t, 0.9, 0.3)
    rim = smooth_step(distance_to_edge(x, y), 7.0, 0.5)
    cup = 3.95 * rim * smooth_step(t, 0.42, 0.16)
    support = 3.9 * arch_vault(x, y)
    return pad + np.maximum(cup, support) + 0.3 * np.minimum(cup, support)


def insole_mesh() -> trimesh.Trimesh:
    """The insole: one grid for the top, the same below, a wall between; its two end rows are points."""
    x, y = insole_plan()
    bottom = insole_bottom(x, y)
    top = bottom + insole_thickness(x, y)
    index = np.zeros(x.shape, dtype=np.int64)
    inner = index[1:-1]
    inner[...] = 1 + np.arange(inner.size).reshape(inner.shape)
    index[-1] = inner.size + 1
    below = inner.size + 2
    first = np.unique(index, return_index=True)[1]
    plan = np.stack([x.ravel()[first], y.ravel()[first]], axis=1)
    vertices = np.vstack([np.column_stack([plan, z.ravel()[first]]) for z in (top, bottom)])
    skin = quads(index)
    rim = np.concatenate([index[:, 0], index[-2::-1, -1]])
    wall = quads(np.stack([rim + below, rim], axis=1))
    faces = np.vstack([skin, skin[:, ::-1] + below, wall])
    return trimesh.Trimesh(vertices, faces, process=False)


def quads(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Two triangles for each cell of a grid of vertex numbers, without those that have shrunk to a line."""
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    p, q, r = faces.T
    return np.asarray(faces[(p != q) & (q != r) & (r != p)])


def insole_ratio(x: Array, y: Array) -> Array:
    """Share of rigid: least where a foot presses most, most along the arch and the rim."""
    pressure = blobs(x, y, PRESSURE_POINTS)
    low, high = INSOLE_RATIO_RANGE
    softened = -np.expm1(-SOFTENING * pressure) / -np.expm1(-SOFTENING)
    return np.asarray(high - (high - low) * softened, dtype=np.float64)


def insole_azimuth(x: Array, y: Array) -> Array:
    """Azimuth of the normal (degrees): fans out round the heel, closes towards the toes, swings on its way.

    It stays between -90 and 90: with an elevation, an azimuth half a turn away is another direction.
    """
    t = x / INSOLE_LENGTH_MM
    side = y / INSOLE_HALF_WIDTH_MM
    fan = 65.0 * np.cos(np.pi * t) * np.sin(0.5 * np.pi * side)
    return fan + 25.0 * np.sin(2.0 * np.pi * t)


def insole_pictures(mesh: trimesh.Trimesh) -> list[Picture]:
    """The insole's painted ratio and azimuth."""
    x, y = texel_centres(mesh)
    return [
        Picture("ratio.png", to_grey(insole_ratio(x, y), INSOLE_RATIO_RANGE), 16),
        Picture("azimuth.png", to_grey(insole_azimuth(x, y), ANGLE_RANGE_DEG), 8),
    ]


def job_text(template: str, ratio_range: tuple[float, float]) -> str:
    """A job file whose ranges are the ones its pictures were painted with."""
    return Template(template).substitute(
        materials=MATERIALS_YAML,
        ratio_low=f"{ratio_range[0]:g}",
        ratio_high=f"{ratio_range[1]:g}",
        angle_low=f"{ANGLE_RANGE_DEG[0]:g}",
        angle_high=f"{ANGLE_RANGE_DEG[1]:g}",
        isotropy_low=f"{PLATE_ISOTROPY_RANGE[0]:g}",
        isotropy_high=f"{PLATE_ISOTROPY_RANGE[1]:g}",
        elevation_heel=INSOLE_ELEVATION_DEG[0],
        elevation_toe=INSOLE_ELEVATION_DEG[1],
    )


def checked_volume_mm3(path: Path) -> float:
    """Read a written part back and return its volume; raises ValueError unless it is closed and outward."""
    mesh = trimesh.load_mesh(path)
    solid = manifold3d.Manifold(
        manifold3d.Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    )
    if solid.status() != manifold3d.Error.NoError or not mesh.is_watertight or solid.volume() <= 0.0:
        raise ValueError(f"{path}: not a closed, outward solid ({solid.status()}, {solid.volume():.1f} mm3)")
    return float(solid.volume())


def write_sample(folder: Path, mesh: trimesh.Trimesh, pictures: list[Picture], job: str) -> None:
    """Write a part, its pictures (grey) and its job file into a folder, and print what was made."""
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"{folder.name}.stl"
    mesh.export(part)
    for picture in pictures:
        levels = np.rint(picture.grey * (2**picture.bits - 1)).astype(f"u{picture.bits // 8}")
        Image.fromarray(levels).save(folder / picture.file, optimize=True)
    (folder / "fields.yaml").write_text(job, encoding="utf-8", newline="\n")
    size = " x ".join(f"{length:.2f}" for length in mesh.extents)
    print(f"{part}: {size} mm, {len(mesh.faces)} triangles, {checked_volume_mm3(part):.0f} mm3")


def main() -> None:
    """Write both samples below --out (default: beside this script)."""
    parser = argparse.ArgumentParser(description="Make amslicer's sample parts, pictures and job files.")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent, metavar="DIR")
    out: Path = parser.parse_args().out
    plate, insole = plate_mesh(), insole_mesh()
    plate_job, insole_job = job_text(PLATE_YAML, PLATE_RATIO_RANGE), job_text(INSOLE_YAML, INSOLE_RATIO_RANGE)
    write_sample(out / "cross_plate", plate, plate_pictures(plate), plate_job)
    write_sample(out / "insole", insole, insole_pictures(insole), insole_job)


if __name__ == "__main__":
    main()
