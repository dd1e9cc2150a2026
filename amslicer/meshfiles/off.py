"""OFF."""

from __future__ import annotations

import re

from amslicer.meshfiles.soup import Soup, expect, joined, load_raw

_COMMENT = re.compile(rb"#[^\n]*")


def read_off(data: bytes) -> Soup:
    """The vertices and faces of an OFF file.

    Raises:
        PartError: it holds fewer lines than it declares.
    """
    lines = _COMMENT.sub(b"", data).split(b"OFF", 1)[-1].splitlines()
    rows = [line for line in lines if line.strip()]
    declared = sum(int(count) for count in rows[0].split()[:2])
    expect(declared, min(len(rows) - 1, declared), "OFF vertices and faces")
    loaded = load_raw(data, "off")
    return joined([(loaded["vertices"], loaded["faces"])])
