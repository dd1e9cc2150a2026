"""Chooses an OpenCL device that has been seen to work, and holds its context, queue and programs."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from amslicer.cache import read_cached, write_cached
from amslicer.errors import DeviceError, UsageError
from amslicer.program import build

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

VERDICTS = "devices.json"  # in the cache: what the probes said
PROBE_SECONDS = 180  # a cold compiler on a loaded machine takes several seconds; a hanging driver never ends
INSTALL_HINT = (
    "install one: `sudo apt-get install pocl-opencl-icd` (Debian, Ubuntu), `sudo dnf install pocl` (Fedora), "
    "`conda install -c conda-forge pocl` (conda), or your GPU vendor's driver; then `amslicer devices --refresh`"
)
GROUP = 64  # work-items per group of the simple kernels: fits every device


@dataclass(frozen=True)
class DeviceInfo:
    """One OpenCL device, and what its probe said ("ok", a reason, or "" when it was not tried)."""

    platform_index: int
    device_index: int
    platform: str
    name: str
    version: str
    type: str
    compute_units: int
    verdict: str = ""

    @property
    def works(self) -> bool:
        """Whether the probe kernel compiled, ran and gave the right answer."""
        return self.verdict == "ok"

    @property
    def label(self) -> str:
        """Identifies the device and its driver, as recorded in manifests."""
        return f"{self.platform}: {self.name} ({self.version})"


def list_devices(*, refresh: bool = False) -> list[DeviceInfo]:
    """All OpenCL devices, each with its probe's verdict; verdicts are remembered per driver version.

    Args:
        refresh: forget what was remembered and try every device again.
    """
    remembered = {} if refresh else _read_verdicts()
    output = _run_probe([])
    if output is None or output[0] != 0:
        raise DeviceError(
            f"an OpenCL driver ended the process that listed the devices: {_reason(output)}",
            hint="see that the user's cache folder (~/.cache) can be written to and the disk is not full",
        )
    found = []
    for entry in json.loads(output[1] or "[]"):
        device = DeviceInfo(**entry)
        verdict = remembered.get(device.label)
        if verdict != "ok":  # a failure may have been mended since: try again
            verdict = _probe(device)
        found.append(replace(device, verdict=verdict))
    _write_verdicts({device.label: device.verdict for device in found})
    return found


def choose_device(substring: str | None = None) -> DeviceInfo:
    """The first working device whose label contains `substring`; GPUs come before CPUs.

    Raises:
        DeviceError: none matches, or none of those that match works; the message says why.
    """
    devices = _known_devices()
    if not devices:
        raise DeviceError("no OpenCL device was found on this machine", hint=INSTALL_HINT)
    wanted = [d for d in devices if substring is None or substring.lower() in d.label.lower()]
    if not wanted:
        names = "; ".join(d.label for d in devices)
        raise DeviceError(f"no OpenCL device matches --device '{substring}'", hint=f"there are: {names}")
    working = sorted((d for d in wanted if d.works), key=lambda d: "gpu" not in d.type)
    if not working:
        reasons = "; ".join(f"{d.label}: {d.verdict}" for d in wanted)
        raise DeviceError(f"no OpenCL device works ({reasons})", hint=INSTALL_HINT)
    return working[0]


def ask_ahead() -> None:
    """Starts to ask for the devices in another thread; what goes wrong is said to whoever needs them."""
    _asked()


def _known_devices() -> tuple[DeviceInfo, ...]:
    try:
        return _asked().result()
    except BaseException:
        _asked.cache_clear()  # it may be mended before someone asks again
        raise


@cache
def _asked() -> Future[tuple[DeviceInfo, ...]]:
    """The devices, asked for once per process: a probe is a process of its own."""
    answer: Future[tuple[DeviceInfo, ...]] = Future()

    def ask() -> None:
        try:
            answer.set_result(tuple(list_devices()))
        except BaseException as error:  # for whoever asks
            answer.set_exception(error)

    Thread(target=ask, daemon=True).start()
    return answer


class Device:
    """An open OpenCL device: context, in-order queue, programs. Close it, or use it in a `with` statement.

    Args:
        substring: part of the device's label; None takes the first that works.
        jobs: threads that a CPU device may use; None means all.
    """

    def __init__(self, substring: str | None = None, jobs: int | None = None) -> None:
        if jobs is not None and jobs < 1:
            raise UsageError(f"jobs must be at least 1, but is {jobs}")
        self.info = choose_device(substring)
        import pyopencl as cl

        device = cl.get_platforms()[self.info.platform_index].get_devices()[self.info.device_index]
        if jobs is not None and self.is_cpu and device.max_compute_units > jobs:
            partition: list[Any] = [cl.device_partition_property.BY_COUNTS, jobs, 0]
            device = device.create_sub_devices(partition)[0]
        self.device = device
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context, device)
        self._scratch: dict[str, Any] = {}
        self._kernels: dict[tuple[str, tuple[tuple[str, int], ...]], Any] = {}

    @property
    def label(self) -> str:
        """Identifies the device and its driver, whatever its number of threads."""
        return self.info.label

    @property
    def is_cpu(self) -> bool:
        """Whether the device is a CPU (work shapes follow this)."""
        return "cpu" in self.info.type

    @property
    def vector_width(self) -> int:
        """Native float vector width, 1 to 16."""
        return int(min(16, max(1, self.device.native_vector_width_float)))

    def kernel(self, file: str, constants: Mapping[str, int] | None = None) -> Any:
        """The kernel of cl/`file`.cl (it has the file's name), built once with these constants."""
        import pyopencl as cl

        key = (file, tuple(sorted((constants or {}).items())))
        if key not in self._kernels:
            self._kernels[key] = cl.Kernel(build(self.context, self.device, file, constants or {}), file)
        return self._kernels[key]

    def other_queue(self) -> Any:
        """A queue whose work waits for nothing in the device's own."""
        import pyopencl as cl

        return cl.CommandQueue(self.context, self.device)

    def run(self, kernel: Any, size: int, *arguments: Any, queue: Any = None) -> None:
        """Enqueues a kernel over at least `size` work-items; the kernel ignores those beyond.

        The work-group size is fixed: drivers such as PoCL compile anew for every size that they meet.
        """
        kernel(queue or self.queue, (-(-size // GROUP) * GROUP,), (GROUP,), *arguments)

    def buffer(self, array: NDArray[Any]) -> Any:
        """A read-only device copy of `array` (at least one byte long)."""
        import numpy as np
        import pyopencl as cl

        array = np.ascontiguousarray(array)
        if array.nbytes == 0:
            return self.empty(4)
        self._check_size(array.nbytes)
        return cl.Buffer(self.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def empty(self, nbytes: int) -> Any:
        """An uninitialised device buffer of `nbytes` bytes."""
        import pyopencl as cl

        self._check_size(nbytes)
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(nbytes, 4))

    def scratch(self, name: str, nbytes: int) -> Any:
        """The device's buffer of this name, at least `nbytes` long; its content is whatever was left in it."""
        if name not in self._scratch or self._scratch[name].size < nbytes:
            self._scratch.pop(name, None)
            self._scratch[name] = self.empty(nbytes)
        return self._scratch[name]

    def fill_zeros(self, buffer: Any, nbytes: int) -> None:
        """Enqueues zeros into the start of a buffer."""
        import numpy as np
        import pyopencl as cl

        cl.enqueue_fill_buffer(self.queue, buffer, np.zeros(1, np.uint8), 0, nbytes)

    def read(self, buffer: Any, out: NDArray[np.generic], queue: Any = None) -> None:
        """Copies the start of `buffer` into the contiguous array `out` and waits for it."""
        import pyopencl as cl

        cl.enqueue_copy(queue or self.queue, out, buffer)

    def write(self, buffer: Any, array: NDArray[np.generic], queue: Any = None) -> None:
        """Copies a contiguous array to the start of `buffer` and waits for it."""
        import pyopencl as cl

        cl.enqueue_copy(queue or self.queue, buffer, array)

    def _check_size(self, nbytes: int) -> None:
        limit = self.device.max_mem_alloc_size
        if nbytes > limit:
            raise DeviceError(
                f"a buffer of {nbytes / 1e6:.0f} MB is needed, but '{self.info.name}' allows {limit / 1e6:.0f} MB",
                hint="choose a coarser printer grid or another device (--device)",
            )

    def __enter__(self) -> Device:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        import pyopencl as cl

        if isinstance(error, cl.Error):
            raise DeviceError(
                f"the OpenCL device '{self.info.name}' failed: {error}",
                hint="try another device (--device), fewer pixels per layer (--printer) or a larger period",
            ) from error
        self.close()

    def close(self) -> None:
        """Waits for the queue and lets go of the device."""
        self.queue.finish()
        self._kernels.clear()
        self._scratch.clear()


def _probe(device: DeviceInfo) -> str:
    result = _run_probe([str(device.platform_index), str(device.device_index)])
    if result is not None and result[0] == 0 and result[1].strip().endswith("ok"):
        return "ok"
    return _reason(result)


def _reason(result: tuple[int, str, str] | None) -> str:
    """Why a probe failed, in its own words."""
    if result is None:
        return f"no answer within {PROBE_SECONDS} s"
    code, stdout, stderr = result
    if code < 0:
        return f"the driver ended the process (signal {-code})"
    lines = [line for line in (stdout + "\n" + stderr).splitlines() if line.strip()]
    telling = [line for line in lines if "error" in line.lower() or "wrong" in line.lower()]
    return (telling or lines or [f"exit code {code}"])[-1].strip()[:300]


def _run_probe(arguments: list[str]) -> tuple[int, str, str] | None:
    """Runs the probe in a process of its own: (exit code, stdout, stderr), or None when it hangs."""
    package = str(Path(__file__).resolve().parent.parent)
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [package, environment.get("PYTHONPATH")]))
    words = [sys.executable, "-m", "amslicer.probe", *arguments]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as probe:  # fmt: skip
        atexit.register(probe.kill)  # when the job is refused meanwhile
        try:
            stdout, stderr = probe.communicate(timeout=PROBE_SECONDS)
        except subprocess.TimeoutExpired:
            return None
        finally:
            probe.kill()
            atexit.unregister(probe.kill)
    return probe.returncode, stdout, stderr


def _read_verdicts() -> dict[str, str]:
    try:
        content = json.loads(read_cached(VERDICTS) or b"{}")
        return {str(key): str(value) for key, value in content.items()}
    except (ValueError, AttributeError):
        return {}


def _write_verdicts(verdicts: dict[str, str]) -> None:
    write_cached(VERDICTS, json.dumps(verdicts).encode())
