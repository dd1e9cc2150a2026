"""python -m tests.bench.honest [--count 200] [--seed 1]: how often `verify` raises an alarm about an honest stack."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))  # the tests' own modules

import honest_jobs

import amslicer
from amslicer.judgement import MIN_BLOCKS

SEED_STEP = 1_000_000  # between the jobs of one --seed and the next


def alarms(seed: int) -> tuple[list[str], dict[str, object], bool]:
    """What verification says against an honest job's stack, what the job was, and whether its texture was judged."""
    with tempfile.TemporaryDirectory() as name:
        job, content = honest_jobs.honest_job(Path(name), seed)
        amslicer.slice_job(job, Path(name) / "out")
        report = amslicer.verify(Path(name) / "out")
    said = [f"{check.name.partition(':')[0]}: {p}" for check in report.checks for p in check.problems]
    return said, content, len(report.shown) >= MIN_BLOCKS


def main() -> None:
    """Slices and verifies, printing each alarm as it comes and the figures at the end."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--count", type=int, default=200)
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    laws: Counter[str] = Counter()
    stacks, judged, started = 0, 0, time.monotonic()
    for number in range(chosen.count):
        seed = chosen.seed * SEED_STEP + number
        said, content, texture = alarms(seed)
        judged += texture
        if said:
            stacks += 1
            laws.update({line.partition(":")[0] for line in said})
            print(f"job {seed}: {json.dumps(content)}")
            print("".join(f"  {line}\n" for line in said), end="", flush=True)
    seconds = time.monotonic() - started
    print(f"{stacks} of {chosen.count} honest stacks raised an alarm ({seconds:.0f} s): {dict(laws)}")
    print(f"direction, period and isotropy were judged in {judged} of them; the others show too few blocks")


if __name__ == "__main__":
    main()
