"""Small XML documents, without what makes others large: no document type, no entities, bounded depth and count."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from amslicer.volumefiles.volume import refusal

MAX_DEPTH = 32  # elements within elements; a volume's description has 6
MAX_ELEMENTS = 200_000  # an OME description has a few per page
MAX_XML_BYTES = 256 << 20  # of text with samples in it: twice the memory again while it is read


class _Builder(ElementTree.TreeBuilder):
    """Builds a bounded tree."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name, self.depth, self.count = name, 0, 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuses a document type: entities are declared in it."""
        raise refusal(self.name, "has a DOCTYPE, which is never read: it may name other files, or grow without end")

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        """Opens an element."""
        self.depth += 1
        self.count += 1
        if self.depth > MAX_DEPTH or self.count > MAX_ELEMENTS:
            raise refusal(self.name, f"has more than {MAX_DEPTH} levels or {MAX_ELEMENTS} elements of XML")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        """Closes one."""
        self.depth -= 1
        return super().end(tag)


def read_xml(text: bytes, name: str) -> ElementTree.Element:
    """The root of a document.

    Raises:
        JobError: not XML, or more than a volume's description has.
    """
    if len(text) > MAX_XML_BYTES:
        hint = "write the samples as appended raw data"
        raise refusal(name, f"has {len(text)} bytes of XML; at most {MAX_XML_BYTES} are read", hint)
    parser = ElementTree.XMLParser(target=_Builder(name))
    try:
        parser.feed(text)
        root: ElementTree.Element = parser.close()
    except ElementTree.ParseError as error:
        raise refusal(name, f"is damaged XML: {error}") from None
    return root
