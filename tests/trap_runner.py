"""Runs many command lines in one process, each in a fork of its own: exit code, what was said, peak memory, seconds.

Reads a JSON list of {"folder": …, "words": […]} from stdin, prints a JSON list of results. Importing the package takes
longer than most refusals; every fork starts from the same warm process, which has touched no OpenCL device.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import tempfile
import time
from typing import Any

MAX_ADDRESS_BYTES = 8 << 30  # a trap that springs must not take the machine down
MAX_CPU_SECONDS = 60
WARM = (
    "amslicer.commands", "amslicer.jobfile", "amslicer.specification", "amslicer.stack", "amslicer.report", "PIL.Image",
    "PIL.PngImagePlugin", "PIL.TiffImagePlugin", "ruamel.yaml", "scipy.sparse.csgraph", "trimesh.exchange.load",
)  # fmt: skip


def run(folder: str, words: list[str]) -> dict[str, Any]:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        started = time.monotonic()
        child = os.fork()
        if not child:
            code = 99
            try:
                os.dup2(out.fileno(), 1)
                os.dup2(err.fileno(), 2)
                os.chdir(folder)
                resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_BYTES,) * 2)
                resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_SECONDS,) * 2)
                from amslicer.cli import main

                code = main(words)
                sys.stdout.flush()
                sys.stderr.flush()
            except BaseException:
                import traceback

                traceback.print_exc()
                sys.stderr.flush()
            finally:
                os._exit(code)
        _, status, used = os.wait4(child, 0)
        out.seek(0)
        err.seek(0)
        return {
            "code": os.waitstatus_to_exitcode(status),
            "out": out.read().decode(errors="replace"),
            "err": err.read().decode(errors="replace"),
            "mb": used.ru_maxrss / 1024,
            "seconds": time.monotonic() - started,
        }


if __name__ == "__main__":
    for name in WARM:
        importlib.import_module(name)
    print(json.dumps([run(**task) for task in json.load(sys.stdin)]))
