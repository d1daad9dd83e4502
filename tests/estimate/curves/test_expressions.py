"""Formulas: read as arithmetic says, differentiated exactly, and never run."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.estimate.curves.expressions import FUNCTIONS, parse
from camcal.solve.differentiate import central_jacobian, complex_jacobian

X = np.array([0.2, 0.5, 0.9])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2 + 3*4", 14),
        ("2**3**2", 512),
        ("-2**2", -4),
        ("(1 + 2)/4 - .5e1", -4.25),
        ("2*pi", 2 * math.pi),
        ("+x - -x", 2 * X),
        ("exp(log(x))", X),
        ("x**0.5", np.sqrt(X)),
        ("erf(x)", [math.erf(x) for x in X]),
        ("abs(0 - x)*1", X),
    ],
)
def test_formulas_mean_what_arithmetic_says(text, expected):
    np.testing.assert_allclose(parse(text).value({"x": X}), expected, rtol=1e-15)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_the_slope_of_every_function_is_exact(name):
    formula = parse(f"{name}(a*x + 0.05)")
    values = {"x": X, "a": 0.8}
    slopes = formula.with_derivatives(values, ["a"]).slopes
    if formula.analytic:
        numeric, tolerance = complex_jacobian(lambda p: formula.value({"x": X, "a": p[0]}), np.array([0.8])), 1e-14
    else:
        # fourth order, rounding over steps of 1e-3
        numeric, tolerance = central_jacobian(lambda p: formula.value({"x": X, "a": p[0]}), np.array([0.8])), 1e-11
    np.testing.assert_allclose(slopes, numeric.T, rtol=tolerance)


NUMBERS = st.floats(0.1, 3.0).map(lambda value: f"{value:.3f}")
FORMULAS = st.recursive(
    st.one_of(NUMBERS, st.sampled_from(["a", "b", "x"])),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda parts: "({} {} {})".format(*parts)),
        st.tuples(inner, st.sampled_from(["2", "3", "0.5"])).map(lambda parts: "({} ** {})".format(*parts)),
        st.tuples(st.sampled_from(["exp", "sin", "atan", "tanh", "erf"]), inner).map("{0[0]}({0[1]})".format),
    ),
    max_leaves=8,
)


@given(FORMULAS)
def test_derivatives_of_any_formula_are_those_of_complex_steps(text):
    formula = parse(text)
    at = np.array([0.7, 1.3])
    dual = formula.with_derivatives({"x": X, "a": at[0], "b": at[1]}, ["a", "b"])
    slopes = np.zeros((2, 3)) if dual.slopes is None else np.broadcast_to(dual.slopes, (2, 3))
    with np.errstate(all="ignore"):
        numeric = complex_jacobian(lambda p: np.broadcast_to(formula.value({"x": X, "a": p[0], "b": p[1]}), 3), at).T
    defined = np.isfinite(slopes) & np.isfinite(numeric) & np.isfinite(dual.value) & (np.abs(numeric) < 1e12)
    # both are exact to rounding, which cancellation in a formula of eight numbers may enlarge
    np.testing.assert_allclose(slopes[defined], numeric[defined], rtol=1e-7, atol=1e-9)


@given(FORMULAS)
def test_values_of_any_formula_are_pythons(text):
    names = {"a": 0.7, "b": 1.3, "x": 0.5, "exp": math.exp, "sin": math.sin, "atan": math.atan, "tanh": math.tanh}
    try:
        expected = eval(text, {"__builtins__": {}}, names | {"erf": math.erf})
    except (ZeroDivisionError, OverflowError):
        return
    found = parse(text).value({"a": 0.7, "b": 1.3, "x": np.array([0.5])})
    if isinstance(expected, complex):  # a root of a negative number
        assert not np.isfinite(np.broadcast_to(found, 1)[0])
    else:
        np.testing.assert_allclose(found, expected, rtol=1e-9)  # cancellation in a formula of eight numbers


def test_the_slope_of_a_power_of_nothing_is_nothing():
    dual = parse("x**a").with_derivatives({"x": np.array([0.0, 2.0]), "a": 1.5}, ["a"])
    np.testing.assert_allclose(dual.slopes, [[0.0, 2**1.5 * np.log(2)]])


def test_names_are_those_that_need_a_value():
    assert parse("a*sin(2*pi*x/period) + a").names == {"a", "x", "period"}


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("a*x^2", 1, r"a power is written \*\*"),
        ("exp(x", 4, "not a formula"),
        ("a*y = 3", 5, "not a formula"),
        ("a == 3", 1, "one side only"),
        ("exp[x]", 1, "parentheses, not square brackets"),
        ("1,5*x", 1, "a dot, not a comma"),
        ("a.b", 1, "no dot"),
        ("2*sine(x)", 3, "unknown function 'sine'. Did you mean 'sin'?"),
        ("foo(x)", 1, "Known are abs, acos"),
        ("exp(x, 2)", 1, "exp takes one value"),
        ("exp()", 1, "exp takes one value"),
        ("exp(*x)", 1, "exp takes one value"),
        ("x if x else x", 1, "only numbers, names"),
        ("x // 2", 1, "only numbers, names"),
        ("x and 1", 1, "only numbers, names"),
        ("True*x", 1, "only numbers, names"),
        ("'text'", 1, "only numbers, names"),
        ("größe*x^2 + 'q'", 1, "a power"),
        ("größe*x + 'q'", 11, "only numbers, names"),
        ("1j*x", 1, "only numbers, names"),
        ("2*1e999*x", 3, "a number beyond"),
        (f"x*{10**400}", 3, "a number beyond"),
        ("x + " * 60 + "'q'", 241, "…x .* only numbers, names"),
        ("", 1, "not a formula"),
    ],
)
def test_what_is_no_formula_is_refused_with_its_place(text, place, words):
    with pytest.raises(InvalidInput, match=words) as refused:
        parse(text)
    assert f"character {place}" in str(refused.value)


def test_an_unknown_name_is_told_with_its_place_and_the_nearest():
    with pytest.raises(InvalidInput, match=r"character 7: unknown name 'slpoe'; parameters are slope. Did you mean"):
        parse("a + 2*slpoe").require_known(["a", "slope"], "parameters are slope")


UNTRUSTED = [
    "__import__('os').system('touch pwned')",
    "open('pwned', 'w')",
    "().__class__.__bases__[0].__subclasses__()",
    "[x for x in ().__class__.__mro__]",
    "(lambda: open('pwned', 'w'))()",
    "exec('import os')",
    "eval('1')",
    "exp(__import__('os').getpid())",
    'f\'{open("pwned", "w")}\'',
    "x := 3",
    "globals()",
    "exp.__globals__",
    "await x",
    "yield",
    "import os",
    "1; open('pwned', 'w')",
    "a\nb",
    "\0",
    "(" * 500 + "x" + ")" * 500,
    "-" * 500 + "x",
    "+".join("x" * 1500),
]


@pytest.mark.parametrize("text", UNTRUSTED, ids=range(len(UNTRUSTED)))
def test_untrusted_text_is_refused_and_never_run(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput):
        parse(text)
    assert not Path("pwned").exists()


@given(st.text(max_size=60))
def test_any_text_is_a_formula_or_an_error_of_one_line(text):
    try:
        formula = parse(text)
    except InvalidInput as refused:
        assert "\n" not in str(refused)  # noqa: PT017
    else:
        formula.value(dict.fromkeys(formula.names, 1.0))


def test_huge_powers_overflow_to_infinity_at_once():
    assert parse("9**9**9**9").value({}) == np.inf
