"""What each command of the command line does: reads options, calls the library, prints results."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amslicer.errors import CheckFailed, DeviceError, JobError, PartError, UsageError

if TYPE_CHECKING:
    from PIL.Image import Image

    from amslicer.job import Job
    from amslicer.pipeline import Progress, Run

OF_PARTS = ("fields", "printer", "seed", "scale", "units", "device", "jobs")  # options of a preview before slicing


def slice_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer PART --fields FIELDS.yaml"""
    _check_part(options.part, options.fields)
    if options.out == "":
        raise UsageError("-o: the folder's name is empty", hint="leave -o out for the part's name")
    if options.resume:
        raise UsageError("--resume is not built yet in this version", hint="run again with --overwrite")
    from amslicer.pipeline import Run

    job = _load(options, options.part)
    run = Run(options.device, options.jobs, options.layers)
    out = Path(options.out) if options.out else Path(Path(options.part).stem)
    if options.dry_run:
        return _dry_run(job, run, out, options)
    from amslicer import report
    from amslicer.stack import slice_job

    with report.progress_bar("slicing", "layers", quiet=options.quiet) as show:
        result = slice_job(job, out, run=run, overwrite=options.overwrite, progress=_checked(show, check))
    _show(options, report.result_dict(result), lambda: report.print_result(result))
    return 0


def _check_part(part: str, fields: str | None) -> None:
    """Sees that there are a part and a job file to begin with."""
    if not Path(part).exists():
        from amslicer.meshfiles import READERS

        raise PartError(
            f"there is no part '{part}'",
            hint=f"name a mesh file ({' '.join(READERS)}); `amslicer --help` lists the commands",
        )
    if fields is None:
        raise UsageError(
            f"no fields for '{part}': --fields is missing",
            hint=f"`amslicer init` writes a starter file; then: amslicer {part} --fields fields.yaml",
        )


def _show(options: Namespace, data: Any, table: Callable[[], None]) -> None:
    """Prints a result as --json, --quiet or neither asks for; whoever reads it may leave early."""
    from amslicer import report

    with report.a_reader_may_leave():
        if options.json:
            print(json.dumps(data))
        elif not options.quiet:
            table()


def _checked(show: Progress | None, check: Callable[[], None]) -> Progress:
    """A progress callback that also stops the run when a signal has arrived."""

    def both(done: int, total: int) -> None:
        check()
        if show:
            show(done, total)

    return both


def _load(options: Namespace, part: str) -> Job:
    from amslicer.job import load_job
    from amslicer.jobfile import OVERRIDES
    from amslicer.yamlfile import parse_value

    overrides: dict[str, Any] = {}
    printer = options.printer
    if printer and printer.endswith((".yaml", ".yml")):
        printer = str(Path(printer).absolute())  # of the command line: relative to where it was typed
    direct = {
        "printer": printer, "pattern.seed": options.seed, "part.scale": options.scale, "part.units": options.units,
        "part.allow_open": options.allow_open,
        "output.format": getattr(options, "format", None), "pattern.evaluate": getattr(options, "evaluate", None),
        "output.compression": getattr(options, "compression", None),
    }  # fmt: skip
    overrides.update({key: value for key, value in direct.items() if value is not None})
    for setting in options.overrides:
        key, equals, text = setting.partition("=")
        if not equals or not key:
            raise UsageError(f"--set needs KEY=VALUE, but is '{setting}'", hint="for example --set pattern.period=0.8")
        try:
            overrides[key] = parse_value(text, f"--set {key}")
        except JobError as error:
            raise UsageError(error.message, hint=error.hint) from None
    try:
        return load_job(options.fields, part, overrides, allow_outside=options.allow_outside)
    except UsageError as error:
        # Users of the command line know --set and --seed, not the overrides that they become.
        raise UsageError(error.message.replace(OVERRIDES, "command line", 1), hint=error.hint) from None


def _dry_run(job: Job, run: Run, out: Path, options: Namespace) -> int:
    from dataclasses import replace

    from amslicer import report
    from amslicer.pipeline import estimate
    from amslicer.storage import space_note

    found = estimate(job, run)
    if note := space_note(out, found.bytes, "the bitmaps will not fit: they take about"):
        found = replace(found, notes=(*found.notes, note))
    _show(options, vars(found), lambda: report.print_estimate(found))
    return 0


def verify_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer verify OUT"""
    if options.report:
        raise UsageError("--report is not built yet in this version", hint="--json prints everything that was found")
    from amslicer import report
    from amslicer.verification import verify_stack

    with report.progress_bar("verifying", "layers", quiet=options.quiet) as show:
        found = verify_stack(options.out, options.fields, jobs=options.jobs, progress=_checked(show, check))
    if options.maps:
        from amslicer.errormaps import error_maps
        from amslicer.stack import open_stack

        _save_picture(error_maps(found, open_stack(options.out).grid), Path(options.maps))
    _show(options, found.as_dict(), lambda: report.print_report(found))
    return 0 if found.ok else CheckFailed.exit_code


def preview_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer preview PART|OUT"""
    from amslicer.meshfiles import READERS

    what = Path(options.what)
    of_part = what.is_file() or (not what.is_dir() and what.suffix.lower().removeprefix(".") in READERS)
    picture, file = _part_picture(options) if of_part else _stack_picture(options)
    _save_picture(picture, file)
    if not options.quiet:
        print(file)
    return 0


def gallery_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer gallery"""
    from PIL import Image

    from amslicer import report
    from amslicer.figures import FIGURES, figures
    from amslicer.gallery import ROWS, pictures, sheet
    from amslicer.storage import storage_errors

    folder = Path(options.out)
    with storage_errors("create", folder):
        folder.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[tuple[str, Any]]] = {}
    remade: dict[str, list[tuple[str, Any]]] = {}
    steps = len(ROWS) + FIGURES
    with report.progress_bar("drawing", "rows", quiet=options.quiet) as show:
        shown = _checked(show, check)
        for row in ROWS:
            for name, picture in pictures(row):
                check()
                rows.setdefault(row, []).append((name, picture))
                if picture is not None:
                    words = f"{row} {name}".replace(" %", "").replace(",", "")
                    file = "".join(c if c.isalnum() else "-" for c in words).lower()
                    _save_picture(Image.fromarray(picture), folder / f"{file}.png")
            shown(len(rows), steps)
        for name, made in figures():
            remade[name] = made
            shown(len(rows) + len(remade), steps)
    _save_picture(sheet(rows), folder / "gallery.png")
    caption = "figures of Tricard et al. 2019 (phasor) and Lagae et al. 2011 (Gabor), made again"
    _save_picture(sheet(remade, caption), folder / "figures.png")
    if not options.quiet:
        print(folder / "gallery.png", folder / "figures.png", sep="\n")
    return 0


def _save_picture(picture: Image, file: Path) -> None:
    import io

    from amslicer.storage import write_atomically

    stream = io.BytesIO()
    picture.save(stream, "PNG")
    write_atomically(file, stream.getvalue())


def _part_picture(options: Namespace) -> tuple[Image, Path]:
    """The picture of a part before slicing, and the file that it goes to."""
    part = options.what
    if options.layer is not None:
        raise UsageError(f"--layer is for stacks, and '{part}' is a part", hint="leave it out, or slice the part first")
    _check_part(part, options.fields)
    from amslicer import report
    from amslicer.partsheet import part_sheet
    from amslicer.pipeline import Run, prepare

    job = _load(options, part)
    file = Path(options.output or f"{Path(part).stem}-preview-fields.png")
    sources = [Path(part), Path(options.fields), *(job.inputs.folder / path for path in job.input_paths())]
    if file.resolve() in [source.resolve() for source in sources]:
        raise UsageError(f"-o: '{file}' is what the preview is made from", hint="choose another name")
    prepared = prepare(job)
    if not options.quiet:
        report.print_notes(prepared.notes())
    return part_sheet(prepared, Run(options.device, options.jobs)), file


def _stack_picture(options: Namespace) -> tuple[Image, Path]:
    """The picture of a stack, and the file that it goes to."""
    from amslicer.pictures import contact_sheet, layer_picture
    from amslicer.stack import open_stack

    given = [name for name in OF_PARTS if getattr(options, name) is not None]
    if given or options.overrides:
        name = given[0] if given else "set"
        raise UsageError(
            f"--{name} is for parts, and '{options.what}' is not a mesh file",
            hint="the picture of a stack shows what was written: leave it out",
        )
    stack = open_stack(options.what)
    if options.layer is None:
        picture = contact_sheet(stack)
    else:
        positions = {record.index: i for i, record in enumerate(stack.records)}
        if options.layer not in positions:
            raise UsageError(
                f"the stack has no layer {options.layer}", hint=f"it has {min(positions)} to {max(positions)}"
            )
        picture = layer_picture(stack[positions[options.layer]], stack.colors, stack.grid.pitch_mm)
    folder = Path(options.what).resolve()
    ending = "" if options.layer is None else f"-layer{options.layer:05d}"
    return picture, Path(options.output or folder.with_name(f"{folder.name}-preview{ending}.png"))


def info_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer info OUT"""
    from amslicer import report
    from amslicer.stackinfo import describe_folder

    found = describe_folder(options.out)
    _show(options, report.info_dict(found), lambda: report.print_info(found))
    return 0


def devices_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer devices"""
    from amslicer import report
    from amslicer.device import INSTALL_HINT, list_devices

    devices = list_devices(refresh=options.refresh)
    _show(options, [{**vars(d), "works": d.works} for d in devices], lambda: report.print_devices(devices))
    if not any(d.works for d in devices):
        if options.quiet:
            return DeviceError.exit_code
        raise DeviceError("no OpenCL device works on this machine", hint=INSTALL_HINT)
    return 0


def printers_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer printers"""
    from amslicer import report
    from amslicer.printers import printer_names, read_printer
    from amslicer.specification import Printer

    printers = [Printer.model_validate(read_printer(name, Path())) for name in printer_names()]
    _show(options, [report.printer_dict(p) for p in printers], lambda: report.print_printers(printers))
    return 0


def init_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer init"""
    from amslicer.schema import SCHEMA_FILE
    from amslicer.starter import starter_file
    from amslicer.storage import write_atomically

    file = Path(options.file)
    if file.exists():
        raise UsageError(f"'{file}' exists already", hint="choose another name: amslicer init NAME.yaml")
    write_atomically(file, starter_file(file.name).encode())
    print(f"{file}: edit it, then `amslicer part.stl --fields {file} -o out`", file=sys.stderr)
    print(f"for editors that check it: `amslicer schema > {file.with_name(SCHEMA_FILE)}`", file=sys.stderr)
    return 0


def schema_command(options: Namespace, check: Callable[[], None]) -> int:
    """amslicer schema"""
    from amslicer import report
    from amslicer.schema import job_schema
    from amslicer.storage import json_bytes

    with report.a_reader_may_leave():
        print(json_bytes(job_schema()).decode(), end="")
    return 0
