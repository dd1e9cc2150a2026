"""Files that are either whole or not there: temporary name, write, sync, rename; and errors in the user's words."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from amslicer.errors import StorageError, UsageError

# The entries of a stack beside its materials' folders.
MANIFEST, JOB_FILE, INPUTS = "manifest.json", "job.yaml", "inputs"
TEMPORARY = ".amslicer-tmp"  # suffix of files on their way
HINTS = {
    errno.ENOSPC: "make space on the disk and run again with --overwrite",
    errno.EDQUOT: "your disk quota is used up: make space and run again with --overwrite",
    errno.EACCES: "choose a folder that you may write to (-o OUT)",
    errno.EROFS: "the disk is read-only: choose another folder (-o OUT)",
}


@contextmanager
def storage_errors(action: str, path: Path) -> Iterator[None]:
    """Turns operating system errors into a StorageError that names the file."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"cannot {action} '{path}': {error.strerror or error}", hint=HINTS.get(error.errno or 0)
        ) from error


def write_atomically(path: Path, content: bytes | memoryview) -> None:
    """Writes a file so that its name never stands for half of it.

    Raises:
        StorageError: disk full, no permission, …; nothing is left behind.
    """
    temporary = path.with_name(path.name + TEMPORARY)
    with storage_errors("write", path):
        try:
            with temporary.open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise


def space_note(out: Path, size: int, what: str) -> str | None:
    """What to say where a folder's disk has less than `size` bytes free; None where it has, or nobody knows."""
    place = next((folder for folder in (out, *out.absolute().parents) if folder.is_dir()), out)
    try:
        free = shutil.disk_usage(place).free
    except OSError:
        return None
    if size <= free:
        return None
    return f"{what} {size / 1e6:,.1f} MB, and the disk of '{place}' has {free / 1e6:,.1f} MB free"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps every other process out of a folder; the lock dies with the process.

    Raises:
        UsageError: another process has it.
    """
    with storage_errors("open", folder):
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                f"another amslicer is writing to '{folder}'", hint="wait for it, or choose another folder (-o OUT)"
            ) from None
        yield
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Sees that the names in a folder survive a power loss."""
    with storage_errors("write to", folder):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def json_bytes(content: Any) -> bytes:
    """A JSON document as it is written: UTF-8, indented, keys as given."""
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()
