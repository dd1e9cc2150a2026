"""Runs as a child process: lists the OpenCL devices, or tries one of them with a known answer.

A broken OpenCL driver can end the process that touches it (PoCL aborts on a damaged cache), or list a device
that cannot compile (PoCL 3.0 on processors newer than itself). So nobody trusts a device that this program,
in a process of its own, has not seen give the right answer.

    python -m amslicer.probe               prints the devices as JSON
    python -m amslicer.probe PLATFORM N    tries device N of platform PLATFORM; exit 0 and "ok" when it works
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any

# Philox-4x32-10 of an all-zeros and an all-ones counter and key (the algorithm's published known answers).
PHILOX_KNOWN = (
    (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
    (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
)
PROBE_SUM = sum(i * i + math.exp(-i) for i in range(16))
PROBE_TOLERANCE = 1e-2  # float32 sums of about 1240


def list_devices() -> list[dict[str, Any]]:
    """One mapping per device: platform and device index, names, versions, type."""
    import pyopencl as cl

    try:
        platforms = cl.get_platforms()
    except cl.LogicError:  # the loader found no driver at all
        return []
    found = []
    for p, platform in enumerate(platforms):
        try:
            devices = platform.get_devices()
        except cl.Error:  # a platform without devices
            continue
        for d, device in enumerate(devices):
            found.append(
                {
                    "platform_index": p,
                    "device_index": d,
                    "platform": platform.name.strip(),
                    "name": device.name.strip(),
                    "version": f"{device.version.strip()} / {device.driver_version.strip()}",
                    "type": _type_name(device.type),
                    "compute_units": device.max_compute_units,
                }
            )
    return found


def _type_name(flags: int) -> str:
    import pyopencl as cl

    kinds = (("gpu", cl.device_type.GPU), ("cpu", cl.device_type.CPU), ("accelerator", cl.device_type.ACCELERATOR))
    return next((name for name, flag in kinds if flags & flag), "other")


def try_device(platform_index: int, device_index: int) -> str:
    """Compiles and runs the probe kernel; returns "ok" or what was wrong."""
    import numpy as np
    import pyopencl as cl

    from amslicer.program import build

    device = cl.get_platforms()[platform_index].get_devices()[device_index]
    context = cl.Context([device])
    program = build(context, device, "probe", {})
    queue = cl.CommandQueue(context)
    words = np.zeros((2, 4), np.uint32)
    sums = np.zeros(2, np.float32)
    words_buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, words.nbytes)
    sums_buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, sums.nbytes)
    cl.Kernel(program, "probe")(queue, (2,), None, words_buffer, sums_buffer)
    cl.enqueue_copy(queue, words, words_buffer)
    cl.enqueue_copy(queue, sums, sums_buffer)
    queue.finish()
    if tuple(map(tuple, words.tolist())) != PHILOX_KNOWN:
        return f"wrong integers: {words.tolist()}"
    if not np.all(np.abs(sums - PROBE_SUM) < PROBE_TOLERANCE):
        return f"wrong sums: {sums.tolist()} instead of {PROBE_SUM:.3f}"
    return "ok"


def main() -> int:
    """Lists or tries, as the arguments say."""
    if len(sys.argv) == 1:
        print(json.dumps(list_devices()))
        return 0
    verdict = try_device(int(sys.argv[1]), int(sys.argv[2]))
    print(verdict)
    return 0 if verdict == "ok" else 1


if __name__ == "__main__":
    raise SystemExit(main())
