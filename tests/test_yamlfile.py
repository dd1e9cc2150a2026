"""YAML as people write it: 1.2 rules, plain data only, and a place for everything that is refused."""

from __future__ import annotations

import math
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from amslicer.errors import JobError
from amslicer.yamlfile import MAX_BYTES, MAX_DEPTH, parse_value, parse_yaml, read_yaml

BOM = "\N{ZERO WIDTH NO-BREAK SPACE}"


def value_of(text: str) -> Any:
    return parse_yaml(f"v: {text}\n", "test")[0]["v"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3", 3),
        ("+3", 3),
        ("-3", -3),
        ("0.5", 0.5),
        (".5", 0.5),
        ("5.", 5.0),
        ("1e3", 1000.0),
        ("1E3", 1000.0),
        ("1e-3", 0.001),
        ("1.5e+2", 150.0),
        ("12e03", 12000.0),
        ("017", 17),  # 15 in YAML 1.1
        ("08", 8),
        ("0o17", 15),
        ("0x1F", 31),
        ("true", True),
        ("True", True),
        ("FALSE", False),
        ("~", None),
        ("null", None),
        ("", None),
        ("no", "no"),
        ("No", "No"),
        ("yes", "yes"),
        ("on", "on"),
        ("off", "off"),
        ("y", "y"),
        ("n", "n"),
        ("12:30", "12:30"),  # 750 in YAML 1.1
        ("1:30:00", "1:30:00"),
        ("1,5", "1,5"),
        ("1.5.2", "1.5.2"),
        ("'1e3'", "1e3"),
        ('"017"', "017"),
        ("[1, 2.5, a]", [1, 2.5, "a"]),
        ("{a: 1, b: [c]}", {"a": 1, "b": ["c"]}),
        ("µm", "µm"),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, expected: Any) -> None:
    found = value_of(text)
    assert found == expected
    assert type(found) is type(expected)


# The core schema of YAML 1.2 (§10.3.2) has no binary numbers, no underscores in numbers and no dates.
@pytest.mark.parametrize("text", ["0b11", "1_000", "0_1.5", "2020-01-01", "2001-12-14t21:59:43.10-05:00"])
def test_what_only_yaml_1_1_resolves_is_a_string(text: str) -> None:
    assert value_of(text) == text


@pytest.mark.parametrize(("text", "sign"), [(".inf", 1), ("+.inf", 1), ("-.inf", -1), ("1e400", 1)])
def test_infinities_are_numbers_for_the_job_to_refuse(text: str, sign: int) -> None:
    assert value_of(text) == sign * math.inf


def test_nan_is_a_number_for_the_job_to_refuse() -> None:
    assert math.isnan(value_of(".nan"))


def test_values_are_plain_python() -> None:
    tree, _ = parse_yaml("a: {b: [1, 2.0, x, true, null]}\n", "test")
    assert type(tree) is dict
    assert type(tree["a"]) is dict
    assert [type(v) for v in tree["a"]["b"]] == [int, float, str, bool, type(None)]


def test_every_key_and_item_has_its_place() -> None:
    text = "a: 1\nb:\n  c: 2\n  d: {e: 3, f: 4}\ng:\n  - 5\n  - {h: 6}\n"
    assert parse_yaml(text, "test")[1] == {
        ("a",): (1, 1),
        ("b",): (2, 1),
        ("b", "c"): (3, 3),
        ("b", "d"): (4, 3),
        ("b", "d", "e"): (4, 7),
        ("b", "d", "f"): (4, 13),
        ("g",): (5, 1),
        ("g", 0): (6, 5),
        ("g", 1): (7, 5),
        ("g", 1, "h"): (7, 6),
    }


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("a: 1\na: 2\n", "line 2, column 1", "duplicate"),
        ("a:\n  b: 1\n  c: 3\n  b: 2\n", "line 4, column 3", "duplicate"),
        ("a: {b: 1, b: 2}\n", "line 1, column 11", "duplicate"),
        ("a: &name 1\n", "line 1, column 4", "anchors"),
        ("a: 1\nb: *name\n", "line 2, column 4", "aliases"),
        ("a: !!str 1\n", "line 1, column 4", "tags"),
        ("a: !thing {b: 1}\n", "line 1, column 4", "tags"),
        ("a: !!python/object/apply:os.system [true]\n", "line 1, column 4", "tags"),
        ("a: !!binary aGk=\n", "line 1, column 4", "tags"),
        ("%YAML 1.1\n---\na: 017\n", "line 1, column 1", "directives"),
        ("%TAG ! tag:x,2000:\n---\na: 1\n", "line 1, column 1", "directives"),
        ("a: 1\n---\nb: 2\n", "line 2, column 1", "document"),
        ("---\na: 1\n---\nb: 2\n", "line 3, column 1", "document"),
        ("\ta: 1\n", "line 1, column 1", "'\\t'"),
        ("a:\n\tb: 1\n", "line 2, column 1", "'\\t'"),
        ("a: b: c\n", "line 1, column 5", "mapping values"),
        ("a: [1, 2\n", "line 2, column 1", "]"),
        ("a: @x\n", "line 1, column 4", "'@'"),
    ],
)
def test_refused_with_line_and_column(text: str, place: str, said: str) -> None:
    with pytest.raises(JobError) as caught:
        parse_yaml(text, "job file 'x.yaml'")
    assert f"job file 'x.yaml', {place}: " in caught.value.message
    assert said in caught.value.message


@pytest.mark.parametrize(
    "text",
    [
        "<<: {a: 1}\n",
        "a:\n  <<: {b: 1}\n  c: 2\n",
        "a:\n  <<: [{b: 1}, {c: 2}]\n",
        "<<: 3\n",
    ],
)
def test_merge_keys_are_refused(text: str) -> None:
    with pytest.raises(JobError, match=r"test"):
        parse_yaml(text, "test")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- 1\n- 2\n", "must be a mapping"),
        ("word\n", "must be a mapping"),
        ("3\n", "must be a mapping"),
        ("1: a\n", "not a word"),
        ("true: a\n", "not a word"),
        ("~: a\n", "not a word"),
        ("? [a, b]\n: 1\n", "not a word"),
        ("? {a: 1}\n: 2\n", "not a word"),
        ("a: \x00\n", "not YAML"),
        ("a: \x07\n", "not YAML"),
        (f"a: {'9' * 5000}\n", "not YAML"),
    ],
)
def test_refused_by_name(text: str, said: str) -> None:
    with pytest.raises(JobError, match=r"^test") as caught:
        parse_yaml(text, "test")
    assert said in caught.value.message


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n", "---\n", "~\n"])
def test_an_empty_file_has_no_keys(text: str) -> None:
    assert parse_yaml(text, "test") == ({}, {})


def test_one_document_may_be_marked() -> None:
    assert parse_yaml("---\na: 1\n...\n", "test")[0] == {"a": 1}


def test_line_ends_of_every_system() -> None:
    assert parse_yaml("a: 1\r\nb: 2\r\n", "test")[0] == {"a": 1, "b": 2}


def nested_lists(levels: int) -> str:
    return "a: " + "[" * levels + "]" * levels + "\n"


def nested_maps(levels: int) -> str:
    return "\n".join(" " * level + "a:" for level in range(levels)) + "\n"


@pytest.mark.parametrize("text", [nested_lists(MAX_DEPTH), nested_maps(MAX_DEPTH)], ids=["lists", "maps"])
def test_nesting_is_accepted_to_its_limit(text: str) -> None:
    assert parse_yaml(text, "test")[0]["a"]


@pytest.mark.parametrize(
    "text",
    [
        nested_lists(MAX_DEPTH + 1),
        nested_maps(MAX_DEPTH + 1),
        nested_lists(400),
        nested_maps(400),
        "{a: " * 400 + "1" + "}" * 400 + "\n",
        "a:\n" + "- " * 400 + "1\n",
        "a: " + "[" * 400,
    ],
    ids=["lists", "maps", "400 lists", "400 maps", "400 flow maps", "400 dashes", "400 unclosed"],
)
def test_deeper_nesting_is_refused(text: str) -> None:
    with pytest.raises(JobError, match=r"nested deeper than 32 levels"):
        parse_yaml(text, "test")


def test_deep_nesting_is_refused_before_it_is_scanned() -> None:
    """Scanning these brackets to their end would take hours: the depth is counted on the way."""
    with pytest.raises(JobError, match="nested deeper"):
        parse_yaml("a: " + "[" * 300_000, "test")


def test_reads_a_file(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_bytes("a: µ\n".encode())
    assert read_yaml(file, "job file") == ({"a": "µ"}, {("a",): (1, 1)})


def test_a_byte_order_mark_is_no_part_of_the_first_key(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_bytes((BOM + "a: 1\n").encode())
    assert read_yaml(file, "job file")[0] == {"a": 1}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a: ä\n".encode("latin-1"), "is not UTF-8 (byte 3)"),
        ("a: 1\n".encode("utf-16"), "is not UTF-8 (byte 0)"),
        (b"a: \xed\xa0\x80\n", "is not UTF-8 (byte 3)"),  # a surrogate
        (b"# " + b"x" * MAX_BYTES + b"\na: 1\n", "at most 1048576 bytes are read"),
        (b"\x89PNG\r\n\x1a\n", "is not UTF-8 (byte 0)"),
    ],
    ids=["latin-1", "utf-16", "surrogate", "over 1 MiB", "a picture"],
)
def test_bytes_that_are_refused(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "job.yaml"
    file.write_bytes(content)
    with pytest.raises(JobError, match=r"^the job file '.*job\.yaml' ") as caught:
        read_yaml(file, "job file")
    assert said in caught.value.message


def test_one_mebibyte_is_read(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_bytes(b"a: 1\n#".ljust(MAX_BYTES, b"x"))
    assert file.stat().st_size == 1024 * 1024
    assert read_yaml(file, "job file")[0] == {"a": 1}


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="No such file"):
        read_yaml(tmp_path / "none.yaml", "job file")
    with pytest.raises(JobError, match=r"directory|regular"):
        read_yaml(tmp_path, "job file")


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "job.yaml"
    os.mkfifo(pipe)
    caught: list[BaseException] = []

    def read() -> None:
        try:
            read_yaml(pipe, "job file")
        except BaseException as error:
            caught.append(error)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(5)
    waited = reader.is_alive()
    if waited:  # let the thread go
        os.close(os.open(pipe, os.O_WRONLY))
        reader.join(5)
    assert not waited, "it waits for someone to write into the pipe"
    assert isinstance(caught[0], JobError)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.8", 0.8),
        ("1e3", 1000.0),
        ("no", "no"),
        ("[600, 300]", [600, 300]),
        ("", None),
        ("{image: a.png}", {"image": "a.png"}),
    ],
)
def test_a_single_value_follows_the_same_rules(text: str, expected: Any) -> None:
    found = parse_value(text, "--set x")
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize("text", ["&a 1", "*a", "!!str 1", "[1", "a: b", "1\nother: 2"])
def test_a_single_value_is_one_plain_value(text: str) -> None:
    with pytest.raises(JobError, match=r"^--set x"):
        parse_value(text, "--set x")
