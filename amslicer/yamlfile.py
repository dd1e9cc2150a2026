"""Reads YAML 1.2 job files strictly: plain data only, and the line and column of every key for messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from amslicer.errors import JobError

MAX_BYTES = 1 << 20  # a job file is written by people
MAX_DEPTH = 32

KeyPath = tuple[str | int, ...]
Places = dict[KeyPath, tuple[int, int]]


def read_yaml(file: Path, what: str) -> tuple[dict[str, Any], Places]:
    """A mapping of plain Python values, and where each key stands (line, column; both from 1).

    Args:
        file: a regular file.
        what: what the file is, for messages ("job file").

    Raises:
        JobError: unreadable, not UTF-8, not YAML 1.2, or uses anchors, aliases, tags or several documents.
    """
    try:
        content = file.read_bytes()
    except OSError as error:
        raise JobError(f"the {what} '{file}' cannot be read: {error.strerror or error}") from error
    if len(content) > MAX_BYTES:
        raise JobError(f"the {what} '{file}' has {len(content)} bytes; at most {MAX_BYTES} are read")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JobError(f"the {what} '{file}' is not UTF-8 (byte {error.start})") from error
    return parse_yaml(text, f"{what} '{file}'")


def parse_yaml(text: str, where: str) -> tuple[dict[str, Any], Places]:
    """As read_yaml, of a text; `where` names it in messages."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        _refuse_indirection(text, where)
        tree = YAML(typ="rt", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = (error.problem or error.context or "not YAML").splitlines()[0]
        raise JobError(f"{where}{at}: {problem}", hint="`amslicer init` writes an example") from error
    except (YAMLError, ValueError) as error:
        raise JobError(f"{where}: not YAML: {str(error).splitlines()[0]}") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise JobError(f"{where}: must be a mapping of keys, but is a {type(tree).__name__}")
    places: Places = {}
    plain = _plain(tree, (), places, where)
    return plain, places


def parse_value(text: str, where: str) -> Any:
    """One YAML value, as after `--set KEY=`."""
    return parse_yaml(f"value: {text}\n", where)[0]["value"]


def _refuse_indirection(text: str, where: str) -> None:
    from ruamel.yaml import YAML
    from ruamel.yaml import tokens as t

    refused = {
        t.AnchorToken: "anchors (&name)",
        t.AliasToken: "aliases (*name)",
        t.TagToken: "tags (!name)",
        t.DirectiveToken: "directives (%NAME)",
    }
    documents = 0
    for token in YAML(typ="rt", pure=True).scan(text):
        documents += isinstance(token, t.DocumentStartToken)
        name = refused.get(type(token)) or ("several documents" if documents > 1 else None)
        if name:
            mark = token.start_mark
            raise JobError(f"{where}, line {mark.line + 1}, column {mark.column + 1}: {name} are not accepted")


def _plain(node: Any, path: KeyPath, places: Places, where: str) -> Any:
    if len(path) > MAX_DEPTH:
        raise JobError(f"{where}: nested deeper than {MAX_DEPTH} levels")
    if isinstance(node, dict):
        for key in node:
            if not isinstance(key, str):
                raise JobError(f"{where}: the key {key!r} is not a word", hint=f'quote it: "{key}"')
            line, column = node.lc.key(key) if hasattr(node, "lc") else (0, 0)
            places[(*path, key)] = (line + 1, column + 1)
        return {str(key): _plain(value, (*path, str(key)), places, where) for key, value in node.items()}
    if isinstance(node, list):
        for index in range(len(node)):
            line, column = node.lc.item(index) if hasattr(node, "lc") else (0, 0)
            places[(*path, index)] = (line + 1, column + 1)
        return [_plain(value, (*path, index), places, where) for index, value in enumerate(node)]
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    if node is None:
        return None
    raise JobError(f"{where}: the value {node!r} of '{'.'.join(map(str, path))}' is not a number, word or list")
