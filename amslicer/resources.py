"""Finds the folders that travel with the package: OpenCL sources (cl/), printer profiles and examples (configs/)."""

from __future__ import annotations

from pathlib import Path

from amslicer.errors import AmslicerError


def resource_folder(name: str) -> Path:
    """The folder `name` ("cl" or "configs"), in an installed wheel or beside the package in a checkout.

    Raises:
        AmslicerError: the installation lacks the folder.
    """
    package = Path(__file__).resolve().parent
    for folder in (package / name, package.parent / name):
        if folder.is_dir():
            return folder
    raise AmslicerError(
        f"the folder '{name}' is missing from this installation of amslicer ({package})",
        hint="install amslicer again: pip install --force-reinstall amslicer",
    )
