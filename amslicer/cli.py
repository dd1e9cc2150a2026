"""The command line: which command, which options, and how a failure is told. The work is in `commands`."""

from __future__ import annotations

import argparse
import difflib
import inspect
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from amslicer import __version__
from amslicer.errors import (
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_TERMINATED,
    EXIT_UNEXPECTED,
    AmslicerError,
    StorageError,
    UsageError,
)

USAGE = """\
  amslicer PART --fields FIELDS.yaml [-o OUT] [options]   slice (PART: stl obj ply off glb 3mf)
  amslicer verify OUT [--fields FIELDS.yaml]              check a written stack against its (or other) fields
  amslicer preview PART --fields FIELDS.yaml [-o FILE]    a picture before slicing: painted fields and laminate
  amslicer preview OUT [--layer N] [-o FILE]              a picture of a stack
  amslicer info OUT                                       what is in a stack
  amslicer gallery -o DIR                                 every noise and profile, as pictures
  amslicer devices                                        OpenCL devices, and whether each really works
  amslicer printers                                       the printer profiles
  amslicer init [FIELDS.yaml]                             write a commented starter file
  amslicer schema                                         JSON Schema of the job file, for editors
  amslicer COMMAND --help                                 the options of a command (amslicer slice --help)
"""
EPILOG = """\
exit codes: 0 done, 1 unexpected, 2 usage, 3 job, fields or printer, 4 part, 5 OpenCL device,
6 reading or writing files, 7 verification failed, 130 interrupted, 143 terminated"""
# Commands of the language that this version does not have yet.
PLANNED = ("convert", "check", "batch")


class Stopped(BaseException):
    """SIGINT or SIGTERM arrived."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.code = EXIT_INTERRUPTED if number == signal.SIGINT else EXIT_TERMINATED


class Signals:
    """Stops the run on SIGINT and SIGTERM: at once, and again at the next check if a library swallowed it."""

    def __init__(self) -> None:
        self._arrived: int | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._stop)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Stops if a signal has arrived."""
        if self._arrived is not None:
            raise Stopped(self._arrived)

    def _stop(self, number: int, frame: FrameType | None) -> NoReturn:
        self._arrived = number
        raise Stopped(number)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code; errors become one `error:` line and a `hint:`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    signals = Signals()
    try:
        with signals:
            try:
                return _run(words, signals)
            except Exception:
                signals.check()  # whatever went wrong may only be how a library took the signal
                raise
    except AmslicerError as error:
        if debug:
            raise
        _say(f"error: {error.message}")
        if error.hint:
            _say(f"hint: {error.hint}")
        return error.exit_code
    except Stopped as stopped:
        writing = words and words[0] not in COMMANDS
        _say(
            f"error: {'interrupted' if stopped.code == EXIT_INTERRUPTED else 'terminated'}"
            + ("; the stack is not finished" if writing else "")
        )
        if writing:
            _say("hint: run the same command again with --overwrite")
        return stopped.code
    except BrokenPipeError:  # whoever read our output has left
        return EXIT_OK
    except OSError as error:  # files of ours raise StorageError: this is the terminal's end, or the pipe's
        if debug:
            raise
        _say(f"error: the output cannot be written: {error.strerror or error}")
        return StorageError.exit_code
    except Exception as error:
        if debug:
            raise
        _say(f"error: unexpected {type(error).__name__}: {error}")
        _say("hint: this is a fault of amslicer; run again with --debug and report what it prints")
        return EXIT_UNEXPECTED


def _run(words: list[str], signals: Signals) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(f"amslicer {__version__}: graded multi-material laminates, as per-material bitmaps\n\n{USAGE}\n{EPILOG}")
        return 0
    if words[0] == "--version":
        print(f"amslicer {__version__}")
        return 0
    name = words[0]
    if name in PLANNED and not Path(name).exists():
        raise UsageError(f"`amslicer {name}` is not built yet in this version", hint="see amslicer --help")
    if name in COMMANDS:
        words = words[1:]
    else:
        near = difflib.get_close_matches(name, [*COMMANDS, *PLANNED], n=1)
        if near and not Path(name).exists():
            raise UsageError(f"there is no command and no part '{name}'", hint=f"did you mean amslicer {near[0]}?")
        name = "slice"
    add_options, command = COMMANDS[name]
    usage = "amslicer PART --fields FIELDS.yaml [-o OUT] [options]" if name == "slice" else None
    parser = _Parser(
        prog=f"amslicer {name}", usage=usage, description=inspect.cleandoc(add_options.__doc__ or ""), epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
    )  # fmt: skip
    add_options(parser)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    options = parser.parse_args(words)
    if getattr(options, "jobs", None) is not None:
        # Before NumPy is imported: its linear algebra threads are bounded too.
        os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(options.jobs)
    from amslicer import commands

    signals.check()
    run: Callable[[argparse.Namespace, Callable[[], None]], int] = getattr(commands, command)
    with _spoken(quiet=getattr(options, "quiet", False)):
        return run(options, signals.check)


@contextmanager
def _spoken(*, quiet: bool) -> Iterator[None]:
    """Says on stderr what the library logs, such as that it is compiling."""
    log, handler = logging.getLogger("amslicer"), _Handler()
    log.setLevel(logging.WARNING if quiet else logging.INFO)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


class _Handler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        _say(record.getMessage())


class _Parser(argparse.ArgumentParser):
    """argparse with our errors and exit code."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(message, hint=f"`{self.prog} --help` lists the options; `amslicer --help` the commands")


def _slice_options(parser: argparse.ArgumentParser) -> None:
    """Slices a part with its painted fields into a stack of per-material bitmaps."""
    parser.add_argument("part", metavar="PART", help="the mesh: stl, obj, ply, off, glb or 3mf")
    parser.add_argument("--fields", metavar="FIELDS.yaml", help="the job file (`amslicer init` writes one)")
    parser.add_argument("-o", "--out", metavar="OUT", help="folder of the stack; default: PART's name without suffix")
    job = _job_options(parser)
    job.add_argument("--format", metavar="F", help="output format: png")
    job.add_argument("--compression", choices=("fast", "small"), help="of the files; default: fast")
    job.add_argument("--evaluate", choices=("lattice", "exact"), help="how G is computed (default: lattice)")
    run = parser.add_argument_group("how it is computed (changes no byte, but for the device)")
    run.add_argument("--layers", type=_layer_range, metavar="A:B", help="only these layers; half-open, like Python's")
    _device_options(run)
    run.add_argument("--overwrite", action="store_true", help="replace a stack in OUT; deletes nothing else")
    run.add_argument("--resume", action="store_true", help="not built yet in this version")
    run.add_argument("--dry-run", action="store_true", help="say grid, layers, size and time; write nothing")
    _output_options(run)


def _job_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    job = parser.add_argument_group("what is printed (each overrides a key of the job file)")
    job.add_argument("--printer", metavar="NAME|FILE", help="printer profile (`amslicer printers`)")
    job.add_argument("--seed", type=int, metavar="N", help="of the noise")
    job.add_argument("--scale", type=float, metavar="F", help="factor on the part's lengths")
    job.add_argument("--units", choices=("mm", "cm", "m", "inch"), help="what one unit of the part's file is")
    job.add_argument(
        "--allow-open", action="store_true", default=None,
        help="slice a mesh with holes; pixel rows that pass through them stay empty",
    )  # fmt: skip
    job.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides",
        help="any dotted key of the job file, repeatable: --set pattern.period=0.8",
    )  # fmt: skip
    return job


def _device_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--device", metavar="SUBSTRING", help="part of an OpenCL device's name (`amslicer devices`)")
    group.add_argument(
        "--jobs", type=_positive, metavar="N", help="threads, those of CPU devices included; default: all"
    )
    group.add_argument("--allow-outside", action="store_true", help="read field files outside the job file's folder")


def _verify_options(parser: argparse.ArgumentParser) -> None:
    """Checks a written stack: files, hashes, sizes, counts, partition and volume; then the ratio in windows, direction,
    period and isotropy of the laminate against the painted fields. Exit code 7 when something is wrong."""
    parser.add_argument("out", metavar="OUT", help="folder of the stack")
    parser.add_argument("--fields", metavar="FIELDS.yaml", help="compare with these fields instead of the stack's own")
    parser.add_argument("--maps", metavar="FILE", help="PNG file: maps of the local errors, seen from above")
    parser.add_argument("--report", metavar="FILE", help="not built yet in this version")
    parser.add_argument("--jobs", type=_positive, metavar="N", help="threads; default: all")
    _output_options(parser)


def _preview_options(parser: argparse.ArgumentParser) -> None:
    """Makes a picture: of a part before slicing (painted fields beside layers of the laminate, at fewer pixels), or of
    a stack (a contact sheet, or one layer at full size), in true aspect."""
    parser.add_argument("what", metavar="PART|OUT", help="a mesh file, or the folder of a stack")
    parser.add_argument(
        "-o", "--output", metavar="FILE",
        help="PNG file; default: OUT-preview.png beside OUT, or PART-preview-fields.png in the current folder",
    )  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="print neither notes nor the picture's path")
    parser.add_argument_group("of a stack").add_argument(
        "--layer", type=int, metavar="N", help="this layer alone, every pixel of it"
    )
    part = parser.add_argument_group("of a part")
    part.add_argument("--fields", metavar="FIELDS.yaml", help="the job file; needed")
    _device_options(part)
    _job_options(parser)


def _gallery_options(parser: argparse.ArgumentParser) -> None:
    """Draws every noise with every profile: a sheet of all, and each picture by itself. Needs no OpenCL device."""
    parser.add_argument("-o", "--out", metavar="DIR", required=True, help="folder for gallery.png and the pictures")
    parser.add_argument("--quiet", action="store_true", help="do not print the sheet's path")


def _devices_options(parser: argparse.ArgumentParser) -> None:
    """Lists the OpenCL devices and tries each in a process of its own. Exit code 5 when none works."""
    parser.add_argument("--refresh", action="store_true", help="try again those that worked before")
    _output_options(parser)


def _printers_options(parser: argparse.ArgumentParser) -> None:
    """Lists the printer profiles that come with amslicer."""
    _output_options(parser)


def _init_options(parser: argparse.ArgumentParser) -> None:
    """Writes a commented job file to start from."""
    parser.add_argument("file", nargs="?", default="fields.yaml", metavar="FIELDS.yaml", help="default: fields.yaml")


def _schema_options(parser: argparse.ArgumentParser) -> None:
    """Prints the JSON Schema of the job file (draft 2020-12), for editors:

    amslicer schema > fields.schema.json

    and, as the first line of the job file beside it (VS Code with its YAML extension, and others; `amslicer init`
    writes this line):

    # yaml-language-server: $schema=fields.schema.json
    """


def _info_options(parser: argparse.ArgumentParser) -> None:
    """Says what is in a stack: part, grid, layers, materials, and the job behind it. Looks at no bitmap."""
    parser.add_argument("out", metavar="OUT", help="folder of the stack")
    _output_options(parser)


def _output_options(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")


# Name -> (its options, its function in commands).
COMMANDS: dict[str, tuple[Callable[[argparse.ArgumentParser], None], str]] = {
    "slice": (_slice_options, "slice_command"),
    "verify": (_verify_options, "verify_command"),
    "preview": (_preview_options, "preview_command"),
    "gallery": (_gallery_options, "gallery_command"),
    "devices": (_devices_options, "devices_command"),
    "printers": (_printers_options, "printers_command"),
    "init": (_init_options, "init_command"),
    "schema": (_schema_options, "schema_command"),
    "info": (_info_options, "info_command"),
}


def _layer_range(text: str) -> tuple[int | None, int | None]:
    first, colon, end = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return (int(first) if first else None, int(end) if end else None)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be A:B like Python's slices (0:10, 5:, :20), but is '{text}'") from None


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1, but is '{text}'")
    return int(text)


def _say(text: str) -> None:
    print(text, file=sys.stderr)
