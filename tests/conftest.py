"""What tests of many modules share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from amslicer.device import Device


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    with Device() as device:
        yield device
