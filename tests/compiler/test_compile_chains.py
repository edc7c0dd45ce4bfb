"""Chains of 2,000 links compile and have the correct value: sums, conditions, chained calls, `else if`."""

import pytest

from lfield.testing.golden import run_text

LINKS = 2_000

PROGRAM = """
class Counter {
    public int count;
    public Counter self;
    public Counter() { self = this; }
    public Counter add(int n) { count = count + n; return self; }
}
resource Arm {
    boolean yes = true;
    init(string[] arg) {
        int x = 1;
        boolean b = true;
        boolean c = false;
        string s = "";
        real r = 0.5;
        Counter counter = new Counter();
        %s
    }
    private int one() { return 1; }
    private boolean printed(int i) { write(i); write("\\n"); return yes; }
}
"""


def chain(term: str, operator: str) -> str:
    return f" {operator} ".join([term] * LINKS)


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("value", "result"),
    [
        (chain("1", "+"), "2000"),
        (chain("x", "+"), "2000"),
        ("x + " + chain("1", "+"), "2001"),
        (chain("1", "+") + " + x", "2001"),
        (chain("one()", "+"), "2000"),
        ("x" + " - 1 + 1" * (LINKS // 2), "1"),
        (chain("1", "*") + " % 7", "1"),
        (chain("2 * x + 1", "-"), str(3 - 3 * (LINKS - 1) + 2 * (LINKS - 1))),
        (f"f2i({chain('r', '+')})", "1000"),
        (f"f2i({chain('x', '+')} + {chain('r', '+')})", "3000"),
        (f"({chain('s', '+')}).length()", "0"),
        ("(" + chain('"ab"', "+") + ").length()", "4000"),
        ("counter" + ".add(1)" * LINKS + ".count", "2000"),
        ("counter" + ".self" * LINKS + ".count", "0"),
        ("s" + ".substring(0, 0)" * LINKS + ".length()", "0"),
    ],
    ids=lambda text: text[:24],
)
def test_a_long_expression_has_the_right_value(value: str, result: str) -> None:
    world, _ = run_text(PROGRAM % f'write({value}); write("\\n");')
    assert world.output == [result]


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("condition", "result"),
    [
        (chain("b", "&&"), "true"),
        (chain("c", "||"), "false"),
        (chain("b", "&&") + " && c", "false"),
        (chain("printed(1) && c", "||"), "1\n" * LINKS + "false"),
        (chain("yes", "&&"), "true"),
        (chain("b && yes", "||"), "true"),
        (chain("b", "=="), "true"),
        (chain("x + 1", "-") + " < 0", "false"),
        (chain("x", "+") + " == 2000 && " + chain("b", "&&"), "true"),
        ("printed(1) || " + chain("printed(2)", "||"), "1\ntrue"),
    ],
    ids=lambda text: text[:24],
)
def test_a_long_condition_has_the_right_value(condition: str, result: str) -> None:
    """The condition is a value in the first program, and the condition of an if in the second."""
    as_value = f'b = {condition}; write(b); write("\\n");'
    as_branch = f'if ({condition}) write("true\\n"); else write("false\\n");'
    for text in (as_value, as_branch):
        world, _ = run_text(PROGRAM % text)
        assert world.output == result.split("\n")


@pytest.mark.few(0)
def test_a_long_else_if_chain_runs_one_branch() -> None:
    branches = " else ".join(f"if (x == {i}) printed({i});" for i in range(2, LINKS))
    for x, result in ((2, ["2"]), (LINKS - 1, [str(LINKS - 1)]), (1, ["0"])):
        world, _ = run_text(PROGRAM % f"x = {x}; {branches} else printed(0);")
        assert world.output == result


def test_an_else_if_chain_that_always_returns_needs_no_return_after_it() -> None:
    branches = " else ".join(f"if (n == {i}) return {i};" for i in range(LINKS))
    method = f"private int way(int n) {{ {branches} else return -1; }}"
    program = f"resource Arm {{ init(string[] a) {{ write(way(77)); write(way(-3)); }} {method} }}"
    world, _ = run_text(program)
    assert world.output == ["77-1"]
