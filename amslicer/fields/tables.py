"""Reads tables of numbers from CSV files, strictly: what is not plainly a number is refused with its line.

    # comments, and empty lines, are skipped
    x,y,z,value
    0,0,0,0.25

UTF-8; the cells are separated by commas, semicolons or tabs, whichever the first line has; numbers have a decimal
point. The first line names the columns, in any order.
"""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_ROWS = 200_000  # a second of reading; more samples than that make a picture or a volume
MOST_MM = 1e6  # a kilometre: coordinates beyond are in another unit, and their squares lose a micrometre
LARGEST = 1e9  # of other numbers: far from where single precision, which fields are kept in, ends

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+", re.ASCII)
NO_NUMBERS = ("nan", "inf", "infinity", "na", "n/a", "null", "none")
COORDINATES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a file.

    Attributes:
        name: the file, for messages.
        columns: (N,) numbers by column name, in the order of the file.
        lines: (N,) line of each row, from 1 on.
    """

    name: str
    columns: dict[str, Floats]
    lines: NDArray[np.int64]

    def matrix(self, names: Sequence[str]) -> Floats:
        """(N, len(names)) some of the columns."""
        return np.column_stack([self.columns[name] for name in names])


def read_table(content: bytes, name: str, known: Sequence[str]) -> Table:
    """The numbers of a CSV file.

    Args:
        name: the file, for messages.
        known: the columns that it may have.

    Raises:
        JobError: anything else than a header of known columns and rows of finite numbers, at most MOST_ROWS.
    """
    rows = _rows(_decode(content, name), name)
    try:
        line, header = next(rows)
    except StopIteration:
        raise JobError(
            f"the table '{name}' is empty", hint=f"name the columns in its first line: {_list(known)}"
        ) from None
    columns = _columns(header, name, line, known)
    numbers: list[list[float]] = []
    lines: list[int] = []
    for line, cells in rows:
        if len(numbers) == MOST_ROWS:
            raise JobError(
                f"the table '{name}' has more than {MOST_ROWS} rows (line {line})",
                hint="leave some out: fields are interpolated between samples; or paint a picture or a volume",
            )
        if len(cells) != len(columns):
            raise JobError(
                f"the table '{name}' has {len(cells)} cells in line {line}, and {len(columns)} columns",
                hint="numbers have a decimal point, not a comma"
                if len(cells) > len(columns)
                else "each row gives a number for each column",
            )
        numbers.append([_number(cell, name, line, column) for cell, column in zip(cells, columns, strict=True)])
        lines.append(line)
    if not numbers:
        raise JobError(f"the table '{name}' has no rows below its first line", hint="give at least one point")
    values = np.array(numbers)
    return Table(name, {column: values[:, i] for i, column in enumerate(columns)}, np.array(lines))


def number_fault(column: str, value: float) -> str | None:
    """What is wrong with a finite number of a column, also where it is given inline; None where nothing is."""
    most, unit = (MOST_MM, " mm") if column in COORDINATES else (LARGEST, "")
    return None if abs(value) <= most else f"{column} is {value:g}{unit}; at most ±{most:g}{unit} is taken"


def _decode(content: bytes, name: str) -> list[str]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JobError(
            f"the table '{name}' is not UTF-8 text (byte {error.start} is 0x{content[error.start]:02x})",
            hint="save it as CSV in UTF-8: spreadsheets' own files are not read",
        ) from None
    if "\0" in text:
        raise JobError(f"the table '{name}' has a zero byte", hint="save it as CSV in UTF-8")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _rows(lines: list[str], name: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each line that is no comment and not empty."""
    separator: str | None = None
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if separator is None:
            found = [mark for mark in SEPARATORS if mark in line]
            if len(found) != 1:
                has = " and ".join(SEPARATORS[mark] for mark in found) or "neither commas, semicolons nor tabs"
                raise JobError(
                    f"the table '{name}' has {has} in line {number}, which names the columns",
                    hint="separate the columns by one of them, for example x,y,z,value",
                )
            separator = found[0]
        try:  # one line at a time: a quote that is not closed cannot swallow the lines below
            (cells,) = csv.reader([line], delimiter=separator, strict=True)
        except csv.Error as error:
            raise JobError(
                f"the table '{name}' cannot be read in line {number}: {error}",
                hint="leave out quotes: cells are names and numbers",
            ) from None
        yield number, [cell.strip() for cell in cells]


def _columns(header: list[str], name: str, line: int, known: Sequence[str]) -> list[str]:
    columns = [cell.lower() for cell in header]
    if all(NUMBER.fullmatch(cell) for cell in columns):
        raise JobError(
            f"the table '{name}' has numbers in its first line (line {line}) instead of the columns' names",
            hint=f"name them: {_list(known)}",
        )
    for place, column in enumerate(columns):
        if column not in known:
            near = difflib.get_close_matches(column, known, n=1)
            raise JobError(
                f"the table '{name}' has the unknown column '{header[place]}' (line {line}, column {place + 1})"
                if column
                else f"the table '{name}' has a column without a name (line {line}, column {place + 1})",
                hint=f"did you mean {near[0]}?" if near else f"the columns are {_list(known)}",
            )
        if column in columns[:place]:
            raise JobError(
                f"the table '{name}' has the column '{column}' twice (line {line}, columns "
                f"{columns.index(column) + 1} and {place + 1})",
                hint="leave one out",
            )
    return columns


def _number(cell: str, name: str, line: int, column: str) -> float:
    if NUMBER.fullmatch(cell):
        value = float(cell)
        fault = number_fault(column, value)
        if fault is None:
            return value
        raise JobError(f"the table '{name}', line {line}: {fault}", hint="coordinates are mm of the part's file")
    where = f"in line {line}, column '{column}'"
    if not cell:
        raise JobError(f"the table '{name}' has an empty cell {where}", hint="give a number, or leave the row out")
    if DECIMAL_COMMA.fullmatch(cell):
        raise JobError(
            f"the table '{name}' has the decimal comma '{cell}' {where}",
            hint="write numbers with a decimal point",
        )
    what = "not a finite number" if cell.lower().lstrip("+-") in NO_NUMBERS else "not a number"
    raise JobError(f"the table '{name}' has '{cell[:40]}' {where}, which is {what}", hint="leave the row out")


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)
