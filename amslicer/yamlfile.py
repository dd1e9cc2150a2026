"""Reads YAML 1.2 job files strictly: plain data only, and the line and column of every key for messages."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import Any

from amslicer.errors import JobError

MAX_BYTES = 1 << 20  # a job file is written by people
MAX_DEPTH = 32
MAX_TOKENS = 100_000  # 50 000 numbers in a list: five seconds; a mebibyte of them takes a minute
EXAMPLE = "`amslicer init` writes an example"
NUMBERED = (("stack",), ("bodies",), ("per_body",))  # keys whose own keys may be numbers: heights, bodies without names
PLAIN_HINT = "write each value where it is used; a word that starts with such a sign needs quotes"

KeyPath = tuple[str | int, ...]
Places = dict[KeyPath, tuple[int, int]]

# The core schema of YAML 1.2 (§10.3.2): what a plain scalar means. Everything else is a word; ruamel.yaml's own
# resolver also takes dates, binary numbers and underscores.
INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
SPECIAL: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


def read_yaml(file: Path, what: str) -> tuple[dict[str, Any], Places]:
    """A mapping of plain Python values, and where each key stands (line, column; both from 1).

    Args:
        file: a regular file.
        what: what the file is, for messages ("job file").

    Raises:
        JobError: unreadable, not UTF-8, not YAML 1.2, or uses anchors, aliases, tags or several documents.
    """
    try:
        if not stat.S_ISREG(file.stat().st_mode):
            raise JobError(f"the {what} '{file}' is not a regular file", hint="name a YAML file")
        with file.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        hint = "check its path; `amslicer init` writes a job file to start from"
        raise JobError(f"the {what} '{file}' cannot be read: {reason}", hint=hint) from error
    if len(content) > MAX_BYTES:
        raise JobError(
            f"the {what} '{file}' is too long: at most {MAX_BYTES} bytes are read (1 MiB)",
            hint="paint what has this much detail as a picture",
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JobError(f"the {what} '{file}' is not UTF-8 (byte {error.start})", hint="save it as UTF-8") from error
    return parse_yaml(text, f"{what} '{file}'")


def parse_yaml(text: str, where: str) -> tuple[dict[str, Any], Places]:
    """As read_yaml, of a text; `where` names it in messages."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    places: Places = {}
    try:
        _refuse_indirection(text, where)
        root = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = (error.problem or error.context or "not YAML").splitlines()[0]
        raise JobError(f"{where}{at}: {problem}", hint=EXAMPLE) from error
    except (YAMLError, ValueError) as error:
        raise JobError(f"{where}: not YAML: {str(error).splitlines()[0]}", hint=EXAMPLE) from error
    tree = None if root is None else _plain(root, (), places, where)
    tree = {} if tree is None else tree
    if not isinstance(tree, dict):
        raise JobError(f"{where}: must be a mapping of keys, but is a {type(tree).__name__}", hint=EXAMPLE)
    return tree, places


def parse_value(text: str, where: str) -> Any:
    """One YAML value, as after `--set KEY=`."""
    tree = parse_yaml(f"value: {text}\n", where)[0]
    if set(tree) != {"value"}:
        raise JobError(f"{where}: must be one value, but is {text!r}")
    return tree["value"]


def _refuse_indirection(text: str, where: str) -> None:
    """Looks at the tokens only, and stops at the first that is not accepted."""
    from ruamel.yaml import YAML
    from ruamel.yaml import tokens as t

    refused = {
        t.AnchorToken: "anchors (&name) are",
        t.AliasToken: "aliases (*name) are",
        t.TagToken: "tags (!name) are",
        t.DirectiveToken: "directives (%NAME) are",
    }
    opening = (t.BlockMappingStartToken, t.BlockSequenceStartToken, t.FlowMappingStartToken, t.FlowSequenceStartToken)
    closing = (t.BlockEndToken, t.FlowMappingEndToken, t.FlowSequenceEndToken)
    outside = (t.StreamStartToken, t.StreamEndToken, t.DirectiveToken, t.DocumentStartToken, t.DocumentEndToken)
    documents = depth = 0
    for count, token in enumerate(YAML(typ="safe", pure=True).scan(text)):
        documents += isinstance(token, t.DocumentStartToken)
        if not documents and not isinstance(token, outside):
            documents = 1  # the first needs no ---
        depth += isinstance(token, opening) - isinstance(token, closing)
        if depth > MAX_DEPTH + 1:
            raise _too_deep(where)
        if count > MAX_TOKENS:
            raise JobError(
                f"{where}, line {token.start_mark.line + 1}: more than {MAX_TOKENS} words and signs up to here",
                hint="paint what has this much detail as a picture",
            )
        name = refused.get(type(token)) or ("several documents are" if documents > 1 else None)
        if name:
            mark = token.start_mark
            raise JobError(
                f"{where}, line {mark.line + 1}, column {mark.column + 1}: {name} not accepted", hint=PLAIN_HINT
            )


def _plain(node: Any, path: KeyPath, places: Places, where: str) -> Any:
    from ruamel.yaml.nodes import MappingNode, SequenceNode

    if len(path) > MAX_DEPTH:
        raise _too_deep(where)
    if isinstance(node, MappingNode):
        tree: dict[str, Any] = {}
        for key_node, value in node.value:
            line, column = key_node.start_mark.line + 1, key_node.start_mark.column + 1
            at = f"{where}, line {line}, column {column}"
            key = _plain(key_node, (), {}, where)
            if type(key) in (int, float) and path[-1:] in NUMBERED:
                key = str(key_node.value)
            if not isinstance(key, str):
                raise JobError(f"{at}: the key {key!r} is not a word", hint=f'quote it: "{key}"')
            if key == "<<":
                raise JobError(f"{at}: merge keys (<<) are not accepted", hint=PLAIN_HINT)
            if key in tree:
                first = places[(*path, key)]
                raise JobError(
                    f"{at}: duplicate key '{key}' (first in line {first[0]}, column {first[1]})",
                    hint="keep one of the two",
                )
            places[(*path, key)] = (line, column)
            tree[key] = _plain(value, (*path, key), places, where)
        return tree
    if isinstance(node, SequenceNode):
        for index, value in enumerate(node.value):
            places[(*path, index)] = (value.start_mark.line + 1, value.start_mark.column + 1)
        return [_plain(value, (*path, index), places, where) for index, value in enumerate(node.value)]
    try:
        return _scalar(node)
    except ValueError as error:  # a number of thousands of digits
        raise JobError(f"{where}: not YAML: {error}", hint=EXAMPLE) from None


def _scalar(node: Any) -> Any:
    text = str(node.value)
    if node.style:  # quoted, or a block of text
        return text
    if text in SPECIAL:
        return SPECIAL[text]
    if INTEGER.fullmatch(text):
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    return float(text) if FLOAT.fullmatch(text) else text


def _too_deep(where: str) -> JobError:
    return JobError(f"{where}: nested deeper than {MAX_DEPTH} levels", hint=EXAMPLE)
