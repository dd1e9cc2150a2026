"""For test suites of people who use amslicer: is a stack's ratio what was painted?

import amslicer
from amslicer.testing import assert_ratios

def test_my_insole(tmp_path):
    job = amslicer.load_job("fields.yaml", part="insole.stl")
    amslicer.slice_job(job, tmp_path / "out")
    assert_ratios(amslicer.open_stack(tmp_path / "out"), tolerance=0.005)
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from amslicer.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from amslicer.stack import Stack


def assert_ratios(
    stack: Stack | str | os.PathLike[str],
    *,
    tolerance: float | None = None,
    expected: Mapping[str, float] | None = None,
    windows: bool = True,
) -> None:
    """Asserts that each material's share of a stack's solid is the painted one, in all of it and in its windows.

    Reads every bitmap: what counts is what lies on the disk.

    Args:
        stack: an open stack, or its folder.
        tolerance: how far each material's share may be from the expected one, 0…1; default: as far as chance explains.
        expected: shares by material, 0…1; default: the mean of the painted fields over the solid. Materials that are
            left out are not looked at.
        windows: also hold every window against the painted fields, as `amslicer verify` does.

    Raises:
        AssertionError: with one line per material or window that is wrong.
        AmslicerError: the stack cannot be read, or `expected` names a material that it does not have.
    """
    from amslicer.verification import WINDOWS, verify_stack

    folder = stack if isinstance(stack, str | os.PathLike) else stack.folder
    report = verify_stack(folder)
    unknown = sorted(set(expected or ()) - set(report.materials))
    if unknown:
        raise UsageError(f"there is no material '{unknown[0]}'", hint=f"there are: {', '.join(report.materials)}")
    wrong = []
    for name, material in report.materials.items():
        if expected is not None and name not in expected:
            continue
        asked = material.expected if expected is None else expected[name]
        allowed = material.tolerance if tolerance is None else tolerance
        if not abs(material.ratio - asked) <= allowed:
            wrong.append(
                f"{name}: {material.ratio:.4f} instead of {asked:.4f} "
                f"(error {material.ratio - asked:+.4f}, allowed ± {allowed:.4f})"
            )
    if windows:
        wrong += next(check for check in report.checks if check.name == WINDOWS).problems
    if wrong:
        raise AssertionError(f"{folder}: " + "\n".join(wrong))
