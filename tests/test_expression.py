"""Expressions against Python's own arithmetic, their bounds against what they give, and every way to be refused."""

from __future__ import annotations

import math
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import TypeAdapter

from amslicer import JobError, load_job
from amslicer.fields import FieldSpec, Frame, Inputs, Sampler, open_field

Floats = NDArray[np.float64]

# A part away from the file's origin, with three different sides, none of them whole.
MINIMUM = np.array([10.0, -5.0, 3.0])
SIZE = np.array([4.0, 2.5, 1.0])
FRAME = Frame(MINIMUM, SIZE)
POINTS = np.random.default_rng(3).uniform(0, 1, (400, 3)) * SIZE
CORNERS = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)]) * SIZE
X, Y, Z = (POINTS + MINIMUM).T
U, V, W = (POINTS / SIZE).T


def opened(text: str, frame: Frame = FRAME) -> Sampler:
    field: Any = TypeAdapter(FieldSpec).validate_python({"expression": text})
    return open_field(field, frame, Inputs(Path("nowhere")))


def values(text: str, points: Floats = POINTS, frame: Frame = FRAME) -> Floats:
    return np.broadcast_to(opened(text, frame).scalar(*points.T), len(points))


def python_value(text: str, point: Floats) -> float:
    """What Python and its math module say at one point, file coordinates and shares spelt out."""
    names: dict[str, Any] = {
        name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan2", "hypot", "pi")
    }
    names |= {"abs": abs, "min": min, "max": max, "floor": lambda v: float(math.floor(v))}
    names |= {"where": lambda c, a, b: a if c else b, "clip": lambda v, low, high: min(max(v, low), high)}
    names |= dict(zip("xyz", (point + MINIMUM).tolist(), strict=True))
    names |= dict(zip("uvw", (point / SIZE).tolist(), strict=True))
    return float(eval(text, {"__builtins__": {}}, names))


# Values


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x", X),
        ("y", Y),
        ("z", Z),
        ("u", U),
        ("v", V),
        ("w", W),
        ("0.5 + 0.4*sin(2*pi*x/20)", 0.5 + 0.4 * np.sin(2 * np.pi * X / 20)),
        ("-x**2", -(X**2)),
        ("(-x)**2", X**2),
        ("2**-u", 1 / 2**U),
        ("2**u**2", 2 ** (U**2)),
        ("10 - x - y", 10 - X - Y),
        ("x / y / z", X / Y / Z),
        ("+u*-v", -U * V),
        ("(x - 12)**3", (X - 12) ** 3),
        ("where(x > 12, 0.2, 0.8)", np.where(X > 12, 0.2, 0.8)),
        ("where(u - 0.5 >= 0, u, -v)", np.where(U >= 0.5, U, -V)),
        ("where(x - 12, 1, 2)", np.where(X == 12, 2.0, 1.0)),
        ("11 < x <= 13", ((X > 11) & (X <= 13)).astype(float)),
        ("u < v < w", ((U < V) & (V < W)).astype(float)),
        ("(u == u)*(u != v)", np.ones(400)),
        ("(u >= v) + (u < v)", np.ones(400)),
        ("min(u, v, w)", np.minimum(np.minimum(U, V), W)),
        ("max(u, 0.5)", np.maximum(U, 0.5)),
        ("abs(y)*sqrt(x)", -Y * np.sqrt(X)),
        ("exp(-u)*log(x)", np.log(X) / np.exp(U)),
        ("tan(v)*cos(v) - sin(v)", np.zeros(400)),
        ("atan2(y, x)*180/pi", np.degrees(np.arctan(Y / X))),
        ("hypot(x, y)", np.sqrt(X**2 + Y**2)),
        ("floor(x) + floor(y)", np.trunc(X) + np.trunc(Y) - 1),
        ("clip(x, 11, 13)", np.where(X < 11, 11, np.where(X > 13, 13, X))),
        ("  u *\n  (v)\t", U * V),
        (".5 + 5. + 5e-1 + 1E1*u", 6 + 10 * U),
    ],
)
def test_a_formula_is_what_it_says(text: str, expected: Floats) -> None:
    np.testing.assert_allclose(values(text), expected, rtol=1e-12, atol=1e-12)


# Floats only: Python would raise whole numbers to powers exactly, for hours.
numbers = st.one_of(
    st.integers(0, 20).map(lambda v: f"{v}."),
    st.floats(0, 100, allow_subnormal=False).map(lambda v: f"{v:.3f}"),
    st.just("pi"),
)
leaves = st.one_of(numbers, st.sampled_from("xyzuvw"))


def combined(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    def form(pattern: str, count: int) -> st.SearchStrategy[str]:
        return st.tuples(*[inner] * count).map(lambda parts: pattern.format(*parts))

    binary = st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "<", "<=", ">", ">=", "==", "!="]), inner)
    named = st.sampled_from(["abs", "sqrt", "exp", "log", "sin", "cos", "tan", "floor"])
    return st.one_of(
        binary.map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        st.tuples(named, inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(inner, st.integers(-4, 5)).map(lambda t: f"({t[0]})**{t[1]}"),
        st.tuples(inner, inner).map(lambda t: f"abs({t[0]})**({t[1]})"),
        form("-({})", 1), form("({} < {} <= {})", 3), form("where({}, {}, {})", 3), form("min({}, {}, {})", 3),
        form("max({}, {})", 2), form("atan2({}, {})", 2), form("hypot({}, {})", 2), form("clip({}, {}, {})", 3),
    )  # fmt: skip


formulas = st.recursive(leaves, combined, max_leaves=12)
shares = st.tuples(*[st.floats(0, 1, allow_subnormal=False)] * 3)


@settings(max_examples=400, deadline=None)
@given(formula=formulas, share=shares)
def test_python_says_the_same(formula: str, share: tuple[float, float, float]) -> None:
    point = np.array(share) * SIZE
    try:
        expected = python_value(formula, point)
    except (ValueError, ZeroDivisionError, OverflowError, TypeError):  # NaN, infinite or complex there
        assume(False)
    # Steps and cancellation make more of the last bit's difference between two libraries: compare near-by points too.
    assume(math.isfinite(expected) and abs(expected) < 1e100)
    try:
        near = [python_value(formula, point * (1 + e)) for e in (-1e-13, 1e-13)]
    except (ValueError, ZeroDivisionError, OverflowError, TypeError):
        assume(False)
    spread = max(abs(v - expected) for v in near)
    assume(spread <= 1e-9 * max(1.0, abs(expected)))
    try:
        found = values(formula, point[None])[0]
    except ValueError as error:
        assume("exponent" not in str(error))
        raise
    assert found == pytest.approx(expected, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.2", 0.2),
        ("-0.2", -0.2),
        ("1/5", 0.2),
        ("0.1 + 0.2", 0.1 + 0.2),
        ("2**0.5", math.sqrt(2)),
        ("min(0.7, 0.2, 0.4)", 0.2),
        ("where(1 < 2, 0.2, 1/0)", 0.2),
        ("pi", math.pi),
        ("2*pi/3", 2 * math.pi / 3),
        ("floor(-1.5)", -2.0),
    ],
)
def test_a_constant_expression_is_that_constant(text: str, value: float) -> None:
    field = opened(text)
    assert field.bounds == (value, value)
    assert field.varies == (False, False, False)
    found = field.scalar(*POINTS.T)
    assert (found.shape, found.dtype, float(found)) == ((), np.dtype(np.float64), value)


def test_an_angle_is_a_plain_number() -> None:
    samples, weights = opened("179*u").taps(*POINTS.T)
    assert samples.shape == weights.shape == (1, 400)
    np.testing.assert_allclose(samples[0], 179 * U, rtol=1e-12)
    assert (weights == 1).all()
    assert opened("u").texels is None


# Coordinates


@pytest.mark.parametrize(
    ("text", "varies", "shape"),
    [
        ("sin(x)", (True, False, False), (1, 7)),
        ("u + x", (True, False, False), (1, 7)),
        ("v", (False, True, False), (5, 1)),
        ("z", (False, False, True), ()),
        ("where(w < 2, y, 3)", (False, True, True), (5, 1)),
        ("u*y", (True, True, False), (5, 7)),
        ("max(x, v, w)", (True, True, True), (5, 7)),
        ("2*pi", (False, False, False), ()),
    ],
)
def test_only_what_varies_is_evaluated(text: str, varies: tuple[bool, ...], shape: tuple[int, ...]) -> None:
    field = opened(text)
    assert field.varies == varies
    x, y, z = np.linspace(0, 4, 7)[None, :], np.linspace(0, 2, 5)[:, None], np.asarray(0.5)
    assert field.scalar(x, y, z).shape == shape


def test_beyond_the_box_a_field_stays_as_at_its_side() -> None:
    outside = np.array([[-3.0, 1.0, 0.5], [9.0, 1.0, 0.5], [2.0, -1.0, 4.0]])
    nearest = np.clip(outside, 0, SIZE)
    for text in ("x*y + z", "sqrt(u)*sqrt(1 - u)*v"):
        assert np.array_equal(values(text, outside), values(text, nearest))
    assert values("u", outside).tolist() == [0, 1, 0.5]


def test_a_box_without_extent_has_share_0() -> None:
    flat = Frame(MINIMUM, np.array([4.0, 0.0, 1.0]))
    points = np.array([[1.0, 0.0, 0.5], [2.0, 0.3, 0.25]])
    assert values("v", points, flat).tolist() == [0, 0]
    assert opened("v", flat).bounds == (0, 0)
    assert values("y", points, flat).tolist() == [-5, -5]


# Bounds


@settings(max_examples=300, deadline=None)
@given(formula=formulas)
def test_bounds_hold_everything(formula: str) -> None:
    try:
        field = opened(formula)
    except ValueError:
        assume(False)
    low, high = field.bounds
    assert low <= high
    inside = 0
    for point in np.concatenate([CORNERS, POINTS[:40]]):
        try:
            value = float(field.scalar(*(np.asarray(p) for p in point)))
        except JobError:
            continue
        inside += 1
        assert low <= value <= high, f"{value!r} at {point}"
    assume(inside)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("x", 10, 14),
        ("u", 0, 1),
        ("3 - x", -11, -7),
        ("x*y", -70, -25),
        ("u*(v - 0.5)", -0.5, 0.5),
        ("x/y", -5.6, -2),
        ("y/x", -0.5, -5 / 28),
        ("1/u", -math.inf, math.inf),
        ("(x - 12)**2", 0, 4),
        ("(x - 12)**3", -8, 8),
        ("x**-2", 1 / 196, 1 / 100),
        ("u**0.5", 0, 1),
        ("2**(v - u)", 0.5, 2),
        ("(2*u - 1)**(0.5*v + 1)", -math.inf, math.inf),
        ("sqrt(2*u - 1)", 0, 1),
        ("exp(u)", 1, math.e),
        ("log(1 + u)", 0, math.log(2)),
        ("abs(2*u - 1)", 0, 1),
        ("abs(y)", 2.5, 5),
        ("sin(u)", 0, math.sin(1)),
        ("sin(2*u)", 0, 1),
        ("sin(pi*(u - 0.5))", -1, 1),
        ("sin(x)", -1, math.sin(14)),
        ("cos(x)", math.cos(10), 1),
        ("cos(2 + u)", math.cos(3), math.cos(2)),
        ("cos(pi*u)", -1, 1),
        ("0.5 + 0.4*sin(2*pi*u)", 0.1, 0.9),
        ("sin(1e9*u)", -1, 1),
        ("tan(u)", 0, math.tan(1)),
        ("tan(2*u)", -math.inf, math.inf),
        ("atan2(u, 1)", 0, math.pi / 4),
        ("atan2(1, 2*u - 1)", math.pi / 4, 3 * math.pi / 4),
        ("atan2(2*v - 1, 2*u - 1)", -math.pi, math.pi),
        ("hypot(2*u - 1, 3)", 3, math.sqrt(10)),
        ("floor(x/3)", 3, 4),
        ("clip(x, 11, 12.5)", 11, 12.5),
        ("min(u, 0.3)", 0, 0.3),
        ("max(u, v, 0.3)", 0.3, 1),
        ("x > 20", 0, 0),
        ("x >= 10", 1, 1),
        ("x < 12", 0, 1),
        ("20 != x", 1, 1),
        ("x == x", 0, 1),
        ("5 < x < 9", 0, 0),
        ("where(x > 5, u, 7)", 0, 1),
        ("where(x < 5, u, 7)", 7, 7),
        ("where(x < 12, u, 7)", 0, 7),
        ("where(u > 0.5, 1/0, 2)", 2, math.inf),
    ],
)
def test_bounds_are_tight(text: str, low: float, high: float) -> None:
    found = opened(text).bounds
    assert found == pytest.approx((low, high), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("exp(u)", Decimal(1), Decimal(1).exp()),
        ("exp(-2 - u)", Decimal(-3).exp(), Decimal(-2).exp()),
        ("log(2 + u)", Decimal(2).ln(), Decimal(3).ln()),
        ("log(0.5 + u/4)", -Decimal(2).ln(), Decimal("0.75").ln()),
        ("hypot(u + 1, 1)", Decimal(2).sqrt(), Decimal(5).sqrt()),
        ("(u + 1.5)**23", Decimal("1.5") ** 23, Decimal("2.5") ** 23),
        ("(u + 2)**0.25", Decimal(2).sqrt().sqrt(), Decimal(3).sqrt().sqrt()),
    ],
)
def test_bounds_hold_the_exact_values(text: str, low: Decimal, high: Decimal) -> None:
    """28 digits of them, where float64 has 16: rounding to nearest alone would leave some out."""
    found = opened(text).bounds
    assert Decimal(found[0]) <= low
    assert Decimal(found[1]) >= high


# What has no value


@pytest.mark.parametrize(
    ("text", "value", "place"),
    [
        # Points along x at file 10.5, 11.5, 12.5, 13.5; y = -4, z = 3.25.
        ("sqrt(12 - x)", "nan", "x = 12.50, y = -4.00, z = 3.25"),
        ("1/(x - 11.5)", "inf", "x = 11.50, y = -4.00, z = 3.25"),
        ("log(x - 13.5)", "nan", "x = 10.50"),
        ("-exp(100*x)", "-inf", "x = 10.50"),
        ("where(sqrt(12 - x) > 1, 0.2, 0.8)", "nan", "x = 12.50"),
        ("sqrt(12 - x) != 1", "nan", "x = 12.50"),
        ("min(0.5, log(12 - x))", "nan", "x = 12.50"),
        ("1/(y + 4)", "inf", "x = 10.50, y = -4.00"),
        ("(x - 12)**0.5", "nan", "x = 10.50"),
    ],
)
def test_no_value_is_refused_with_its_place(text: str, value: str, place: str) -> None:
    x, y, z = np.arange(0.5, 4)[None, :], np.array([[1.0], [1.5]]), np.asarray(0.25)
    with pytest.raises(JobError) as caught:
        opened(text).scalar(x, y, z)
    message = caught.value.message
    assert f'"{text}" is {value} at {place}' in message
    assert message.endswith("mm (file coordinates)")
    assert caught.value.hint
    assert "\n" not in message


def test_what_is_not_chosen_may_have_no_value() -> None:
    np.testing.assert_allclose(
        values("where(x > 12, log(x - 12), 0)"), np.log(np.maximum(X, 12 + 1e-300) - 12 + (X <= 12))
    )


def test_a_long_expression_is_shown_in_part() -> None:
    with pytest.raises(JobError) as caught:
        values("log(-1)*u +\n" + "0*x + " * 50 + "1")
    assert '"log(-1)*u + 0*x' in caught.value.message
    assert '…" is nan' in caught.value.message


# What is refused

LONG_SUM = "+".join("x" * 65)
REFUSED = {
    # text: what is wrong, its column, what may be meant
    "sine(x)": ("unknown name 'sine'", 1, "did you mean sin?"),
    "0.5 + 0.4*sine(x)": ("unknown name 'sine'", 11, "did you mean sin?"),
    "  sine(x)": ("unknown name 'sine'", 3, "did you mean sin?"),
    "1 + X": ("unknown name 'X'", 5, "did you mean x?"),
    "arctan2(y, x)": ("unknown name 'arctan2'", 1, "did you mean atan2?"),
    "maximum(x, y)": ("unknown name 'maximum'", 1, "did you mean max?"),
    "2*PI": ("unknown name 'PI'", 3, "did you mean pi?"),
    "2*theta": ("unknown name 'theta'", 3, "there are numbers, x y z u v w pi"),
    "__import__(x)": ("unknown name '__import__'", 1, "sqrt"),
    "eval(x)": ("unknown name 'eval'", 1, ""),
    "x + sin": ("sin is a function of 1 argument", 5, "write sin(…)"),
    "x*(min + 1)": ("min is a function of 2 or more arguments", 4, "write min(…)"),
    "1 + x(3)": ("x is no function", 5, "x*(…)"),
    "pi(3)": ("pi is no function", 1, "pi*(…)"),
    "2(x)": ("no function is called", 1, "a*b"),
    "sin(x)(y)": ("no function is called", 1, "a*b"),
    "sin()": ("sin takes 1 argument, but has 0", 1, ""),
    "1 + sin(x, y)": ("sin takes 1 argument, but has 2", 5, ""),
    "where(x, y)": ("where takes 3 arguments, but has 2", 1, ""),
    "clip(x, 1)": ("clip takes 3 arguments, but has 2", 1, ""),
    "min(x)": ("min takes 2 or more arguments, but has 1", 1, ""),
    "min(x, *y)": ("a * without a first factor", 8, "a*b"),
    "clip(x, low=1, high=2)": ("an argument with a name", 9, "by their order"),
    "x if y else z": ("'if'", 1, "where(condition, a, b)"),
    "x + (y and z)": ("'and' or 'or'", 6, "multiply comparisons"),
    "x or y": ("'and' or 'or'", 1, "multiply comparisons"),
    "not x": ("'not'", 1, "1 - (…)"),
    "x in y": ("'in'", 1, "a < x < b"),
    "x is y": ("'is'", 1, "=="),
    "x // 2": ("'//'", 1, "floor(a/b)"),
    "x, y": ("a comma outside a function", 1, "decimal point"),
    "1 + x.real": ("a dot after a name", 5, ""),
    "(x for x in y)": ("'(x for x in y)' cannot be used", 1, ""),
    "await x": ("'await x' cannot be used", 1, ""),
    "x not in y": ("'x not in y' cannot be used", 1, ""),
    "1 + True": ("'True' is not a decimal number", 5, "12, 0.5, 1e-3"),
    "None": ("'None' is not a decimal number", 1, ""),
    "...": ("'...' is not a decimal number", 1, ""),
    "2 + 1j": ("'1j' is not a decimal number", 5, ""),
    "0x10": ("'0x10' is not a decimal number", 1, ""),
    "1_000": ("'1_000' is not a decimal number", 1, ""),
    "017": ("leading zeros", 1, ""),
    "1e999*x": ("the number 1e999 is too large", 1, ""),
    "9" * 4000: ("is too large", 1, ""),
    "2*'x'": ('the character "\'" has no meaning', 3, ""),
    'x + "y"': ("the character '\"' has no meaning", 5, ""),
    "x[0]": ("the character '[' has no meaning", 2, ""),
    "[x for x in y]": ("the character '['", 1, ""),
    "{x}": ("the character '{'", 1, ""),
    "lambda: x": ("the character ':'", 7, ""),
    "(x := 1)": ("the character ':'", 4, ""),
    "x @ y": ("the character '@'", 3, ""),
    "~x": ("the character '~'", 1, ""),
    "x % 2": ("the character '%'", 3, "a - b*floor(a/b)"),
    "x^2": ("the character '^'", 2, "a**b"),
    "2*π": ("the character 'π'", 3, "write pi"),
    "x − 1": ("the character '−'", 3, "minus"),
    "x # y": ("the character '#'", 3, ""),
    "ｓｉｎ(x)": ("the character 'ｓ'", 1, ""),
    "x\0": ("the character '\\x00'", 2, ""),
    "x\ud800": ("the character '\\ud800'", 2, ""),
    "2x": ("invalid decimal literal", 1, ""),
    "x y": ("invalid syntax", 3, ""),
    "x = 1": ("invalid syntax", 3, ""),
    "*x": ("invalid syntax", 1, ""),
    "1 + (x": ("'(' was never closed", 5, ""),
    "x)": ("unmatched ')'", 2, ""),
    "0.5 +": ("ends too early", 6, ""),
    " 0.5 * ": ("ends too early", 7, ""),
    "x**1000": ("the exponent 1000 is too large", 4, "from -64 to 64"),
    "x**-65": ("the exponent -65", 4, "from -64 to 64"),
    "x**(60 + 60)": ("the exponent 120", 5, "from -64 to 64"),
    "9**9**9": ("the exponent 3.8742e+08", 4, "from -64 to 64"),
    "x**(0/0)": ("the exponent nan", 5, ""),
    "-" * 64 + "x": ("nested more than 64 deep", 65, ""),
    "-" * 4000 + "x": ("nested more than 64 deep", None, ""),
    "(" * 65 + "x" + ")" * 65: ("nested more than 64 deep", 65, ""),
    "(" * 4000: ("nested more than 64 deep", 65, ""),
    "sin(" * 1000: ("nested more than 64 deep", 260, ""),
    LONG_SUM: ("nested more than 64 deep", 1, "(a + b) + (c + d)"),
    "1+" * 2000 + "1": ("nested more than 64 deep", 1, ""),
    "1<" * 2000 + "1": ("more than 1000 numbers, names and operations", None, ""),
    "min(" + "x," * 1000 + "y)": ("more than 1000 numbers, names and operations", None, ""),
    "x" * 4097: ("4097 bytes long; at most 4096", None, ""),
    "": ("the expression is empty", None, "0.5 + 0.4*sin(2*pi*x/20)"),
    " \n ": ("the expression is empty", None, ""),
    "1/0": ("the expression is inf everywhere", None, ""),
    "0/0": ("the expression is nan everywhere", None, ""),
    "sqrt(-1)": ("the expression is nan everywhere", None, ""),
}


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: ascii(text[:30]))
def test_refused(text: str) -> None:
    what, column, meant = REFUSED[text]
    content = {"materials": ["a", "b"], "fields": {"ratio": {"expression": text}}}
    with pytest.raises(JobError) as caught:
        load_job(content, part="part.stl")
    message = caught.value.message
    assert message.startswith("job: fields.ratio.expression: ")
    assert what in message
    assert meant in message
    if column is not None:
        assert f"(column {column})" in message
    assert "\n" not in message
    assert len(message) < 400


@pytest.mark.parametrize(
    "text",
    ["-" * 63 + "x", "(" * 64 + "x" + ")" * 64, "+".join("x" * 64), "x**64", "x**-64", "min(" + "x," * 997 + "x)",
     "(" + "x+" * 31 + "x)+(" + "x*" * 31 + "x)", " " * 4095 + "x"],
    ids=lambda text: text[:20],
)  # fmt: skip
def test_what_is_just_within_the_limits_is_read(text: str) -> None:
    assert opened(text).varies == (True, False, False)


def test_the_place_in_the_job_file_is_said(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_text('materials: [a, b]\nfields:\n  ratio: {expression: "sine(x)"}\n', encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load_job(file, part="part.stl")
    assert f"{file}, line 3, column" in caught.value.message
    assert "fields.ratio.expression: unknown name 'sine' (column 1); did you mean sin?" in caught.value.message


def test_a_nested_chain_is_evaluated_once() -> None:
    """Twice for each middle operand would be 2 to the 30th times."""
    text = "x"
    for _ in range(30):
        text = f"(0 < {text} < 100)"
    assert values(text).tolist() == [1] * 400
    assert opened(text).bounds == (1, 1)
