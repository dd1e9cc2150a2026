"""Tables, summaries and progress on the terminal. Progress goes to stderr, results to stdout."""

from __future__ import annotations

import io
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from amslicer.device import DeviceInfo
    from amslicer.pipeline import Estimate
    from amslicer.specification import Printer
    from amslicer.stack import Result
    from amslicer.stackinfo import StackInfo
    from amslicer.verification import Report

LINE_SECONDS = 10.0  # between two lines of progress where there is no terminal
WIDTH = 120  # columns of tables where there is no terminal


@contextmanager
def progress_bar(verb: str, unit: str, *, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """A callback (done, total): a bar on a terminal, a line now and then otherwise."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        yield from _bar(verb, unit)
    else:
        yield _lines(verb, unit)


def _bar(verb: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(verb), BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeRemainingColumn())
    with Progress(*columns, console=_console(sys.stderr), transient=True) as bar:
        task = bar.add_task(verb, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines(verb: str, unit: str) -> Callable[[int, int], None]:
    first: tuple[float, int] | None = None
    last = time.monotonic()

    def show(done: int, total: int) -> None:
        nonlocal first, last
        now = time.monotonic()
        if first is None:  # what came before the first call was start-up, not speed
            first = now, done
        elif done < total and now - last >= LINE_SECONDS:
            last = now
            left = (now - first[0]) / (done - first[1]) * (total - done)
            print(f"{verb}: {done} of {total} {unit}, about {left:.0f} s left", file=sys.stderr, flush=True)

    return show


@contextmanager
def a_reader_may_leave() -> Iterator[None]:
    """Lets whoever reads our output close the pipe early: the exit code still says what was found."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_notes(notes: Sequence[str]) -> None:
    """What a person should know, one line each, on stderr."""
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def print_result(result: Result) -> None:
    """The summary of a slice, after its notes."""
    print_notes(result.notes)
    rows = [
        (
            m.name, f"{m.pixels:,}", f"{m.volume_mm3:,.2f}", "-" if m.grams is None else f"{m.grams:.3f}",
            f"{100 * m.asked:.2f} %", f"{100 * m.ratio:.2f} %",
        )
        for m in (*result.materials, *([result.void] if result.void else []))
    ]  # fmt: skip
    _table(("material", "pixels", "mm³", "grams", "ratio asked", "ratio got"), rows)
    speed = result.solid_pixels / 1e6 / result.seconds
    part = "" if result.complete else " (a part of the stack)"
    print(
        f"{result.layers} layers{part}, {result.solid_pixels:,} solid pixels "
        f"in {result.seconds:.1f} s ({speed:.1f} Mpx/s)"
    )
    print(f"stack: {result.out}")


def result_dict(result: Result) -> dict[str, Any]:
    """For --json."""
    return {
        "out": str(result.out),
        "complete": result.complete,
        "layers": result.layers,
        "solid_pixels": result.solid_pixels,
        "seconds": round(result.seconds, 3),
        "materials": [vars(m) for m in result.materials],
        **({"void": vars(result.void)} if result.void else {}),
        "notes": list(result.notes),
    }


def print_estimate(found: Estimate) -> None:
    """What --dry-run found, after its notes."""
    print_notes(found.notes)
    rows = [
        ("bitmap", f"{found.width_px} × {found.height_px} px"),
        ("layers", f"{found.layers}"),
        ("files", f"{found.files} (about {found.bytes / 1e6:,.1f} MB)"),
        ("time", f"about {found.seconds:.0f} s on {found.device}"),
    ]
    for name, value in rows:
        print(f"{name:8} {value}")
    print("nothing was written (--dry-run)")


def print_report(found: Report) -> None:
    """What `verify` found."""
    for check in found.checks:
        word = "FAILED" if not check.ok else "ok    " if check.made else "-     "
        print(f"{word} {check.name}{'' if check.made else ' (not checked: the part shows too little of it)'}")
        for problem in check.problems:
            print(f"         {problem}")
    rows = [
        (
            m.name, f"{m.pixels:,}", f"{100 * m.expected:.3f} %", f"{100 * m.ratio:.3f} %",
            f"{100 * m.error:+.3f} %", f"± {100 * m.tolerance:.3f} %", "ok" if m.ok else "FAILED",
        )
        for m in found.materials.values()
    ]  # fmt: skip
    _table(("material", "pixels", "ratio asked", "ratio got", "error", "allowed", ""), rows)
    verdict = "as it was asked for" if found.ok else "NOT as it was asked for"
    print(f"{found.out}: {found.layers} layers, {verdict}")


def print_info(found: StackInfo) -> None:
    """What a stack holds."""
    pitch, printer, pattern = _sides(found.pitch_mm, 1000, ".2f"), found.printer, found.pattern
    layers = f"{found.layer_count} of {1000 * found.layer_mm:g} µm"
    if not found.complete:
        there = ", ".join(f"{first}:{end}" for first, end in found.layer_ranges)
        layers += f"; INCOMPLETE: {found.layers} are there ({there})"
    rows = [
        ("part", f"{found.part}, {' × '.join(f'{v:.5g}' for v in found.size_mm)} mm"),
        ("bitmaps", f"{found.width_px} × {found.height_px} pixels of {pitch} µm"),
        ("layers", layers),
        ("printer", printer.get("name") or ("-" if found.problem else "said in the job file, without a name")),
        ("pattern", _pattern_text(pattern) if pattern else "-"),
        ("device", found.device),
        ("amslicer", found.version),
        ("digest", found.digest),
        ("on disk", f"{found.bytes / 1e6:,.1f} MB in {found.out}"),
    ]
    for name, value in rows:
        print(f"{name:9}{value}")
    if found.problem:
        print(f"{'job':9}cannot be read: {found.problem}")
    materials = [
        (
            m.name, m.color, f"{m.volume_mm3:,.2f}", "-" if m.grams is None else f"{m.grams:.3f}",
            f"{100 * m.asked:.2f} %", f"{100 * m.ratio:.2f} %",
        )
        for m in found.materials
    ]  # fmt: skip
    _table(("material", "colour", "mm³", "grams", "ratio asked", "ratio got"), materials, left=(0, 1))


def _pattern_text(pattern: dict[str, Any]) -> str:
    period, profile = pattern["period"], pattern["profile"]
    shown = f"{period:g} mm" if isinstance(period, float) else "painted"
    return (
        f"{pattern['noise']} in {pattern['dimensions']}D, period {shown}, bandwidth {pattern['bandwidth']:g}, "
        f"profile {profile if isinstance(profile, str) else next(iter(profile))}, seed {pattern['seed']}"
    )


def info_dict(found: StackInfo) -> dict[str, Any]:
    """For --json."""
    return {
        **vars(found),
        "out": str(found.out),
        "layers": found.layers,
        "materials": [vars(m) for m in found.materials],
    }


def print_devices(devices: Sequence[DeviceInfo]) -> None:
    """The OpenCL devices and their verdicts."""
    for d in devices:
        verdict = "works" if d.works else f"does not work: {d.verdict}"
        print(f"{d.label}\n    {d.type}, {d.compute_units} compute units: {verdict}")


def print_printers(printers: Sequence[Printer]) -> None:
    """The printer profiles; "-" where a profile does not say."""
    rows = [
        (
            p.name or "", _sides(p.pitch_mm, 1000, ".2f"), f"{1000 * p.layer_height_mm:g}", _sides(p.bed_mm),
            _sides(p.feature_mm, 1000), "-" if p.max_materials is None else f"{p.max_materials}",
        )
        for p in printers
    ]  # fmt: skip
    head = ("printer", "pixel µm", "layer µm", "bed mm", "smallest feature µm", "materials")
    _table(head, rows, wrapped=range(1, len(head)))


def _sides(lengths: Sequence[float] | None, factor: float = 1, digits: str = "g") -> str:
    """Lengths as one reads them: "42.33 × 84.67", or one number where they are the same."""
    same = lengths[:1] if lengths and len(set(lengths)) == 1 else lengths
    return " × ".join(f"{factor * v:{digits}}" for v in same) if same else "-"


def printer_dict(printer: Printer) -> dict[str, Any]:
    """For --json: None where a profile does not say."""
    return {
        "name": printer.name,
        "description": printer.description,
        "pitch_mm": printer.pitch_mm,
        "layer_mm": printer.layer_height_mm,
        "bed_mm": printer.bed_mm,
        "smallest_feature_mm": printer.feature_mm,
        "max_materials": printer.max_materials,
        "min_layers": printer.min_layers,
        "format": printer.format,
    }


def _table(
    head: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,), wrapped: Sequence[int] = ()
) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for i, name in enumerate(head):
        table.add_column(name, justify="left" if i in left else "right", no_wrap=i not in wrapped)
    for row in rows:
        table.add_row(*row)
    # rich would end the process when the reader of a pipe has left.
    stream = io.StringIO()
    _console(stream, colors=sys.stdout.isatty()).print(table)
    print(stream.getvalue(), end="")


def _console(stream: Any, *, colors: bool = True) -> Console:
    from rich.console import Console

    width = shutil.get_terminal_size((WIDTH, 0)).columns if colors else WIDTH
    return Console(file=stream, width=width, force_terminal=colors, highlight=False)
