"""manifest.json: what a stack holds and what it was made from. No clock time, absolute path or thread count."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from amslicer.errors import StorageError
from amslicer.grid import Grid
from amslicer.placement import Placement
from amslicer.specification import VOID
from amslicer.storage import JOB_FILE, MANIFEST, storage_errors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amslicer.pipeline import Prepared

FORMAT, VERSION = "amslicer-stack", 1


@dataclass(frozen=True)
class LayerRecord:
    """One written layer: index, mid-height, and per material pixels and SHA-256 of its file.

    Attributes:
        void_px: solid pixels where nothing is deposited; None where the job has no such material.
    """

    index: int
    z_mm: float
    pixels: dict[str, int]
    sha256: dict[str, str]
    void_px: int | None = None

    @property
    def solid_px(self) -> int:
        """Pixels within the part."""
        return sum(self.pixels.values()) + (self.void_px or 0)


def describe_stack(
    prepared: Prepared,
    records: list[LayerRecord],
    asked: list[float],
    overlap_px: int,
    *,
    device: str,
    digest: str,
    version: str,
) -> dict[str, Any]:
    """The manifest of a finished stack.

    Args:
        records: the written layers, in order.
        asked: per material, the sum of its painted share over the solid pixels.
        overlap_px: pixels that overlapping bodies have in common, those of three of them twice.
    """
    grid, placement, mesh = prepared.grid, prepared.placement, prepared.mesh
    job = prepared.job
    solid = sum(record.solid_px for record in records)
    wanted = dict(zip(job.materials, asked, strict=True))
    high = placement.origin_mm + placement.size_mm
    return {
        "format": FORMAT,
        "version": VERSION,
        "complete": len(records) == grid.layers,
        "job_digest": digest,
        "amslicer": version,
        "device": device,
        "part": {
            "file": mesh.file,
            **({"copy": job.part_copy, "settings": job.spec.part.model_dump(mode="json")} if job.part_copy else {}),
            "sha256": mesh.sha256,
            "bbox_mm": [_floats(placement.origin_mm), _floats(high)],
            "file_bbox_mm": [_floats(mesh.minimum_mm), _floats(mesh.minimum_mm + mesh.size_mm)],
            "transform": placement.transform(),
            "turned_over": mesh.turned,
            "volume_mm3": prepared.volume_mm3,
            "surface_mm2": _surface_mm2(prepared),
            "overlap_mm3": overlap_px * grid.voxel_mm3,
            **_holes(prepared),
            **_relief(prepared),
        },
        "grid": {
            "width_px": grid.width_px,
            "height_px": grid.height_px,
            "layer_count": grid.layers,
            "margin_px": grid.margin_px,
            "pitch_mm": list(grid.pitch_mm),
            "layer_mm": grid.layer_mm,
            "origin_mm": list(grid.corner_mm(placement.origin_mm.tolist())),
        },
        "materials": [
            {
                "name": material.name,
                "color": material.color,
                **_amount(sum(r.pixels[material.name] for r in records), wanted[material.name], solid, grid),
            }
            for material in job.spec.materials
            if material.name in job.printed
        ],
        **({VOID: _amount(sum(r.void_px or 0 for r in records), wanted[VOID], solid, grid)} if VOID in wanted else {}),
        "solid_pixels": solid,
        "layers": [{key: v for key, v in vars(record).items() if v is not None} for record in records],
    }


def _amount(pixels: int, asked: float, solid: int, grid: Grid) -> dict[str, Any]:
    """How much there is of a material, or of nothing."""
    return {
        "pixels": pixels,
        "volume_mm3": pixels * grid.voxel_mm3,
        "ratio": pixels / solid if solid else 0.0,
        "ratio_asked": asked / solid if solid else 0.0,
    }


def _holes(prepared: Prepared) -> dict[str, Any]:
    """How open the mesh is and which rows of the whole part are empty for it, if it is."""
    holes = prepared.slicer.holes
    if holes is None:
        return {}
    found = holes.count()
    empty: dict[str, Any] = {"open_edges": len(holes.uses), "empty_rows": found.rows if found else 0}
    if found:
        bottom = float(prepared.placement.origin_mm[2])
        low, high = (bottom + prepared.grid.z_mm(layer) for layer in (found.first_layer, found.last_layer))
        empty |= {"layers": found.layers, "z_mm": [low, high]}
    return {"open": empty}


def _relief(prepared: Prepared) -> dict[str, Any]:
    """The part's volume before its surface was moved, and that of the shell which the pattern fills in part."""
    moved = prepared.moved
    if moved is None:
        return {}
    shell = {} if moved.shell_mm3 is None else {"shell_mm3": moved.shell_mm3}
    plain = prepared.mesh.volume_mm3 * prepared.placement.scale**3
    return {"relief": {"triangles": len(moved.surface.triangles), "plain_volume_mm3": plain, **shell}}


def _surface_mm2(prepared: Prepared) -> float:
    corners = prepared.slicer.corners
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(sides, axis=1).sum()) / 2


def _floats(values: NDArray[np.float64]) -> list[float]:
    return [float(v) for v in values]


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a stack.

    Raises:
        StorageError: there is none (no stack, or one that was interrupted), or it is damaged.
    """
    file = folder / MANIFEST
    if not file.is_file():
        hint = "its run was interrupted: run it again with --overwrite" if (folder / JOB_FILE).is_file() else None
        raise StorageError(f"'{folder}' is not a finished stack: it has no {MANIFEST}", hint=hint)
    with storage_errors("read", file):
        content = file.read_bytes()
    try:
        manifest = json.loads(content)
        if manifest["format"] != FORMAT or manifest["version"] != VERSION:
            raise StorageError(
                f"'{file}' is {manifest['format']} version {manifest['version']}; this reads {FORMAT} version {VERSION}"
            )
        grid_of(manifest), placement_of(manifest)
        if not records_of(manifest):
            raise ValueError("it lists no layer")
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise StorageError(f"'{file}' is damaged: {error!r}", hint="slice the part again") from error
    return dict(manifest)


def grid_of(manifest: dict[str, Any]) -> Grid:
    """The grid that a manifest describes."""
    g = manifest["grid"]
    margin = g.get("margin_px", 0)
    return Grid(
        g["width_px"] - 2 * margin, g["height_px"] - 2 * margin, g["layer_count"],
        (g["pitch_mm"][0], g["pitch_mm"][1]), g["layer_mm"], margin,
    )  # fmt: skip


def placement_of(manifest: dict[str, Any]) -> Placement:
    """Where the part stands, as a manifest describes it."""
    part = manifest["part"]
    matrix = np.array(part["transform"], float)
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    if not scale > 0:
        raise ValueError(f"the transform scales by {scale}")
    low_corner, high_corner = np.array(part["bbox_mm"], float)
    file_minimum = np.array(part["file_bbox_mm"][0], float)
    low = low_corner - matrix[:3, 3] - matrix[:3, :3] @ file_minimum
    return Placement(matrix[:3, :3] / scale, scale, low, high_corner - low_corner, low_corner, file_minimum, 0.0)


def records_of(manifest: dict[str, Any]) -> list[LayerRecord]:
    """The layers that a manifest lists."""
    return [LayerRecord(e["index"], e["z_mm"], e["pixels"], e["sha256"], e.get("void_px")) for e in manifest["layers"]]
