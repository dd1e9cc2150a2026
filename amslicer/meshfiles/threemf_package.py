"""A 3MF package as a ZIP file: sizes, names and checksums are checked, and its XML is looked through."""

from __future__ import annotations

import io
import zipfile
import zlib
from xml.parsers import expat

from amslicer.errors import PartError
from amslicer.meshfiles.threemf_scan import Scan, note_models, note_relations

MAX_PACKAGE_BYTES = 4 << 30
"""Unpacked size of all members: the largest model that is read takes between 1 and 3 GB of XML."""
FREE_BYTES, MAX_RATIO = 256 << 20, 200
"""Beyond the first, a package that unpacks to more than the second times itself is a bomb: meshes in XML reach 20."""
MAX_MEMBERS = 10_000
"""Members of the package: one model part per object is the most that exporters write."""
CHUNK_BYTES = 1 << 20
"""Unpacked and dropped at a time, so that memory does not grow with the package."""

_ENCRYPTED_FLAG = 0x1  # bit 0 of a ZIP member's general purpose flags
_RELATIONS = ".rels"  # end of the names of the members that say what the others are


def scan_package(data: bytes) -> Scan:
    """What the XML of a 3MF package holds.

    Raises:
        PartError: the package is not a ZIP file, damaged, too large, encrypted, or names what is outside of it.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _check_members(archive.infolist(), len(data))
            return _scan_members(archive)
    except (
        zipfile.BadZipFile,
        zipfile.LargeZipFile,
        NotImplementedError,
        EOFError,
        OSError,
        ValueError,
        RuntimeError,
        zlib.error,
    ) as error:
        raise PartError(
            f"not a readable 3MF (ZIP) package ({error})",
            hint="the file is damaged or cut short: copy or export it again",
        ) from error


def _check_members(members: list[zipfile.ZipInfo], packed: int) -> None:
    hint = "export the part again from the program that made it"
    if len(members) > MAX_MEMBERS:
        raise PartError(f"{len(members)} members in the package, more than {MAX_MEMBERS}", hint=hint)
    total = sum(member.file_size for member in members)
    if total > min(MAX_PACKAGE_BYTES, max(FREE_BYTES, MAX_RATIO * packed)):
        raise PartError(f"{packed} bytes that unpack to {total}, more than is read", hint=hint)
    seen: set[str] = set()
    for member in members:
        part = _part(member)
        if ".." in part.split("/"):
            raise PartError(f"member {member.filename!r} points outside the package", hint=hint)
        if part.lower() in seen:
            raise PartError(f"member {member.filename!r} is there twice", hint=hint)
        if member.flag_bits & _ENCRYPTED_FLAG:
            raise PartError(f"member {member.filename!r} is encrypted", hint="export the part without a password")
        seen.add(part.lower())


def _part(member: zipfile.ZipInfo) -> str:
    """The name of a member as relationships give it: /3D/3dmodel.model."""
    return "/" + member.filename.replace("\\", "/").lstrip("/")


def _scan_members(archive: zipfile.ZipFile) -> Scan:
    """Every member is unpacked once (checking its size and CRC); the XML ones are parsed."""
    scan = Scan()
    members = [member for member in archive.infolist() if not member.is_dir()]
    for member in sorted(members, key=lambda member: not _part(member).lower().endswith(_RELATIONS)):
        part = _part(member)
        parser = _xml_parser(scan, part)
        with archive.open(member) as stream:
            try:
                while chunk := stream.read(CHUNK_BYTES):
                    if parser is not None:
                        parser.Parse(chunk, False)
                if parser is not None:
                    parser.Parse(b"", True)
            except expat.ExpatError as error:
                raise PartError(
                    f"{part} is not valid XML ({error})", hint="the file is damaged: export it again"
                ) from error
    return scan


def _xml_parser(scan: Scan, part: str) -> expat.XMLParserType | None:
    """A parser that notes in the scan what an XML part holds; None for what is not XML, such as pictures."""
    lower = part.lower()
    is_model = lower.endswith(".model") or lower in scan.model_parts
    is_relations = lower.endswith(_RELATIONS)
    if not (is_model or is_relations or lower == "/[content_types].xml"):
        return None
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.ordered_attributes = True

    def refuse_doctype(*_: object) -> None:
        raise PartError(f"{part} has a DOCTYPE, which 3MF forbids", hint="export the part again")

    parser.StartDoctypeDeclHandler = refuse_doctype
    if is_model:
        note_models(parser, scan, part)
    elif is_relations:
        note_relations(parser, scan, part)
    return parser
