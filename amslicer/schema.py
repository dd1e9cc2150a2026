"""JSON Schema of the job file, for editors: what they complete and underline while a job file is typed.

pydantic makes it from the models in `specification`; what `jobfile` accepts beyond them – names in place of a printer
or a material, defaults that depend on the place – is added here.
"""

from __future__ import annotations

from typing import Any

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCHEMA_FILE = "fields.schema.json"  # where the starter file looks for it


def job_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) of a job file as it is written."""
    from amslicer.specification import JobFile

    schema: dict[str, Any] = JobFile.model_json_schema()
    sections = schema["$defs"]
    _accept_printer_names(schema, sections["Printer"])
    _accept_material_names(schema, sections["Material"])
    _accept_bare_amplitudes(sections["HarmonicsShape"])
    _without_titles(schema)
    return {
        "$schema": DIALECT,
        **schema,
        "title": "amslicer job file",
        "description": "What amslicer prints: `amslicer PART --fields` and this file. Lengths are mm, angles degrees.",
    }


def _accept_printer_names(schema: dict[str, Any], printer: dict[str, Any]) -> None:
    from amslicer.jobfile import DEFAULT_PRINTER
    from amslicer.printers import printer_names
    from amslicer.specification import ALTERNATIVES

    printer["allOf"] = [{"oneOf": [_given(key) for key in pair]} for pair in ALTERNATIVES]
    names = {"enum": printer_names(), "description": "a profile (`amslicer printers`)"}
    files = {"type": "string", "pattern": r"\.ya?ml$", "description": "a profile of your own, beside this file"}
    entry = schema["properties"]["printer"]
    described = entry["description"]
    schema["properties"]["printer"] = {
        "anyOf": [names, files, {"$ref": entry["$ref"]}], "default": DEFAULT_PRINTER, "description": described,
    }  # fmt: skip
    schema["required"].remove("printer")


def _given(key: str) -> dict[str, Any]:
    """A key that is there and not null."""
    return {"required": [key], "properties": {key: {"not": {"type": "null"}}}}


def _accept_material_names(schema: dict[str, Any], material: dict[str, Any]) -> None:
    name = {key: material["properties"]["name"][key] for key in ("type", "pattern")}
    materials = schema["properties"]["materials"]
    materials["items"] = {"anyOf": [{**name, "description": "a material's name is enough"}, materials["items"]]}
    material["required"].remove("color")


def _accept_bare_amplitudes(shape: dict[str, Any]) -> None:
    harmonics = shape["properties"]["harmonics"]
    harmonics["items"] = {"anyOf": [{"type": "number"}, harmonics["items"]]}


def _without_titles(node: Any, *, names: bool = False) -> None:
    """Takes away the titles that pydantic makes of keys: editors would show them above the descriptions.

    Args:
        names: the keys of this mapping are keys of the job file, not of the schema.
    """
    if isinstance(node, list):
        for item in node:
            _without_titles(item)
    elif isinstance(node, dict):
        if not names:
            node.pop("title", None)
        for key, value in node.items():
            _without_titles(value, names=not names and key in ("properties", "$defs"))
