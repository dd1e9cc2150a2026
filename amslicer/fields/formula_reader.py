"""Reads an expression of a job file into a tree, node by node against a list of what is allowed.

Python's parser only takes the text apart; nothing of it is ever executed.
"""

from __future__ import annotations

import ast
import difflib
import math
import re
import string
import warnings

import numpy as np

from amslicer.fields.formula import Node, Number, Variable, call
from amslicer.fields.operations import (
    COMPARISONS,
    CONSTANTS,
    FUNCTIONS,
    NEGATIVE,
    OPERATORS,
    POWER,
    comparison_chain,
)

MAX_BYTES = 4096
MAX_DEPTH = 64
MAX_NODES = 1000
MAX_EXPONENT = 64  # a constant power beyond it is a mistake: 1 % off in the base is a factor of 2 in the value
MAX_SHOWN = 60  # characters of an expression, or of a piece of it, in a message
VARIABLES = ("x", "y", "z", "u", "v", "w")

LANGUAGE = (
    f"there are numbers, {' '.join((*VARIABLES, *CONSTANTS))}, + - * / ** < <= > >= == !=, "
    f"and the functions {' '.join(FUNCTIONS)}"
)
ALLOWED = frozenset(string.ascii_letters + string.digits + "_.+-*/(),<>=! ")
DECIMAL = re.compile(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
CHARACTER_HINTS = {
    "^": "a power is written a**b", "%": "a remainder is written a - b*floor(a/b)", "π": "write pi",
    "−": "write the minus sign -", "–": "write the minus sign -", "×": "write *", "·": "write *",
    "≤": "write <=", "≥": "write >=", "&": "multiply comparisons to join them",
}  # fmt: skip
# What is valid Python and no expression here.
NODE_HINTS: dict[type[ast.AST], tuple[str, str]] = {
    ast.IfExp: ("'if'", "write where(condition, a, b)"),
    ast.BoolOp: ("'and' or 'or'", "multiply comparisons: (x > 1)*(y < 2)"),
    ast.Not: ("'not'", "write 1 - (…)"),
    ast.FloorDiv: ("'//'", "write floor(a/b)"),
    ast.Attribute: ("a dot after a name", "there are only the functions and variables themselves"),
    ast.Starred: ("a * without a first factor", "a product is written a*b"),
    ast.Tuple: ("a comma outside a function", "a decimal point is written ."),
    ast.keyword: ("an argument with a name", "give arguments by their order"),
    ast.In: ("'in'", "write a < x < b"),
    ast.Is: ("'is'", "write =="),
}


def read_formula(text: str) -> Node:
    """The tree of an expression.

    Raises:
        ValueError: the text is no expression; the sentence says what is wrong, in which column, and what may be meant.
    """
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > MAX_BYTES:
        raise ValueError(f"the expression is {size} bytes long; at most {MAX_BYTES} are read")
    text = re.sub(r"\s", " ", text)
    if not text.strip():
        raise ValueError('the expression is empty; write a number or a formula such as "0.5 + 0.4*sin(2*pi*x/20)"')
    return _Reader(text).read()


class _Reader:
    """Takes one text apart."""

    def __init__(self, text: str) -> None:
        self._skipped = len(text) - len(text.lstrip())
        self._text = text.strip()
        self._nodes = 0

    def read(self) -> Node:
        self._check_characters()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what Python thinks doubtful is refused here
                body = ast.parse(self._text, mode="eval").body
        except SyntaxError as error:
            if not error.offset or error.offset > len(self._text):
                raise self._refusal("the expression ends too early", len(self._text)) from None
            what = re.split(r"[.;] ", str(error.msg))[0]
            raise self._refusal(what, error.offset - 1) from None
        except (RecursionError, MemoryError):
            raise self._too_deep(0) from None
        with np.errstate(all="ignore"):
            return self._node(body, 1)

    def _check_characters(self) -> None:
        depth = 0
        for column, character in enumerate(self._text):
            if character not in ALLOWED:
                hint = CHARACTER_HINTS.get(character, LANGUAGE)
                raise self._refusal(f"the character {character!r} has no meaning here", column, hint)
            depth += {"(": 1, ")": -1}.get(character, 0)
            if depth > MAX_DEPTH:
                raise self._too_deep(column)

    def _node(self, node: ast.AST, depth: int) -> Node:
        self._nodes += 1
        column = getattr(node, "col_offset", 0)
        if depth > MAX_DEPTH:
            raise self._too_deep(column)
        if self._nodes > MAX_NODES:
            raise ValueError(f"the expression has more than {MAX_NODES} numbers, names and operations")
        match node:
            case ast.Constant():
                return self._number(node)
            case ast.Name():
                return self._name(node)
            case ast.Call():
                return self._call(node, depth)
            case ast.UnaryOp(op=ast.UAdd()):
                return self._node(node.operand, depth + 1)
            case ast.UnaryOp(op=ast.USub()):
                return call(NEGATIVE, self._node(node.operand, depth + 1))
            case ast.BinOp() if type(node.op) in OPERATORS:
                operation = OPERATORS[type(node.op)]
                left, right = self._node(node.left, depth + 1), self._node(node.right, depth + 1)
                if operation is POWER and isinstance(right, Number) and not abs(right.value) <= MAX_EXPONENT:
                    raise self._refusal(
                        f"the exponent {right.value:g} is too large", node.right.col_offset,
                        f"constant exponents go from -{MAX_EXPONENT} to {MAX_EXPONENT}",
                    )  # fmt: skip
                return call(operation, left, right)
            case ast.Compare() if all(type(op) in COMPARISONS for op in node.ops):
                operands = [self._node(n, depth + 1) for n in (node.left, *node.comparators)]
                return call(comparison_chain([COMPARISONS[type(op)] for op in node.ops]), *operands)
        raise self._not_allowed(node)

    def _number(self, node: ast.Constant) -> Number:
        written = self._text[node.col_offset : node.end_col_offset]
        if not DECIMAL.fullmatch(written):
            raise self._refusal(
                f"'{shortened(written)}' is not a decimal number", node.col_offset, "numbers look like 12, 0.5, 1e-3"
            )
        value = float(written)
        if math.isinf(value):
            raise self._refusal(f"the number {shortened(written)} is too large", node.col_offset)
        return Number(value)

    def _name(self, node: ast.Name) -> Node:
        if node.id in CONSTANTS:
            return Number(CONSTANTS[node.id])
        if node.id in VARIABLES:
            return Variable(node.id)
        if node.id in FUNCTIONS:
            arity = FUNCTIONS[node.id].arity
            raise self._refusal(f"{node.id} is a function of {arity}", node.col_offset, f"write {node.id}(…)")
        raise self._unknown(node)

    def _call(self, node: ast.Call, depth: int) -> Node:
        column = node.col_offset
        if not isinstance(node.func, ast.Name):
            raise self._refusal("something that is no function is called", column, "a product is written a*b")
        name = node.func.id
        if name not in FUNCTIONS:
            if name in (*VARIABLES, *CONSTANTS):
                raise self._refusal(f"{name} is no function", column, f"a product is written {name}*(…)")
            raise self._unknown(node.func)
        if node.keywords:
            raise self._not_allowed(node.keywords[0])
        operation, given = FUNCTIONS[name], len(node.args)
        arguments = [self._node(a, depth + 1) for a in node.args]
        if given < operation.least or (operation.most is not None and given > operation.most):
            raise self._refusal(f"{name} takes {operation.arity}, but has {given}", column)
        return call(operation, *arguments)

    def _unknown(self, node: ast.Name) -> ValueError:
        names = (*VARIABLES, *CONSTANTS, *FUNCTIONS)
        near = difflib.get_close_matches(node.id.lower(), names, n=1)
        hint = f"did you mean {near[0]}?" if near else LANGUAGE
        return self._refusal(f"unknown name '{shortened(node.id)}'", node.col_offset, hint)

    def _not_allowed(self, node: ast.AST) -> ValueError:
        parts = [node, *(getattr(node, "ops", None) or [getattr(node, "op", node)])]
        known = next((NODE_HINTS[type(part)] for part in parts if type(part) in NODE_HINTS), None)
        start, end = getattr(node, "col_offset", 0), getattr(node, "end_col_offset", None)
        what, hint = known or (f"'{shortened(self._text[start:end])}'", LANGUAGE)
        return self._refusal(f"{what} cannot be used in an expression", start, hint)

    def _too_deep(self, column: int) -> ValueError:
        return self._refusal(
            f"the expression is nested more than {MAX_DEPTH} deep",
            column,
            "a long sum is less deep as (a + b) + (c + d)",
        )

    def _refusal(self, what: str, column: int, hint: str | None = None) -> ValueError:
        """The error at a column of the stripped text; people count from 1, in the text as written."""
        return ValueError(f"{what} (column {column + self._skipped + 1})" + (f"; {hint}" if hint else ""))


def shortened(text: str) -> str:
    """A text on one line, for messages."""
    line = " ".join(text.split())
    return line if len(line) <= MAX_SHOWN else f"{line[: MAX_SHOWN - 1]}…"
