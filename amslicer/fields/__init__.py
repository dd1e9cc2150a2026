"""Painted fields: what a designer gives for ratio and orientation, sampled anywhere in the part.

`SOURCES` is the closed list of field sources: a job file names a source by its key, and everything that
lists them (validation, messages, documentation) reads this table. A new source is one file and one line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Tag

from amslicer.fields.blur import Blur, BlurSource
from amslicer.fields.combination import Clip, ClipSource, Mix, MixSource, Remap, RemapSource, Where, WhereSource
from amslicer.fields.constant import Constant
from amslicer.fields.distance import DistanceSource
from amslicer.fields.expression import ExpressionSource
from amslicer.fields.gradient import GradientSource
from amslicer.fields.image import ImageSource
from amslicer.fields.imagestack import StackSource
from amslicer.fields.meshdata import MeshDataSource
from amslicer.fields.opening import open_field, open_orientation
from amslicer.fields.perbody import PerBodySource
from amslicer.fields.points import PointsSource
from amslicer.fields.source import Frame, Inputs, Sampler, Source
from amslicer.fields.strokes import StrokesSource
from amslicer.fields.texture import TextureSource
from amslicer.fields.vertex import VertexSource
from amslicer.fields.volume import VolumeSource

if TYPE_CHECKING:
    from typing import TypeAlias

SOURCES: dict[str, type[Source]] = {
    "gradient": GradientSource,
    "image": ImageSource,
    "stack": StackSource,
    "expression": ExpressionSource,
    "texture": TextureSource,
    "volume": VolumeSource,
    "mix": MixSource,
    "clip": ClipSource,
    "remap": RemapSource,
    "where": WhereSource,
    "blur": BlurSource,
    "per_body": PerBodySource,
    "mesh_data": MeshDataSource,
    "distance": DistanceSource,
    "vertex": VertexSource,
    "points": PointsSource,
    "strokes": StrokesSource,
}


def source_name(value: Any) -> str | None:
    """Which source a FIELD of the job file uses: a key of SOURCES, "constant", or None."""
    if isinstance(value, Source):
        return next(name for name, kind in SOURCES.items() if isinstance(value, kind))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return "constant"
    if isinstance(value, dict):
        named = [key for key in value if key in SOURCES]
        return named[0] if len(named) == 1 else None
    return None


def describe_sources() -> str:
    """What a FIELD can be, for messages."""
    return "a number, " + ", ".join(f"{{{name}: …}}" for name in SOURCES)


if TYPE_CHECKING:
    FieldSpec: TypeAlias = float | Source
else:
    union = Annotated[Constant, Tag("constant")]
    for _name, _kind in SOURCES.items():
        union = union | Annotated[_kind, Tag(_name)]
    FieldSpec = Annotated[
        union,
        Discriminator(
            source_name,
            custom_error_type="field_source",
            custom_error_message=f"is not a field; a field is {describe_sources()}",
        ),
    ]
    # Fields of fields: their models wait for the whole list, which they are on.
    for _model in (Mix, Clip, Remap, Where, Blur, PerBodySource):
        _model.model_rebuild(_types_namespace={"FieldSpec": FieldSpec})
    for _model in (MixSource, ClipSource, RemapSource, WhereSource, BlurSource):
        _model.model_rebuild()

__all__ = [
    "SOURCES",
    "FieldSpec",
    "Frame",
    "Inputs",
    "Sampler",
    "Source",
    "open_field",
    "open_orientation",
    "source_name",
]
