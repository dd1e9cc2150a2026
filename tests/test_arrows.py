"""The cyclic profile: A B C A B C along the painted normal, which must be an arrow, and refused where it is a line.

Along n, the phase of a complex Gaussian field of wave number k and spread σ passes a value upwards and downwards at the
rates (√(k² + σ²) ± k)/4π (Rice 1944). Here σ² = πb², so the share of the changes of material that go forwards is
½ + ½/√(1 + B²/4π): 0.995 at B = ½.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray

import amslicer
from amslicer.arrows import turns_little
from amslicer.pipeline import prepare

FORWARDS = 0.5 + 0.5 / np.sqrt(1 + 0.25 / (4 * np.pi))
TOLERANCE = 0.006
SIDE = 40.0  # mm, periods of 1 mm
ABC = ("amber", "blue", "clear")
RATIO = {"amber": 0.3, "blue": 0.3, "clear": "rest"}


def job(part: Path, **changed: Any) -> amslicer.Job:
    return parts.job(part, **{"ratio": RATIO, "materials": ABC, "profile": "cyclic", **changed})


def forwards(lines: NDArray[np.uint8]) -> float:
    """Of the changes of material along the last axis, the share that goes from A to B, B to C or C to A."""
    assert np.all(lines > 0)  # what is empty has no place in the order
    step = np.diff(lines.astype(int), axis=-1) % 3
    return float(np.mean(step[step != 0] == 1))


@pytest.mark.parametrize(("orientation", "forward"), [(0, True), (180, False), ({"vector": [-3, 0, 0]}, False)])
def test_order_along_the_normal(tmp_path: Path, orientation: Any, forward: bool) -> None:
    """Rows of pixels run along +x: the normal, or against it."""
    measured = forwards(parts.bitmap(job(parts.plate(tmp_path, SIDE, SIDE), orientation=orientation)))
    expected = FORWARDS if forward else 1 - FORWARDS
    print(f"orientation {orientation}: {measured:.4f} of the changes go forwards along +x, expected {expected:.4f}")
    assert measured == pytest.approx(expected, abs=TOLERANCE)


@pytest.mark.parametrize("up", [True, False])
def test_order_up_through_the_layers(tmp_path: Path, up: bool) -> None:
    orientation = {"azimuth": 0, "elevation": 90} if up else {"vector": [0, 0, -1]}
    part = parts.box(tmp_path, (14, 14, 7.968))  # 96 whole layers
    labels = parts.labels(job(part, orientation=orientation, dimensions=3))
    measured, expected = forwards(np.moveaxis(labels, 0, -1)), FORWARDS if up else 1 - FORWARDS
    print(f"{'up' if up else 'down'}: {measured:.4f} of the changes go forwards, expected {expected:.4f}")
    assert measured == pytest.approx(expected, abs=2 * TOLERANCE)  # a fifth of the material


def test_order_of_a_turned_part(tmp_path: Path) -> None:
    """The arrow turns with the part: 0 in the file is +y of the printer after a quarter turn."""
    part = parts.plate(tmp_path, SIDE, SIDE)
    labels = parts.bitmap(job(part, orientation=0, settings={"rotate": [0, 0, 90]}))
    measured = forwards(labels[::-1].T)
    print(f"turned by 90°: {measured:.4f} of the changes go forwards along +y")
    assert measured == pytest.approx(FORWARDS, abs=TOLERANCE)


def test_symmetric_profiles_have_no_order(tmp_path: Path) -> None:
    """A B C B A: as many changes backwards as forwards. The comparison above can fail."""
    part = parts.plate(tmp_path, SIDE, SIDE)
    measured = forwards(parts.bitmap(job(part, profile="symmetric")))
    print(f"symmetric: {measured:.4f} of the changes go forwards")
    assert measured == pytest.approx(0.5, abs=0.02)


# --- arrows and lines --------------------------------------------------------------------------------------


def outward() -> Any:
    return {"vector": [{"expression": f"x - {SIDE / 2}"}, {"expression": f"y - {SIDE / 2}"}, 0]}


def painted(folder: Path, turns: float) -> dict[str, Any]:
    """A picture within ±90° of a direction that turns around the middle."""
    u = (np.arange(96) + 0.5) / 48 - 1
    degrees = (np.rad2deg(turns * np.arctan2(u[::-1, None], u[None, :])) + 90) % 180
    return {
        "image": parts.paint(folder, np.round(degrees / 180 * 65535).astype(np.uint16)), "range": [-90, 90]
    }  # fmt: skip


def in_space(orientation: Any, dimensions: int) -> Any:
    return {"azimuth": orientation, "elevation": 20} if dimensions == 3 else orientation


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("turns", [0.5, -0.5, 1.0])
def test_pictures_that_wrap_are_refused(tmp_path: Path, turns: float, dimensions: int) -> None:
    """The message says which key asks for arrows, where it fails and what to do instead."""
    part = parts.box(tmp_path, (SIDE, SIDE, 3))
    orientation = in_space(painted(tmp_path, turns), dimensions)
    with pytest.raises(amslicer.JobError, match=r"pattern\.profile: cyclic.* x = \d+\.\d, y = ") as error:
        prepare(job(part, orientation=orientation, dimensions=dimensions))
    print(error.value)
    assert "fields.orientation" in str(error.value)
    assert "symmetric" in str(error.value.hint)
    prepare(job(part, orientation=orientation, dimensions=dimensions, profile="symmetric"))


def test_a_step_to_the_opposite_is_refused(tmp_path: Path) -> None:
    step = {"vector": [{"expression": "where(x < 20, 1, -1)"}, 0.1, 0]}
    with pytest.raises(amslicer.JobError, match=r"pattern\.profile"):
        prepare(job(parts.plate(tmp_path, SIDE, SIDE), orientation=step))


def picture_without_wraps(folder: Path) -> dict[str, Any]:
    return {"image": parts.paint(folder, np.tile(np.arange(0, 200, 4, np.uint8), (8, 1))), "range": [-90, 90]}


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("field", ["outward", "gradient", "picture"])
def test_arrows_are_accepted(tmp_path: Path, field: str, dimensions: int) -> None:
    orientation = {
        "outward": lambda: outward(),
        "gradient": lambda: in_space({"gradient": {"axis": "x", "from": 0, "to": 360}}, dimensions),
        "picture": lambda: in_space(picture_without_wraps(tmp_path), dimensions),
    }[field]()
    prepare(job(parts.box(tmp_path, (SIDE, SIDE, 3)), orientation=orientation, dimensions=dimensions))


def test_order_outward_from_the_middle(tmp_path: Path) -> None:
    """Rings A B C A B C on every ray; the innermost three periods left out, where directions differ within a kernel."""
    labels = parts.bitmap(job(parts.plate(tmp_path, SIDE, SIDE), orientation=outward()))
    pitch = parts.pitch_mm(parts.SQUARE)
    angle, radius = np.linspace(0, 2 * np.pi, 1440, endpoint=False)[:, None], np.arange(3, 19, pitch[0])[None, :]
    column = ((SIDE / 2 + radius * np.cos(angle)) / pitch[0]).astype(int)
    row = labels.shape[0] - 1 - ((SIDE / 2 + radius * np.sin(angle)) / pitch[1]).astype(int)
    measured = forwards(labels[row, column])
    print(f"outward: {measured:.4f} of the changes go forwards, of straight sheets {FORWARDS:.4f}")
    assert measured >= 0.98


@pytest.mark.parametrize(
    ("orientation", "calm"),
    [
        (30, True),
        ({"vector": [-3, 2, 0]}, True),
        ({"gradient": {"axis": "x", "from": 0, "to": 180}}, True),  # 4.5° per mm, and distances of 10 mm
        ({"gradient": {"axis": "x", "from": 0, "to": 720}}, False),
        ({"gradient": {"axis": "x", "from": 0, "to": 90, "start": 20, "end": 21}}, False),
        ({"expression": "atan2(y - 20, x - 20)*90/pi"}, False),  # a half-integer defect
    ],
)
def test_where_the_direction_turns_little(tmp_path: Path, orientation: Any, calm: bool) -> None:
    part = parts.job(parts.plate(tmp_path, SIDE, SIDE), orientation=orientation)
    assert turns_little(prepare(part).painted, 10.0, 80.0) == calm
