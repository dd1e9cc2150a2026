"""What the XML of a 3MF package holds: triangles and instances are counted, extensions noted, nothing is built."""

from __future__ import annotations

import posixpath
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from xml.parsers import expat

from amslicer.errors import PartError
from amslicer.meshfiles.soup import MAX_INSTANCES, MAX_TRIANGLES

MAX_DEPTH = 64
"""Components within components: far above any exporter, far below Python's recursion limit."""

_MODEL_RELATION = "/3dmodel"  # end of the relationship type that names a model part
# Extensions that leave the shape of the triangles alone: where objects are stored, colours, named groups.
_HARMLESS = (
    "/3dmanufacturing/core/",
    "/3dmanufacturing/production/",
    "/3dmanufacturing/material/",
    "/3dmanufacturing/trianglesets/",
)
# Extensions that define or change the shape: met anywhere, the mesh alone is not the part.
_SHAPING = {
    "/3dmanufacturing/slice/": "slice",
    "/3dmanufacturing/beamlattice/": "beam lattice",
    "/3dmanufacturing/volumetric/": "volumetric",
    "/3dmanufacturing/implicit/": "implicit",
    "/3dmanufacturing/displacement/": "displacement",
    "/3dmanufacturing/booleans/": "boolean operations",
    "/3dmanufacturing/securecontent/": "secure content",
}

Key = tuple[str, str]  # (part of the package, object id)


@dataclass
class Scan:
    """What a first pass over the package's XML found."""

    triangles: Counter[Key] = field(default_factory=Counter)
    components: defaultdict[Key, list[Key]] = field(default_factory=lambda: defaultdict(list))
    items: defaultdict[str, list[Key]] = field(default_factory=lambda: defaultdict(list))  # of the build, by part
    unsupported: set[str] = field(default_factory=set)  # extensions that shape the part and are not implemented
    model_parts: set[str] = field(default_factory=set)
    root: str = ""  # the model part whose build is printed

    def count_build(self) -> int:
        """Triangles of the build, each instance counted; nothing is expanded.

        Raises:
            PartError: more than MAX_INSTANCES or MAX_TRIANGLES, or an object contains itself.
        """
        counted: dict[Key, tuple[int, int]] = {}
        totals = [self._count(item, counted, ()) for item in self.items[self.root]]
        instances, triangles = sum(total[0] for total in totals), sum(total[1] for total in totals)
        if instances > MAX_INSTANCES or triangles > MAX_TRIANGLES:
            raise PartError(
                f"{instances} placed objects with {triangles} triangles in all, more than {MAX_INSTANCES} or "
                f"{MAX_TRIANGLES}",
                hint="export fewer copies, or a coarser mesh",
            )
        return triangles

    def _count(self, key: Key, counted: dict[Key, tuple[int, int]], above: tuple[Key, ...]) -> tuple[int, int]:
        """(instances, triangles) of an object with its components, each object looked at once."""
        if key in above or len(above) > MAX_DEPTH:
            raise PartError(
                f"object {key[1]} in {key[0]} contains itself, or components nest deeper than {MAX_DEPTH}",
                hint="export the part again, or as STL",
            )
        if key not in counted:
            parts = [self._count(part, counted, (*above, key)) for part in self.components[key]]
            counted[key] = (
                1 + sum(part[0] for part in parts),
                self.triangles[key] + sum(part[1] for part in parts),
            )
        return counted[key]


def note_relations(parser: expat.XMLParserType, scan: Scan, part: str) -> None:
    """Makes a parser of a .rels part note the model parts that it names."""
    base = posixpath.dirname(posixpath.dirname(part))

    def start(element: str, attributes: list[str]) -> None:
        if element.endswith(" Relationship"):
            named = _pairs(attributes)
            if named.get("Type", "").endswith(_MODEL_RELATION):
                target = posixpath.normpath(posixpath.join(base, named.get("Target", ""))).lower()
                scan.model_parts.add(target)
                if base == "/":
                    scan.root = target

    parser.StartElementHandler = start


def note_models(parser: expat.XMLParserType, scan: Scan, part: str) -> None:
    """Makes a parser of a model part count what it holds and note extensions that shape it."""
    part = part.lower()
    current: Key = (part, "")
    namespaces: dict[str | None, str] = {}  # by prefix
    seen: set[str] = set()  # qualified names

    def declare(prefix: str | None, uri: str | None) -> None:
        namespaces[prefix] = uri or ""

    def refer(named: dict[str, str]) -> Key:
        path = next((value for name, value in named.items() if name.endswith(" path")), part)
        return path.lower(), named.get("objectid", "")

    def start(element: str, attributes: list[str]) -> None:
        nonlocal current
        match element.rpartition(" ")[2]:
            case "triangle":
                scan.triangles[current] += 1
            case "object":
                current = (part, _pairs(attributes).get("id", ""))
            case "component":
                scan.components[current].append(refer(_pairs(attributes)))
            case "item":
                scan.items[part].append(refer(_pairs(attributes)))
            case "model":
                prefixes = _pairs(attributes).get("requiredextensions", "").split()
                scan.unsupported.update(*(_not_implemented(namespaces.get(prefix, prefix)) for prefix in prefixes))
        for name in (element, *attributes[::2]):
            if name not in seen:
                seen.add(name)
                scan.unsupported.update(_shaping(name))

    parser.StartNamespaceDeclHandler = declare
    parser.StartElementHandler = start


def _pairs(attributes: list[str]) -> dict[str, str]:
    return dict(zip(attributes[::2], attributes[1::2], strict=True))


def _not_implemented(uri: str) -> set[str]:
    """The name of a required extension, unless it can be left out."""
    if any(marker in uri for marker in _HARMLESS):
        return set()
    return _shaping(uri) or {uri}


def _shaping(name: str) -> set[str]:
    """The extensions that a qualified name or a URI belongs to and that shape the part."""
    return {title for marker, title in _SHAPING.items() if marker in name}
