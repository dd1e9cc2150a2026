"""PLY, binary and text."""

from __future__ import annotations

import numpy as np

from amslicer.meshfiles.soup import Soup, expect, joined, load_raw


def read_ply(data: bytes) -> Soup:
    """The vertices and faces of a PLY file.

    Raises:
        PartError: it holds fewer vertices or faces than it declares, or a face uses one that is not there.
    """
    loaded = load_raw(data, "ply")
    for name, element in loaded["metadata"]["_ply_raw"].items():
        if name in ("vertex", "face") and element["length"]:
            columns = element.get("data")  # one structured array, or an array for each column
            rows = columns if isinstance(columns, np.ndarray) else next(iter((columns or {"": ()}).values()))
            expect(element["length"], len(rows), f"PLY {name} rows")
    if "vertices" not in loaded:
        return joined([])
    return joined([(loaded["vertices"], loaded.get("faces", []))])
