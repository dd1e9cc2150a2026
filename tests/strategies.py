"""Hypothesis strategies: contents of valid job files, the pictures that they name, and small closed meshes.

A new field source is one function and one line in FIELDS; a new key is one line in `jobs`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import manifold3d
import meshes
import numpy as np
import parts
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from meshes import Solid
from PIL import Image

from amslicer import JobError, load_job
from amslicer.noise import NOISES
from amslicer.profiles import PROFILES

Field = Any  # a FIELD of the job file
MAX_MATERIALS = 8
STEP_MM = 1 / 256
"""Vertices are multiples of it: exact in float32, and so are moves by whole millimetres."""
MAX_MOVE_MM = 4096

# ---------------------------------------------------------------------------------------------------------
# Fields: FIELDS is kind -> strategy of FIELDs whose values lie in low … high


def numbers(low: float, high: float) -> SearchStrategy[float]:
    """Numbers as people write them: a few digits, both ends included."""
    return st.integers(0, 1000).map(lambda t: round(low + t / 1000 * (high - low), 6))


def gradients(low: float, high: float) -> SearchStrategy[Field]:
    ends = {"axis": st.sampled_from("xyz"), "from": numbers(low, high), "to": numbers(low, high)}
    # The same start and end would be a step.
    span = {"start": numbers(-2, 1), "end": numbers(1.5, 6)}
    return st.fixed_dictionaries(ends, optional=span).map(lambda g: {"gradient": g})


def radial_gradients(low: float, high: float) -> SearchStrategy[Field]:
    content = {
        "center": st.lists(numbers(-1, 3), min_size=2, max_size=3),
        "radius": numbers(0.25, 4),
        "from": numbers(low, high),
        "to": numbers(low, high),
    }
    return st.fixed_dictionaries(content).map(lambda g: {"gradient": g})


# Formulas of values in 0 … 1.
FORMULAS = (
    "u",
    "1 - v**2",
    "0.5 + 0.5*sin(2*pi*x/3 + y)",
    "hypot(u, w)/2",
    "where(u > 0.5, v, 0.25)",
    "floor(3*u)/3",
    "abs(min(u, v, w) - max(u, v, w))",
    "exp(-(x**2 + z**2))",
    "atan2(v, u)/pi",
    "(0.2 < u) <= v",
)


def expressions(low: float, high: float) -> SearchStrategy[Field]:
    ends = st.tuples(st.sampled_from(FORMULAS), numbers(low, high), numbers(low, high))
    # The sum may be past an end by its rounding.
    return ends.map(lambda e: {"expression": f"clip({e[1]} + ({e[2]} - {e[1]})*({e[0]}), {low}, {high})"})


def images(low: float, high: float) -> SearchStrategy[Field]:
    corners = st.tuples(numbers(-3, 1), numbers(-3, 1), numbers(1.5, 6), numbers(1.5, 6)).map(list)
    content = {
        "image": st.sampled_from(sorted(PICTURES)),
        "range": st.tuples(numbers(low, high), numbers(low, high)).map(list),
    }
    return st.fixed_dictionaries(content, optional={"box": corners, "plane": st.sampled_from(["xy", "xz", "yz"])})


FIELDS: dict[str, Callable[[float, float], SearchStrategy[Field]]] = {
    "constant": numbers,
    "gradient": gradients,
    "radial gradient": radial_gradients,
    "image": images,
    "expression": expressions,
}

_random = np.random.default_rng(7)
PICTURES: dict[str, np.ndarray[Any, Any]] = {
    "uniform.png": np.full((2, 3), 51, np.uint8),
    "steps.png": np.arange(0, 256, 17, dtype=np.uint8).reshape(2, 8),
    "noise.png": _random.integers(0, 256, (7, 4)).astype(np.uint8),
    "deep.tif": _random.integers(0, 65536, (5, 6)).astype(np.uint16),
}


def write_pictures(folder: Path) -> None:
    """The pictures that the fields of these strategies name."""
    for name, grey in PICTURES.items():
        Image.fromarray(grey).save(folder / name)


def fields(low: float, high: float) -> SearchStrategy[Field]:
    return st.one_of([make(low, high) for make in FIELDS.values()])


# ---------------------------------------------------------------------------------------------------------
# Jobs

NAMES = ("rigid", "flexible", "soft", "A", "b-2", "Vero Clear", "x.y", "0")
COLORS = st.integers(0, 2**24 - 1).map(lambda c: f"#{c:06x}")


@cache
def most_materials() -> int:
    """How many materials this version takes."""
    for count in range(MAX_MATERIALS, 2, -1):
        names = list(NAMES[:count])
        try:
            load_job({"materials": names, "fields": {"ratio": dict.fromkeys(names[1:], 0.1) | {names[0]: "rest"}}}, "p")
        except JobError:
            continue
        return count
    return 2


@st.composite
def materials(draw: st.DrawFn) -> list[Any]:
    names = draw(st.lists(st.sampled_from(NAMES), min_size=2, max_size=most_materials(), unique=True))
    described = st.fixed_dictionaries({}, optional={"color": COLORS, "density_g_cm3": numbers(0.5, 2)})
    return [draw(st.one_of(st.just(name), described.map(lambda d, name=name: {"name": name, **d}))) for name in names]


def ratios(names: list[str]) -> SearchStrategy[Field]:
    """The first material's share; of more than two, all but the last one's, which takes the rest."""
    if len(names) == 2:
        return fields(0, 1)
    most = 1 / (len(names) - 1)
    return st.fixed_dictionaries({**{name: fields(0, most) for name in names[:-1]}, names[-1]: st.just("rest")})


def printers() -> SearchStrategy[dict[str, Any]]:
    """Coarse, so that parts of some millimetres are quick; the finest have a lattice."""
    pitch = st.sampled_from(
        [{"pitch_um": 250}, {"pitch_um": [200, 300]}, {"dpi": 100}, {"dpi": [120, 80]}, {"dpi": 500}]
    )
    layer = st.sampled_from([{"layer_mm": 0.3}, {"layer_um": 410}, {"layer_um": 90}])
    margin = st.sampled_from([{}, {"margin_px": 0}, {"margin_px": 3}])
    return st.tuples(pitch, layer, margin).map(lambda parts: {k: v for part in parts for k, v in part.items()})


PARTS: dict[str, SearchStrategy[Any]] = {
    "units": st.just("mm"),
    "scale": st.sampled_from([1, 0.75, 1.25]),
    "rotate": st.sampled_from([[0, 0, 0], [90, 0, 180], [10, 20, 30]]),
    "on_bed": st.booleans(),
    "allow_open": st.booleans(),
}
# Waveforms that are the same both ways, and those that are not.
EVEN: tuple[Any, ...] = (
    {"harmonics": [1, 0.5]}, {"table": [0, 1, 0.5, 0.5, 1]}, {"square": 0.25},
    {"blend": {"from": "sine", "to": {"harmonics": [0, 1]}, "by": {"gradient": {"axis": "x", "from": 0, "to": 1}}}},
)  # fmt: skip
UNEVEN: tuple[Any, ...] = (
    {"table": [0, 1, 0.25]},
    {"harmonics": [1, {"amplitude": 0.5, "phase": 40}]},
    {"blend": {"from": "triangle", "to": "sawtooth", "by": 0.5}},
)
PATTERN: dict[str, SearchStrategy[Any]] = {
    "noise": st.sampled_from(sorted(name for name in NOISES if "exemplar" not in NOISES[name].keys)),
    "spectrum": st.sampled_from(
        ["laminate", "white", "crystal", {"gaussian": 0.8}, {"sectors": [[0, 40]], "of": "blue"}]
    ),
    "reads": st.sampled_from(["phase", "real", "modulus"]),
    "time": numbers(-2, 2),
    "depth": st.integers(0, 3),
    "profile": st.sampled_from([*sorted(PROFILES), *EVEN, *UNEVEN]),
    "edges": st.sampled_from(["sharp", "dithered"]),
    "period": fields(1, 3),
    "bandwidth": numbers(0.4, 1),
    "impulses": numbers(3, 10),
    "alignment": st.sampled_from([0, 2]),
    "lobes": st.sampled_from([[{"angle": 20.0}], [{"angle": 0}, {"angle": 100, "weight": 0.5, "about": "z"}]]),
    "evaluate": st.sampled_from(["lattice", "exact"]),
    "seed": st.one_of(st.integers(0, 9), st.just(2**64 - 1)),
}


def orientations(dimensions: int, *, arrows: bool) -> SearchStrategy[Any]:
    """Every way to write a direction; arrows: none that could turn into its opposite, as a cyclic profile needs it.

    Samples of a picture are combined as lines, of which two at most 80° apart keep their arrows.
    """
    turn, side = (40, 0.5) if arrows else (180, 1)
    components = [fields(0.75, 1) if arrows else fields(-1, 1), fields(-side, side)]
    angles = fields(-turn, turn)
    if dimensions == 2:
        return st.one_of(angles, st.fixed_dictionaries({"vector": st.tuples(*components, st.just(0)).map(list)}))
    pair = {"azimuth": angles, "elevation": fields(-turn / 2, turn / 2)}
    vector = st.tuples(*components, fields(-side, side)).map(list)
    return st.one_of(angles, st.fixed_dictionaries(pair), st.fixed_dictionaries({"vector": vector}))


def _needs_arrows(profile: Any) -> bool:
    return profile in UNEVEN or (isinstance(profile, str) and PROFILES[profile].arrows)


@st.composite
def jobs(draw: st.DrawFn) -> dict[str, Any]:
    """The content of a valid job file."""
    chosen = draw(materials())
    dimensions = draw(st.sampled_from([2, 3]))
    names = [m if isinstance(m, str) else m["name"] for m in chosen]
    pattern = deepcopy(draw(st.fixed_dictionaries({}, optional=PATTERN)))  # whoever makes a mistake in it changes it
    noise = pattern.get("noise", "phasor")
    keys = frozenset().union(*(kind.keys for kind in NOISES.values()))
    for key in keys - NOISES[noise].keys:
        pattern.pop(key, None)
    spectrum = pattern.get("spectrum", "laminate")
    if spectrum == "crystal":
        pattern.pop("reads", None)
    reads = parts.noise(noise, **{k: pattern[k] for k in ("spectrum", "reads") if k in pattern}).reads
    cells = noise.startswith("wave-")
    if reads != "phase":  # there is no phase
        pattern.pop("alignment", None)
        if _needs_arrows(pattern.get("profile", "pwm")):
            del pattern["profile"]
    if reads == "power" or cells:
        pattern["profile"], pattern["edges"] = "pwm", "sharp"
    if spectrum != "laminate":
        pattern["edges"] = "sharp"
    if cells or spectrum in ("crystal", {"sectors": [[0, 40]], "of": "blue"}):
        pattern["period"] = 1.5
    arrows = _needs_arrows(pattern.get("profile", "pwm"))
    painted = {"orientation": orientations(dimensions, arrows=arrows), "isotropy": fields(0, 1)}
    return {
        "printer": draw(printers()),
        "part": draw(st.fixed_dictionaries({}, optional=PARTS)),
        "materials": chosen,
        "pattern": {"dimensions": dimensions, **pattern},
        "fields": draw(st.fixed_dictionaries({"ratio": ratios(names)}, optional=painted)),
        "output": draw(st.fixed_dictionaries({}, optional={"compression": st.sampled_from(["fast", "small"])})),
    }


# ---------------------------------------------------------------------------------------------------------
# Meshes

SIDES = st.integers(128, 1024).map(lambda n: n * STEP_MM)  # 0.5 to 4 mm
MOVES = st.tuples(*[st.integers(-MAX_MOVE_MM, MAX_MOVE_MM)] * 3)


@st.composite
def boxes(draw: st.DrawFn) -> Solid:
    return meshes.box((draw(SIDES), draw(SIDES), draw(SIDES)))


@st.composite
def booleans(draw: st.DrawFn) -> Solid:
    """Turned boxes and spheres, added and cut; never nothing."""
    solid = manifold3d.Manifold.cube((2.0, 2.0, 2.0), True)
    for _ in range(draw(st.integers(1, 3))):
        if draw(st.booleans()):
            other = manifold3d.Manifold.cube((draw(SIDES), draw(SIDES), draw(SIDES)), True)
        else:
            other = manifold3d.Manifold.sphere(draw(SIDES) / 2, 12)
        other = other.rotate([draw(st.integers(0, 359)) for _ in range(3)])
        other = other.translate([draw(SIDES) - 1.5 for _ in range(3)])
        cut = solid - other
        solid = solid + other if draw(st.booleans()) or cut.volume() < 0.5 else cut
    return meshes.from_manifold(solid)


@st.composite
def shells(draw: st.DrawFn) -> Solid:
    """Boxes that overlap, touch, repeat or stand apart, each with its own surface."""
    count = draw(st.integers(2, 3))
    places = st.tuples(*[st.integers(0, 8)] * 3).map(lambda at: tuple(n / 4 for n in at))
    return meshes.joined(*[meshes.moved(draw(boxes()), draw(places)) for _ in range(count)])


def solids() -> SearchStrategy[Solid]:
    """Closed meshes of a few millimetres, all vertices multiples of STEP_MM."""
    return st.one_of(boxes(), booleans(), shells()).map(_rounded)


def _rounded(solid: Solid) -> Solid:
    return np.round(solid[0] / STEP_MM) * STEP_MM, solid[1]


# ---------------------------------------------------------------------------------------------------------
# Mistakes

KeyPath = tuple[str | int, ...]
# What is out of range for the key that a path ends with.
OUT_OF_RANGE: Mapping[str, tuple[Any, ...]] = {
    "pitch_um": (0, -1, [250, 0], 1e30),
    "dpi": (0, -600, [600, -300], 1e30),
    "layer_mm": (0, -0.1, 1e30),
    "layer_um": (0, -1),
    "margin_px": (-1, 10_001, 0.5),
    "scale": (0, -1),
    "units": ("furlong", ""),
    "color": ("red", "#12345", "#1234567"),
    "density_g_cm3": (0, -1),
    "name": ("", "a/b", "..", "inputs", "x" * 65),
    "noise": ("perlin", ""),
    "profile": ("pulse", {"table": [1, 1]}, {"table": [1]}, {"harmonics": [0, 0]}, {"square": 1}, {}),
    "table": ([], [1], [2, 2, 2], [0, "a"]),
    "square": (0, 1, -0.2),
    "harmonics": ([], [0], ["a"]),
    "amplitude": ("a",),
    "edges": ("blurred", ""),
    "dimensions": (1, 4, 2.5),
    "period": (0, -1),
    "bandwidth": (0, -0.5, 2.1),
    "impulses": (0, 1.9, 101),
    "alignment": (-1, 10_001),
    "weight": (0, -1),
    "about": ("w", ""),
    "evaluate": ("fast",),
    "seed": (-1, 2**64, 1.5),
    "axis": ("w", ""),
    "center": ([1], [1, 2, 3, 4]),
    "radius": (0, -1),
    "plane": ("yx", ""),
    "expression": ("", "u +", "q", "print(u)", "u.real", "sin(u, v)", "2**2**2**u" * 100),
    "box": ([1, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1]),
    "compression": ("none",),
}
WRONG_TYPES: tuple[Any, ...] = ([[]], {"": []}, [{"a": 1}])


def paths(content: Any, above: KeyPath = ()) -> list[KeyPath]:
    """Every key of a job file's content, and every item of its lists of mappings."""
    if isinstance(content, dict):
        return [p for key, value in content.items() for p in ((*above, key), *paths(value, (*above, key)))]
    if isinstance(content, list) and any(isinstance(item, dict) for item in content):
        return [p for i, item in enumerate(content) for p in paths(item, (*above, i))]
    return []


@st.composite
def mistakes(draw: st.DrawFn) -> tuple[dict[str, Any], KeyPath, str]:
    """A job file's content with one thing wrong, where it is, and the kind of mistake."""
    content = draw(jobs())
    path = draw(st.sampled_from(paths(content)))
    node: Any = content
    for step in path[:-1]:
        node = node[step]
    last = path[-1]
    kinds = ["typo", "type", *(["range"] if last in OUT_OF_RANGE else []), *([] if path[0] == "output" else ["nan"])]
    kind = draw(st.sampled_from(kinds))
    if kind == "typo":
        letters = str(last)
        at = draw(st.integers(0, len(letters)))
        typed = letters[:at] + draw(st.sampled_from("qz_")) + letters[at:]
        value = node.pop(last)
        node[typed] = value
        return content, (*path[:-1], typed), kind
    values = {"type": WRONG_TYPES, "nan": (float("nan"), float("inf")), "range": OUT_OF_RANGE.get(str(last), ())}
    node[last] = draw(st.sampled_from(values[kind]))
    return content, path, kind
