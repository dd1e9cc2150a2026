"""Tables of numbers: what is read, and what is refused with its line."""

from __future__ import annotations

import numpy as np
import pytest

from amslicer import JobError
from amslicer.fields import tables
from amslicer.fields.tables import read_table

KNOWN = ("x", "y", "z", "value")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"])
def test_it_reads(mark: str, end: str, start: bytes) -> None:
    lines = ["# a comment; with, both\tmarks", "", 'Z,"x", y ,VALUE', "3,1,2,-4e-1", "  # more", '.5,+1.,"2",0', ""]
    content = end.join([lines[0], *(line.replace(",", mark) for line in lines[1:])]).encode()
    table = read_table(start + content, "a.csv", KNOWN)
    assert list(table.columns) == ["z", "x", "y", "value"]
    np.testing.assert_array_equal(table.matrix(["x", "y", "z", "value"]), [[1, 2, 3, -0.4], [1, 2, 0.5, 0]])
    assert table.lines.tolist() == [4, 6]


@pytest.mark.parametrize(
    ("content", "said", "hint"),
    [
        (b"", "is empty", "x, y, z, value"),
        (b"# nothing\n\n", "is empty", "first line"),
        (b"x,y,value\n", "no rows", "at least one"),
        (b"1,2,3\n4,5,6\n", "numbers in its first line", "name them"),
        (b"x y value\n1 2 3\n", "neither commas, semicolons nor tabs in line 1", "separate"),
        (b"x,y;value\n", "commas and semicolons in line 1", "one of them"),
        (b"x,y,valeu\n1,2,3\n", "unknown column 'valeu' .line 1, column 3", "did you mean value"),
        (b"x,y,\n1,2,3\n", "column without a name .line 1, column 3", "the columns are"),
        (b"x,y,X\n1,2,3\n", "column 'x' twice .line 1, columns 1 and 3", "leave one out"),
        (b"x,y,value\n1,2,3\n1,2\n", "2 cells in line 3, and 3 columns", "each column"),
        (b"x,y,value\n1,2,0,5\n", "4 cells in line 2", "decimal point"),
        (b"x;y;value\n1;2;0,5\n", "decimal comma '0,5' in line 2, column 'value'", "decimal point"),
        (b"x,y,value\n1,,3\n", "empty cell in line 2, column 'y'", "leave the row out"),
        (b"x,y,value\n1,2,NaN\n", "'NaN' in line 2, column 'value', which is not a finite number", "leave"),
        (b"x,y,value\n1,2,-inf\n", "not a finite number", "leave"),
        (b"x,y,value\n1,2,1e999\n", "line 2: value is inf", "mm"),
        (b"x,y,value\n1,2e6,1\n", "line 2: y is 2e.06 mm; at most", "mm"),
        (b"x,y,value\n1,2,1_000\n", "'1_000' in line 2, column 'value', which is not a number", "leave"),
        (b"x,y,value\n1,2,0x10\n", "not a number", "leave"),
        (b"x,y,value\n1,2,\xd9\xa3\n", "not a number", "leave"),
        (b'x,y,value\n1,2,"3\n4,5,6\n', "cannot be read in line 2", None),
        (b"x,y,value\n1,2,\xff\n", "not UTF-8 text .byte 14 is 0xff", "CSV"),
        ("x,y,value\n1,2,3\n".encode("utf-16"), "not UTF-8", "CSV"),
        (b"x,y,value\n1,2,3\0\n", "zero byte", "CSV"),
    ],
)
def test_it_refuses(content: bytes, said: str, hint: str | None) -> None:
    with pytest.raises(JobError, match=said) as caught:
        read_table(content, "a.csv", KNOWN)
    assert "'a.csv'" in caught.value.message
    assert hint is None or hint in str(caught.value.hint)


def test_it_refuses_too_many_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "MOST_ROWS", 3)
    rows = b"x,y,value\n" + b"1,2,3\n" * 3
    assert len(read_table(rows, "a.csv", KNOWN).lines) == 3
    with pytest.raises(JobError, match=r"more than 3 rows .line 5"):
        read_table(rows + b"1,2,3\n", "a.csv", KNOWN)


def test_every_refusal_of_a_quote_has_a_hint() -> None:
    with pytest.raises(JobError, match="cannot be read in line 2") as caught:
        read_table(b'x,y,value\n1,"2,3\n', "t.csv", ("x", "y", "value"))
    assert "quotes" in str(caught.value.hint)
