"""The job file's language: every key, its type, range and default, as validated frozen data.

What a key means is said once, in its description here. Messages take keys and ranges from here, the starter file
its defaults.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from amslicer.fields import SOURCES, FieldSpec, source_name
from amslicer.fields.materialmap import MaterialMap
from amslicer.fields.source import Number
from amslicer.grid import MM_PER_INCH
from amslicer.noise import NOISES
from amslicer.noise.hyperplanes import DEPTH, DIRECTIONS, PROBABILITY
from amslicer.noise.lobes import MOST as MAX_LOBES
from amslicer.noise.spectra import SHAPES as SPECTRUM_SHAPES
from amslicer.noise.spectra import SpectrumSpec
from amslicer.noise.waves import MAX_DIRECTIONS
from amslicer.profiles.waveforms import SHAPES, Blend, Harmonic, ProfileSpec
from amslicer.storage import INPUTS, JOB_FILE, MANIFEST

Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Positive = Annotated[Number, Field(gt=0)]

MAX_SEED = 2**64 - 1
MIN_DIRECTIONS = 4  # fewer waves are gratings
MAX_TIME = 1e6  # periods: beyond, float64 forgets where waves began
MAX_DEPTH = 12  # of divisions: cells of the last are then a thousandth of the first
MIN_IMPULSES = 2  # fewer kernels leave empty places, where there is no phase and the ratio is wrong
MIN_PITCH_MM, MAX_PITCH_MM = 1e-4, 1e3  # finer than light, coarser than a part: a mistake
# Folder names on every file system, and the names of the stack's own entries.
MATERIAL_NAME = r"^[A-Za-z0-9][A-Za-z0-9 _.+-]{0,63}$"
RESERVED_NAMES = (INPUTS, MANIFEST, JOB_FILE)
# Distinct colours for materials that are given without one (the first two are the README's).
DEFAULT_COLORS = ("#2b6cb0", "#f6ad55", "#38a169", "#e53e3e", "#805ad5", "#d69e2e", "#319795", "#718096")

# Pairs of a printer's keys that say the same thing.
ALTERNATIVES = (("dpi", "pitch_um"), ("layer_mm", "layer_um"))
REST = "rest"  # of a ratio per material: what the others leave
VOID = "void"  # the material that stands for nothing: no bitmap is written for it
FORMAT_NAMES = ("png", "grabcad", "gcvf", "sl1", "tiff", "zarr", "vti", "nrrd", "3mf", "svx")


class Model(BaseModel):
    """Base of the job file's sections: unknown keys are refused, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Printer(Model):
    """A printer's grid, and what is known of the machine. Pitch as dpi or pitch_um, layer as layer_mm or layer_um."""

    name: str | None = Field(default=None, description="the profile that this grid comes from")
    description: str | None = Field(default=None, description="one line for `amslicer printers`")
    dpi: Positive | tuple[Positive, Positive] | None = Field(default=None, description="dots per inch, or [x, y]")
    pitch_um: Positive | tuple[Positive, Positive] | None = Field(default=None, description="pixel size, or [x, y]")
    layer_mm: Positive | None = Field(default=None, description="layer height")
    layer_um: Positive | None = Field(default=None, description="layer height")
    margin_px: Annotated[Whole, Field(ge=0, le=10_000)] = Field(default=0, description="empty pixels on each side")
    smallest_feature_um: Positive | tuple[Positive, Positive, Positive] | None = Field(
        default=None, description="thinnest sheet that the machine makes, or [x, y, z]; thinner ones are noted"
    )
    bed_mm: tuple[Positive, Positive, Positive] | None = Field(
        default=None, description="largest part, [x, y, z] in mm; larger ones are noted"
    )
    max_materials: Annotated[Whole, Field(ge=1)] | None = Field(
        default=None, description="materials in one print; a job with more is refused"
    )
    min_layers: Annotated[Whole, Field(ge=1)] | None = Field(
        default=None, description="layers that the machine's software needs; fewer are noted"
    )
    # A wish, not an order: a profile may name a format that is not built yet, so that the profile need not change when
    # it is. The job is then written as png, and a note says so; refusing it would make the whole profile useless.
    format: Literal[FORMAT_NAMES] | None = Field(  # type: ignore[valid-type]
        default=None, description="what the machine's software takes: output.format where the job names none"
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> Printer:
        for pair in ALTERNATIVES:
            given = [key for key in pair if getattr(self, key) is not None]
            if len(given) != 1:
                raise ValueError(f"needs exactly one of {pair[0]} and {pair[1]}, but has {len(given)}")
        for pitch in (*self.pitch_mm, self.layer_height_mm):
            if not MIN_PITCH_MM <= pitch <= MAX_PITCH_MM:
                raise ValueError(f"makes a pixel or layer of {pitch:g} mm; between 0.1 µm and 1 m is accepted")
        return self

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Pixel size along x and y."""
        if self.dpi is not None:
            x, y = self.dpi if isinstance(self.dpi, tuple) else (self.dpi, self.dpi)
            return MM_PER_INCH / x, MM_PER_INCH / y
        assert self.pitch_um is not None
        x, y = self.pitch_um if isinstance(self.pitch_um, tuple) else (self.pitch_um, self.pitch_um)
        return x / 1000, y / 1000

    @property
    def layer_height_mm(self) -> float:
        """Layer height."""
        if self.layer_mm is not None:
            return self.layer_mm
        assert self.layer_um is not None
        return self.layer_um / 1000

    @property
    def feature_mm(self) -> tuple[float, float, float] | None:
        """Smallest feature along x, y and z, where it is known."""
        um = self.smallest_feature_um
        if um is None:
            return None
        x, y, z = um if isinstance(um, tuple) else (um, um, um)
        return x / 1000, y / 1000, z / 1000


class PartSettings(Model):
    """How the part's file is read and placed."""

    units: Literal["mm", "cm", "m", "inch"] | None = Field(
        default=None, description="what one unit of the file is; default: mm, or the unit that a 3MF states"
    )
    scale: Positive = Field(default=1.0, description="factor on all lengths of the part")
    rotate: tuple[Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0), description="degrees about the file's x, then y, then z axis"
    )
    on_bed: Flag = Field(default=True, description="move the part's lowest point to z = 0")
    allow_open: Flag = Field(
        default=False, description="slice a mesh with holes; pixel rows that pass through them stay empty"
    )


class Material(Model):
    """One printable material."""

    name: str = Field(pattern=MATERIAL_NAME, description="also the name of its folder")
    color: str = Field(pattern=r"^#[0-9A-Fa-f]{6}$", description="#rrggbb, for pictures; default: one of a list")
    density_g_cm3: Positive | None = Field(default=None, description="for the weights in the summary")

    @field_validator("name")
    @classmethod
    def _not_reserved(cls, name: str) -> str:
        if name.lower() in RESERVED_NAMES or name.endswith((".", " ")):
            raise ValueError(f"'{name}' cannot be a material's name: a folder of the stack is called by it")
        return name


class Lobe(Model):
    """One of several directions that kernels take, relative to the painted one."""

    angle: Number = Field(description="degrees from the painted normal")
    about: Literal["x", "y", "z"] = Field(default="z", description="the file's axis to turn about; z in 2D")
    weight: Positive = Field(default=1.0, description="share of the kernels, relative to the other lobes'")


class Pattern(Model):
    """The laminate's noise and profile."""

    noise: Literal[tuple(NOISES)] = Field(default="phasor", description="the random field")  # type: ignore[valid-type]
    dimensions: Literal[2, 3] = Field(default=3, description="3: solid laminate; 2: the same pattern in every layer")
    period: FieldSpec = Field(default=1.0, description="mm between two sheets of a material, in the printed part")
    bandwidth: Annotated[Number, Field(gt=0, le=2)] = Field(default=0.5, description="relative to 1/period")
    impulses: Annotated[Number, Field(ge=MIN_IMPULSES, le=100)] | None = Field(
        default=None, description="kernels per bandwidth^dimensions; default per noise"
    )
    alignment: Annotated[Whole, Field(ge=0, le=10_000)] = Field(
        default=0, description="phase-alignment sweeps: 20 leave hardly a sheet that ends inside the part"
    )
    lobes: tuple[Lobe, ...] = Field(
        default=(), max_length=MAX_LOBES, description="several directions at every place; none: the painted one alone"
    )
    directions: Annotated[Whole, Field(ge=MIN_DIRECTIONS, le=MAX_DIRECTIONS)] | None = Field(
        default=None,
        description=f"directions of waves or walls; default: as many as the bandwidth needs, or {DIRECTIONS}",
    )
    probability: Annotated[Number, Field(ge=0, le=1)] | None = Field(
        default=None, description=f"that a cell of wave-stit is divided further; default {PROBABILITY}"
    )
    depth: Annotated[Whole, Field(ge=0, le=MAX_DEPTH)] | None = Field(
        default=None, description=f"how often a cell of wave-stit is divided, at most; default {DEPTH}"
    )
    exemplar: str | None = Field(
        default=None, min_length=1, description="picture to imitate, grey or RGB PNG or TIFF, relative to the job file"
    )
    exemplar_pixel_mm: Annotated[Number, Field(ge=MIN_PITCH_MM, le=MAX_PITCH_MM)] | None = Field(
        default=None, description="size of its pixels in the part; default: the printer's, along x"
    )
    planes: tuple[Literal["xy", "xz", "yz"], ...] = Field(
        default=("xy",),
        min_length=1,
        max_length=3,
        description="of wave-by-example in 3D: which planes show the picture",
    )
    spectrum: SpectrumSpec = Field(
        default="laminate",
        description="amplitudes of waves over their frequency: laminate, white, blue, brown, {power: exponent}, "
        "{gaussian: peak}, {table: [[frequency, amplitude], ...]}; or the wave itself: crystal, web",
    )
    reads: Literal["phase", "real", "modulus"] | None = Field(
        default=None, description="what of wave noise becomes material; default: phase (real of crystal and web)"
    )
    time: Annotated[Number, Field(ge=-MAX_TIME, le=MAX_TIME)] = Field(
        default=0.0, description="how far waves have travelled, in periods: a family of related parts"
    )
    fourth: Annotated[Number, Field(ge=-MAX_TIME, le=MAX_TIME)] = Field(
        default=0.0, description="a fourth coordinate, in periods: waves move with it at speeds of their own"
    )
    evaluate: Literal["lattice", "exact"] = Field(default="lattice", description="how G is computed")
    profile: ProfileSpec = Field(
        default="pwm",
        description="phase to material: pwm (= symmetric), A B C B A … across the sheets; cyclic, A B C A B C …; or "
        "where a waveform is highest: {table: [...]}, {harmonics: [...]}, {square: duty}, or a blend of two",
    )
    edges: Literal["sharp", "dithered"] = Field(
        default="sharp", description="of sheets: as the pixel centres see them, or unbiased at random within the pixel"
    )
    seed: Annotated[Whole, Field(ge=0, le=MAX_SEED)] = Field(default=1, description="another seed, another laminate")


class AzimuthElevation(Model):
    """A direction in space: two fields in degrees."""

    # Without either key it is not recognised as a direction in space.
    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    azimuth: FieldSpec = Field(default=0.0, description="from +x towards +y")
    elevation: FieldSpec = Field(default=0.0, description="above the xy plane")


class VectorComponents(Model):
    """A direction in space: three fields of any length together."""

    vector: tuple[FieldSpec, FieldSpec, FieldSpec] = Field(description="along the file's x, y and z axes")


def _orientation_kind(value: Any) -> str:
    if isinstance(value, AzimuthElevation) or (isinstance(value, dict) and {"azimuth", "elevation"} & set(value)):
        return "azimuth/elevation"
    if isinstance(value, VectorComponents) or (isinstance(value, dict) and "vector" in value):
        return "vector"
    return "field"


OrientationSpec = Annotated[
    Annotated[AzimuthElevation, Tag("azimuth/elevation")]
    | Annotated[VectorComponents, Tag("vector")]
    | Annotated[FieldSpec, Tag("field")],
    Discriminator(_orientation_kind),
]


def _share_kind(value: Any) -> str:
    return REST if value == REST else "share"


def _ratio_kind(value: Any) -> str:
    if isinstance(value, MaterialMap):
        return "material map"
    if isinstance(value, dict) and isinstance(value.get("map"), str) and value["map"] != REST:
        return "material map"  # a number there is the share of a material of that name
    if not isinstance(value, dict) or set(value) & set(SOURCES):
        return "field"
    return "per material" if any(v == REST or source_name(v) for v in value.values()) else "field"


ShareSpec = Annotated[
    Annotated[Literal["rest"], Tag(REST)] | Annotated[FieldSpec, Tag("share")], Discriminator(_share_kind)
]
# By a material's name; a mapping with a source's key in it is a field.
Shares = Annotated[
    dict[str, ShareSpec],
    Field(min_length=2, json_schema_extra={"propertyNames": {"not": {"enum": [*SOURCES]}}}),
]
RatioSpec = Annotated[
    Annotated[Shares, Tag("per material")]
    | Annotated[FieldSpec, Tag("field")]
    | Annotated[MaterialMap, Tag("material map")],
    Discriminator(_ratio_kind),
]


def shares_by_material(ratio: Any, names: Sequence[str]) -> dict[str, Any] | None:
    """A share, or `rest`, per material that is given one; None where one field stands for too many materials.

    One field is the first of two materials' share; `void` needs none where others have theirs.
    """
    if isinstance(ratio, dict):
        absent = {VOID: 0.0} if VOID in names and VOID not in ratio else {}
        return {**ratio, **absent}
    two = list(names) if len(names) == 2 else [name for name in names if name != VOID]
    if len(two) != 2:
        return None
    return {**dict.fromkeys(names, 0.0), two[0]: ratio, two[1]: REST}


class Fields(Model):
    """What is painted on the part."""

    ratio: RatioSpec = Field(
        description="share of the first of two materials, 0 to 1; or a share per material, at most one of them `rest`"
    )
    orientation: OrientationSpec = Field(
        default=0.0,
        description="the laminate's normal: degrees from +x towards +y, {azimuth, elevation}, or {vector: [x, y, z]}",
    )
    isotropy: FieldSpec = Field(default=0.0, description="0: laminate … 1: isotropic")


class SkinSettings(Model):
    """A shell of one material around the part, whatever the pattern is inside."""

    material: str = Field(description="one of the materials")
    thickness_mm: Positive = Field(description="from the surface inwards, in the printed part")
    top_mm: Annotated[Number, Field(ge=0)] | None = Field(
        default=None, description="below surfaces that face up; 0: none; default: as thick as elsewhere"
    )
    bottom_mm: Annotated[Number, Field(ge=0)] | None = Field(
        default=None, description="above surfaces that face down; 0: none; default: as thick as elsewhere"
    )


class BodySettings(Model):
    """What one body of the part is made of."""

    material: str | None = Field(default=None, description="the whole of it; void: a cavity; default: the pattern")
    priority: Whole = Field(default=0, description="where bodies overlap the highest counts; of equals the later one")


class Displacement(Model):
    """How the part's surface moves along its normal."""

    amplitude_mm: Number = Field(description="how far at most, outwards; below 0 inwards; mm in the printed part")
    profile: ProfileSpec | None = Field(
        default=None,
        description="height over the pattern's phase: sine (the default), triangle, sawtooth, square, pwm (up where "
        "the first material is), {table: [...]}, {harmonics: [...]}, {square: duty}, or a blend of two",
    )
    field: FieldSpec | None = Field(default=None, description="height instead of the pattern's, 0 to 1; a field")
    at: FieldSpec = Field(default=1.0, description="share of the amplitude, 0 to 1; a field")
    both_ways: Flag = Field(default=False, description="half of the amplitude inwards, half outwards")
    resolution_mm: Positive | None = Field(
        default=None,
        description="longest edge of the triangles that are moved; default: 1/12 of the pattern's shortest period, "
        "1/36 where the profile jumps, a pixel at least",
    )

    @model_validator(mode="after")
    def _one_height(self) -> Displacement:
        if self.field is not None and self.profile is not None:
            raise ValueError("has a field and a profile, which are two heights: give one of them")
        if self.profile in ("symmetric", "cyclic"):
            raise ValueError(f"profile {self.profile} is an order of materials, no height: use triangle or sawtooth")
        return self

    @property
    def waveform(self) -> ProfileSpec:
        """The profile, or its default."""
        return "sine" if self.profile is None else self.profile


class Output(Model):
    """How the stack is written."""

    format: Literal["png"] = Field(default="png", description="files of the stack")
    compression: Literal["fast", "small"] = Field(default="fast", description="size against speed of the files")


class JobFile(Model):
    """A whole job file, with its defaults filled in."""

    printer: Printer = Field(description="pixels and layers: a profile's name, a .yaml file, or the grid itself")
    part: PartSettings = Field(default=PartSettings(), description="how the part's file is read and placed")
    materials: tuple[Material, ...] = Field(min_length=2, max_length=8, description="in the order of the profile")
    pattern: Pattern = Field(default=Pattern(), description="the laminate: noise, period, profile")
    fields: Fields = Field(description="what is painted on the part")
    skin: SkinSettings | None = Field(default=None, description="a shell of one material around the part")
    bodies: dict[str, BodySettings] | None = Field(
        default=None, description="by the name of a body of the part: its own material, and which counts in overlaps"
    )
    displacement: Displacement | None = Field(default=None, description="relief of the part's surface")
    output: Output = Field(default=Output(), description="how the stack is written")

    @field_validator("materials", mode="before")
    @classmethod
    def _bare_names(cls, value: Any) -> Any:
        if not isinstance(value, list | tuple):
            return value
        named = [{"name": m} if isinstance(m, str) else m for m in value]
        return [
            {"color": DEFAULT_COLORS[i % len(DEFAULT_COLORS)], **m} if isinstance(m, dict) else m
            for i, m in enumerate(named)
        ]

    @field_validator("materials")
    @classmethod
    def _distinct(cls, materials: tuple[Material, ...]) -> tuple[Material, ...]:
        names = [m.name.lower() for m in materials]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"the name '{name}' is used {names.count(name)} times; each needs its own folder")
        return materials


def key_paths() -> dict[str, str]:
    """Every key's name, and where it belongs ("ratio": "fields.ratio"), for did-you-mean messages."""
    from amslicer.fields import SOURCES
    from amslicer.fields.blur import Blur
    from amslicer.fields.combination import Clip, Mix, Remap, Where
    from amslicer.fields.gradient import LinearGradient, RadialGradient

    found: dict[str, str] = {}
    sections: tuple[tuple[str, type[BaseModel]], ...] = (
        ("", JobFile), ("printer.", Printer), ("part.", PartSettings), ("materials.", Material),
        ("skin.", SkinSettings), ("bodies.", BodySettings), ("displacement.", Displacement),
        ("pattern.", Pattern), ("pattern.lobes.", Lobe), ("fields.", Fields), ("fields.orientation.", AzimuthElevation),
        ("fields.orientation.", VectorComponents),
        ("output.", Output), ("gradient.", LinearGradient), ("gradient.", RadialGradient),
        ("mix.", Mix), ("clip.", Clip), ("remap.", Remap), ("where.", Where), ("blur.", Blur),
        *(("", source) for source in SOURCES.values()), ("fields.ratio.", MaterialMap),
        *(("pattern.profile.", shape) for shape in SHAPES.values()),
        *(("pattern.spectrum.", shape) for shape in SPECTRUM_SHAPES.values()),
        ("pattern.profile.blend.", Blend), ("pattern.profile.harmonics.", Harmonic),
    )  # fmt: skip
    for prefix, model in sections:
        for key, info in model.model_fields.items():
            found.setdefault(info.alias or key, f"{prefix}{info.alias or key}")
    return found
