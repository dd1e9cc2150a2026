"""Printer profiles: the YAML files of configs/printers/, or a user's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from amslicer.errors import JobError
from amslicer.resources import resource_folder
from amslicer.yamlfile import read_yaml


def printer_names() -> list[str]:
    """The profiles that come with amslicer."""
    return sorted(file.stem for file in (resource_folder("configs") / "printers").glob("*.yaml"))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def read_printer(name: str, folder: Path) -> dict[str, Any]:
    """A printer's grid by profile name, or by the path of a YAML file (relative to `folder`).

    Raises:
        JobError: there is no such profile or file; the nearest names are in the hint.
    """
    import difflib

    shipped = resource_folder("configs") / "printers" / f"{name}.yaml"
    own = folder / name
    if name in printer_names():
        content = read_yaml(shipped, "printer profile")[0]
    elif own.suffix in (".yaml", ".yml") and _is_file(own):
        content = read_yaml(own, "printer profile")[0]
    else:
        near = difflib.get_close_matches(name, printer_names(), n=3, cutoff=0.4) or printer_names()
        raise JobError(
            f"there is no printer profile '{name}'",
            hint=f"did you mean {' or '.join(near)}? `amslicer printers` lists them; a path must end in .yaml",
        )
    return {"name": Path(name).stem, **content}
