"""Every error that amslicer raises on purpose, and the exit code each one gives.

A message says what is wrong, the value, and where (file, key, layer); the hint says what to try.
Imports nothing of ours.
"""

from __future__ import annotations

EXIT_OK = 0
EXIT_UNEXPECTED = 1
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143


class AmslicerError(Exception):
    """Base of all errors that amslicer raises on purpose.

    Args:
        message: what is wrong, the value, and where.
        hint: what the user can try; None where the message already says it.
    """

    exit_code = EXIT_UNEXPECTED

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return self.message if self.hint is None else f"{self.message}\nhint: {self.hint}"


class UsageError(AmslicerError):
    """The command line, or an argument of the Python API, cannot be used."""

    exit_code = 2


class JobError(AmslicerError):
    """The job file, a field or a printer profile cannot be used, or the job is too large."""

    exit_code = 3


class PartError(AmslicerError):
    """The part is missing, cannot be read, or does not bound a solid."""

    exit_code = 4


class DeviceError(AmslicerError):
    """No OpenCL device works, or the one that was chosen failed."""

    exit_code = 5


class StorageError(AmslicerError):
    """A file or folder of a stack cannot be read or written."""

    exit_code = 6


class CheckFailed(AmslicerError):
    """A written stack is not what was asked for."""

    exit_code = 7
