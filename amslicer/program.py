"""Builds the OpenCL programs of cl/: one file per kernel, shared parts by #include, constants by -D options."""

from __future__ import annotations

import hashlib
import logging
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.cache import read_cached, write_cached
from amslicer.errors import DeviceError
from amslicer.resources import resource_folder

if TYPE_CHECKING:
    from collections.abc import Mapping

LOG = logging.getLogger("amslicer")
# No relaxed or native maths: the same job must give the same bytes, and the inner loops need no transcendental.
OPTIONS = ("-cl-std=CL1.2",)


def build(context: Any, device: Any, name: str, constants: Mapping[str, int], folder: Path | None = None) -> Any:
    """The program of cl/`name`.cl for one device, compiled or taken from the user's cache.

    Args:
        context, device: pyopencl's.
        name: file name in cl/ without its suffix.
        constants: macros that the source expects.
        folder: of the source, where it is not cl/; headers are those of cl/.

    Raises:
        DeviceError: the compiler's own words.
    """
    import pyopencl as cl

    headers = sorted(resource_folder("cl").glob("*.h"))
    source = (folder or resource_folder("cl")) / f"{name}.cl"
    options = [*OPTIONS, *(f"-D{key}={value:d}" for key, value in sorted(constants.items()))]
    place = _cache_name(device, [source, *headers], options)
    binary = read_cached(place)
    if binary is not None:
        with suppress(cl.Error):  # a driver that changed under its version: compile again
            return cl.Program(context, [device], [binary]).build()
    _say_once(device.name.strip())
    program = _compile(context, device, source, headers, options)
    with suppress(cl.Error, IndexError):
        write_cached(place, program.get_info(cl.program_info.BINARIES)[0])
    return program


@cache
def _say_once(device: str) -> None:
    LOG.info("compiling the kernels for '%s' (some seconds; kept for the next run)", device)


def _cache_name(device: Any, files: list[Path], options: list[str]) -> str:
    digest = hashlib.sha256()
    for word in (device.name, device.version, device.driver_version, device.platform.version, *options):
        digest.update(word.encode() + b"\0")
    for file in files:
        digest.update(file.read_bytes() + b"\0")
    return f"programs/{files[0].stem}-{digest.hexdigest()[:32]}.bin"


def _compile(context: Any, device: Any, source: Path, headers: list[Path], options: list[str]) -> Any:
    """Compiles and links; headers are programs too, because some compilers refuse include paths with spaces."""
    import pyopencl as cl

    included = [(h.name, cl.Program(context, h.read_text(encoding="utf-8"))) for h in headers]
    program, log = cl.Program(context, source.read_text(encoding="utf-8")), ""
    try:
        with warnings.catch_warnings():
            # pyopencl's own cache of binaries is for programs without headers; ours takes its place.
            warnings.filterwarnings("ignore", message="Pre-build attribute access")
            compiled = program.compile(options=options, devices=[device], headers=included)
            return cl.link_program(  # type: ignore[no-untyped-call]
                context, [compiled], devices=[device]
            )
    except cl.Error as error:
        with suppress(cl.Error):
            log = program.get_build_info(device, cl.program_build_info.LOG)  # type: ignore[no-untyped-call]
        raise DeviceError(
            f"the OpenCL compiler of '{device.name.strip()}' refused {source.name}: {_few_lines(f'{error} {log}')}",
            hint="see `amslicer devices` for devices that work; PoCL also needs `ld` (package binutils)",
        ) from error


def _few_lines(text: str, count: int = 6) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return " | ".join(lines[:count])
