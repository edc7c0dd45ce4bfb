"""A random expression has the same result in a compiled program as in a small Python model.

`t(n)` writes n and returns n, so the tests also compare the order of evaluation. An expression that fails
must not change its target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.testing.golden import run_text

_VARIABLES = {"a": 3, "b": -7, "c": 0, "big": (1 << 63) - 1}
Trace = list[str]


class Trap(Exception):
    """The ArithmeticException of the model."""


@dataclass(frozen=True)
class Term:
    """An expression as L text and as a Python function."""

    text: str
    run: Callable[[Trace], int]


def _within(value: int) -> int:
    if not -(1 << 63) <= value < 1 << 63:
        raise Trap
    return value


def _divide(a: int, b: int) -> int:
    if b == 0:
        raise Trap
    return _within(abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1))


def _remainder(a: int, b: int) -> int:
    if b == 0:
        raise Trap
    return abs(a) % abs(b) * (-1 if a < 0 else 1)


_ARITHMETIC: dict[str, Callable[[int, int], int]] = {
    "+": lambda a, b: _within(a + b),
    "-": lambda a, b: _within(a - b),
    "*": lambda a, b: _within(a * b),
    "/": _divide,
    "%": _remainder,
}
_COMPARISONS: dict[str, Callable[[int, int], int]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}


def _literal(value: int) -> Term:
    return Term(str(value), lambda trace: value)


def _variable(name: str) -> Term:
    return Term(name, lambda trace: _VARIABLES[name])


def _binary(operator: str, left: Term, right: Term, table: dict[str, Callable[[int, int], int]]) -> Term:
    return Term(
        f"({left.text} {operator} {right.text})",
        lambda trace: table[operator](left.run(trace), right.run(trace)),
    )


def _traced(term: Term) -> Term:
    def run(trace: Trace) -> int:
        value = term.run(trace)
        trace.append(str(value))
        return value

    return Term(f"t({term.text})", run)


def _pair(left: Term, right: Term) -> Term:
    return Term(f"sum({left.text}, {right.text})", lambda trace: _within(left.run(trace) + right.run(trace)))


def _element(index: Term) -> Term:
    """`table[|index| % 3]` of {0, 10, 20}."""
    return Term(
        f"table[({index.text} % 3 + 3) % 3]", lambda trace: (_remainder(index.run(trace), 3) + 3) % 3 * 10
    )


def _choice(condition: Term, left: Term, right: Term) -> Term:
    """A call of a method with an if, because L has no conditional expression; it evaluates both operands."""

    def run(trace: Trace) -> int:
        chosen, one, other = condition.run(trace), left.run(trace), right.run(trace)
        return one if chosen else other

    return Term(f"pick({condition.text}, {left.text}, {right.text})", run)


_TRUTHS = (
    Term("true", lambda trace: 1),
    Term("yes", lambda trace: 1),
    Term("no", lambda trace: 0),
)


@st.composite
def conditions(draw: st.DrawFn, depth: int = 4) -> Term:
    """A condition of at most `depth` levels."""
    kind = draw(st.sampled_from(["truth", "compare", "not", "and", "or"])) if depth else "truth"
    if kind == "truth":
        return draw(st.sampled_from(_TRUTHS))
    if kind == "compare":
        operator = draw(st.sampled_from(sorted(_COMPARISONS)))
        return _binary(operator, draw(numbers(depth - 1)), draw(numbers(depth - 1)), _COMPARISONS)
    x = draw(conditions(depth - 1))
    if kind == "not":
        return Term(f"!{x.text}", lambda trace: not x.run(trace))
    y = draw(conditions(depth - 1))
    if kind == "and":
        return Term(f"({x.text} && {y.text})", lambda trace: x.run(trace) and y.run(trace))
    return Term(f"({x.text} || {y.text})", lambda trace: x.run(trace) or y.run(trace))


@st.composite
def numbers(draw: st.DrawFn, depth: int = 5) -> Term:
    """A number of at most `depth` levels."""
    kinds = ["literal", "variable"]
    inner = ["binary", "binary", "negate", "traced", "sum", "element", "choice"]
    kind = draw(st.sampled_from(kinds + inner if depth else kinds))
    if kind == "literal":
        return _literal(draw(st.integers(0, 9)))
    if kind == "variable":
        return _variable(draw(st.sampled_from(sorted(_VARIABLES))))
    x = draw(numbers(depth - 1))
    if kind == "negate":
        return Term(f"(-{x.text})", lambda trace: _within(-x.run(trace)))
    if kind == "traced":
        return _traced(x)
    if kind == "element":
        return _element(x)
    y = draw(numbers(depth - 1))
    if kind == "sum":
        return _pair(x, y)
    if kind == "choice":
        return _choice(draw(conditions(depth - 1)), x, y)
    return _binary(draw(st.sampled_from(sorted(_ARITHMETIC))), x, y, _ARITHMETIC)


_PROGRAM = """
resource R {{
    int[] table;
    init(string[] arg) {{
        int a = 3; int b = -7; int c = 0; int big = 9223372036854775807;
        boolean yes = true; boolean no = false; int x = 42;
        table = new int[3]; table[1] = 10; table[2] = 20;
        try {{ {statement} }} catch (ArithmeticException e) {{ write("trap\\n"); }}
        write(x); write("\\n");
    }}
    private int t(int n) {{ write(n); write("\\n"); return n; }}
    private int sum(int m, int n) {{ return m + n; }}
    private int pick(boolean which, int m, int n) {{ if (which) return m; return n; }}
}}
"""


def _outcome(term: Term) -> Trace:
    trace: Trace = []
    try:
        value = term.run(trace)
    except Trap:
        return [*trace, "trap", "42"]
    return [*trace, str(int(value))]


@given(numbers())
@settings(deadline=None, max_examples=60)
def test_a_random_number_expression_has_the_right_value(term: Term) -> None:
    world, _ = run_text(_PROGRAM.format(statement=f"x = {term.text};"))
    assert world.output == _outcome(term)


@given(numbers())
@settings(deadline=None, max_examples=25)
def test_an_expression_may_read_its_own_target(term: Term) -> None:
    world, _ = run_text(_PROGRAM.format(statement=f"x = sum(x, {term.text}) - x;"))
    expected = _outcome(term)
    if expected[-2:] != ["trap", "42"] and int(expected[-1]) + 42 >= 1 << 63:
        expected = [*expected[:-1], "trap", "42"]
    assert world.output == expected


@given(conditions(), st.booleans())
@settings(deadline=None, max_examples=60)
def test_a_random_condition_has_the_right_value(term: Term, branch: bool) -> None:
    """The condition is the condition of an if, or a value."""
    statement = (
        f"if ({term.text}) x = 1; else x = 0;"
        if branch
        else f"boolean v = {term.text}; if (v) x = 1; else x = 0;"
    )
    world, _ = run_text(_PROGRAM.format(statement=statement))
    assert world.output == _outcome(term)
