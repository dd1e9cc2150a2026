"""OFF."""

from __future__ import annotations

import re

import numpy as np

from amslicer.errors import PartError
from amslicer.meshfiles.soup import EXPORT, Soup, expect, joined

_COMMENT = re.compile(rb"#[^\n]*")


def read_off(data: bytes) -> Soup:
    """The vertices and faces of an OFF file; colours behind them are left out.

    Raises:
        PartError: it holds fewer lines than it declares, or a face fewer corners.
    """
    lines = _COMMENT.sub(b"", data).split(b"OFF", 1)[-1].splitlines()
    rows = [words for words in map(bytes.split, lines) if words]
    points, polygons = (int(count) for count in rows[0][:2])
    if min(points, polygons) < 0:
        raise PartError(f"{points} OFF vertices and {polygons} faces declared", hint=EXPORT)
    expect(points + polygons, min(len(rows) - 1, points + polygons), "OFF vertices and faces")
    vertices = np.array([row[:3] for row in rows[1 : 1 + points]], dtype=np.float64).reshape(-1, 3)
    faces = []
    for number, row in enumerate(rows[1 + points : 1 + points + polygons]):
        corners = int(row[0])
        if not 3 <= corners < len(row):
            raise PartError(f"face {number} has {corners} corners declared, {len(row) - 1} found", hint=EXPORT)
        faces.append(np.array(row[1 : 1 + corners], dtype=np.int64))
    equal = len({len(face) for face in faces}) == 1
    return joined([(vertices, np.array(faces) if equal else faces)])
