"""Verification raises no alarm about honest stacks; `python -m tests.bench.honest` asks for many more of them."""

from __future__ import annotations

from pathlib import Path

import honest_jobs
import pytest

import amslicer

SMALL_PIXELS = 1.2e6


@pytest.mark.parametrize("seed", range(20))
def test_no_alarm_about_an_honest_stack(tmp_path: Path, seed: int) -> None:
    job, content = honest_jobs.honest_job(tmp_path, seed, SMALL_PIXELS)
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, (content, [check.problems for check in report.checks if not check.ok])
