"""amslicer: slices a mesh with painted fields into a graded multi-material laminate, as per-material bitmaps.

    import amslicer
    job = amslicer.load_job("fields.yaml", part="part.stl", overrides={"pattern.period": 0.8})
    result = amslicer.slice_job(job, "out")
    report = amslicer.verify("out")

Importing this opens no device, reads no file and prints nothing; heavy modules are loaded when first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amslicer.errors import (
    AmslicerError,
    CheckFailed,
    DeviceError,
    JobError,
    PartError,
    StorageError,
    UsageError,
)

__version__ = "0.1.0"

# Public name -> (module, its name there).
_PUBLIC = {
    "Job": ("amslicer.job", "Job"),
    "Layer": ("amslicer.layer", "Layer"),
    "Result": ("amslicer.stack", "Result"),
    "Run": ("amslicer.pipeline", "Run"),
    "Stack": ("amslicer.stack", "Stack"),
    "field": ("amslicer.pipeline", "field_of_layer"),
    "layers": ("amslicer.pipeline", "layers"),
    "load_job": ("amslicer.job", "load_job"),
    "open_stack": ("amslicer.stack", "open_stack"),
    "slice_job": ("amslicer.stack", "slice_job"),
    "verify": ("amslicer.verification", "verify_stack"),
}

if TYPE_CHECKING:
    from amslicer import analysis as analysis
    from amslicer import noise as noise
    from amslicer.job import Job as Job
    from amslicer.job import load_job as load_job
    from amslicer.layer import Layer as Layer
    from amslicer.pipeline import Run as Run
    from amslicer.pipeline import field_of_layer as field
    from amslicer.pipeline import layers as layers
    from amslicer.stack import Result as Result
    from amslicer.stack import Stack as Stack
    from amslicer.stack import open_stack as open_stack
    from amslicer.stack import slice_job as slice_job
    from amslicer.verification import verify_stack as verify

__all__ = [
    "AmslicerError",
    "CheckFailed",
    "DeviceError",
    "Job",
    "JobError",
    "Layer",
    "PartError",
    "Result",
    "Run",
    "Stack",
    "StorageError",
    "UsageError",
    "__version__",
    "field",
    "layers",
    "load_job",
    "open_stack",
    "slice_job",
    "verify",
]


def __getattr__(name: str) -> Any:
    if name in ("analysis", "noise"):
        from importlib import import_module

        return import_module(f"amslicer.{name}")
    if name not in _PUBLIC:
        raise AttributeError(f"module 'amslicer' has no attribute '{name}'")
    from importlib import import_module

    module, attribute = _PUBLIC[name]
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
