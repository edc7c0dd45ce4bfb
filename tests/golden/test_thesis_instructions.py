"""Every instruction of the tables of appendix J: a program that uses it, and prints as in the table.

Each program runs on two engines, as the golden programs do (conftest.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from lfield.bytecode.opcodes import BY_NAME
from lfield.testing.golden import compile_text, run_text

PROGRAM = """
class Pair {{ public int a; public Pair next; }}
resource Rover {{
    int field;
    init(string[] arg) {{ {resource} }}
    private int twice(int j) {{ return j + j; }}
    private void note(int j) {{ print("noted " + i2s(j)); }}
    private boolean isSmall(int j) {{ return j < 5; }}
    portal square(int j) emit int {{ print("here"); return j * j; }}
}}
coordinator Boss {{ init(string[] arg) {{ {coordinator} }} }}
"""
INTS = 'int a = s2i("-7"); int b = s2i("3"); '
REALS = 'real a = s2f("-7.5"); real b = s2f("2.5"); '
STRINGS = 'string a = "ab"; string b = "b"; '


@dataclass(frozen=True)
class Case:
    """Statements of the resource or of the coordinator, and the lines that they print."""

    resource: str = ""
    coordinator: str = ""
    prints: str = ""


def comparison(values: str, operator: str, less: bool, equal: bool, greater: bool) -> Case:
    """`a op b`, `a op a` and `b op a`, where a is less than b."""
    words = [str(each).lower() for each in (less, equal, greater)]
    return Case(
        f"{values} print(a {operator} b); print(a {operator} a); print(b {operator} a);", "", " ".join(words)
    )


def comparisons(suffix: str, values: str) -> dict[str, Case]:
    """The six comparisons of table J.8 for one type."""
    return {
        "eq" + suffix: comparison(values, "==", less=False, equal=True, greater=False),
        "sle" + suffix: comparison(values, "<=", less=True, equal=True, greater=False),
        "sge" + suffix: comparison(values, ">=", less=False, equal=True, greater=True),
        "sne" + suffix: comparison(values, "!=", less=True, equal=False, greater=True),
        "slt" + suffix: comparison(values, "<", less=True, equal=False, greater=False),
        "sgt" + suffix: comparison(values, ">", less=False, equal=False, greater=True),
    }


CASES: dict[str, Case] = {
    # J.1
    "bnz": Case("int i = 0; while (i < 3) i = i + 1; print(i);", "", "3"),
    "jmp": Case(INTS + "if (a > b) print(1); else print(2); print(3);", "", "2 3"),
    # J.2
    "move": Case(INTS + "a = b; print(a);", "", "3"),
    # J.3
    "call": Case("print(twice(twice(2)));", "", "8"),
    "pcall": Case("", 'print(findRover("rover").square(3));', "here 9"),
    "frame": Case("note(1);", "", "noted_1"),
    "return": Case("print(twice(4));", "", "8"),
    "rtn": Case("note(2); print(3);", "", "noted_2 3"),
    # J.4
    "new": Case("Pair p = new Pair(); Pair q = new Pair(); print(p == q); print(p.a);", "", "false 0"),
    "newarray": Case("int[] a = new int[3]; print(a.length()); print(a[2]);", "", "3 0"),
    # J.5
    "push": Case("print(twice(5));", "", "10"),
    "pop": Case("int i = twice(5); print(i + 1);", "", "11"),
    # J.6
    "and": Case(
        "boolean s = isSmall(1); boolean t = isSmall(9); print(s && s); print(s && t);", "", "true false"
    ),
    "or": Case(
        "boolean s = isSmall(1); boolean t = isSmall(9); print(t || s); print(t || t);", "", "true false"
    ),
    # J.7
    "addi": Case(INTS + "print(a + b);", "", "-4"),
    "addf": Case(REALS + "print(a + b);", "", "-5.0"),
    "subi": Case(INTS + "print(a - b);", "", "-10"),
    "subf": Case(REALS + "print(a - b);", "", "-10.0"),
    "muli": Case(INTS + "print(a * b);", "", "-21"),
    "mulf": Case(REALS + "print(a * b);", "", "-18.75"),
    "divi": Case(INTS + "print(a / b);", "", "-2"),
    "divf": Case(REALS + "print(a / b);", "", "-3.0"),
    "mod": Case(INTS + "print(a % b);", "", "-1"),
    # J.8
    **comparisons("i", INTS),
    **comparisons("f", REALS),
    **comparisons("s", STRINGS),
    "eqnull": Case("Pair p = null; print(p == null); p = new Pair(); print(p == null);", "", "true false"),
    # J.9
    "write_int": Case('write(s2i("12")); write("\\n");', "", "12"),
    "write_float": Case('write(s2f("2.5")); write("\\n");', "", "2.5"),
    "write_str": Case('write("text\\n");', "", "text"),
    "array_len": Case("print(arg.length());", "", "1"),
    "str_concat": Case(STRINGS + "print(a + b);", "", "abb"),
    "i2f": Case(INTS + "print(i2f(a));", "", "-7.0"),
    "f2i": Case(REALS + "print(f2i(a));", "", "-7"),
    "yield": Case('print("first"); yield(); print("third");', 'print("second");', "first second third"),
    "s2i": Case(
        'print(s2i("42")); try { s2i("4x"); } catch (ConversionException e) { print("refused"); }',
        "",
        "42 refused",
    ),
    "s2f": Case(
        'print(s2f("4.25")); try { s2f("4,2"); } catch (ConversionException e) { print("refused"); }',
        "",
        "4.25 refused",
    ),
    # J.10
    "find": Case("", 'Rover r = findRover("rover"); print(r.agent());', "rover"),
    "findall": Case("", "Rover[] all = findRover(); print(all.length()); print(all[0].agent());", "1 rover"),
}
#: Table J.11: the instructions for each addressing mode here.
ADDRESSING: dict[str, tuple[tuple[str, ...], Case]] = {
    "global": (("addi", "lds"), Case('int i = 2; print(i + 5); print("text");', "", "7 text")),
    "local": (("move",), Case("int i = 2; int j = i; i = 3; print(j);", "", "2")),
    "relative": (("getf", "putf"), Case("field = 4; print(field);", "", "4")),
    "indexed": (("gete", "pute"), Case("int[] a = new int[2]; a[1] = 6; print(a[0] + a[1]);", "", "6")),
}


def ran(case: Case, *names: str) -> list[str]:
    """The lines that the case prints; its code must have the instructions of these names."""
    text = PROGRAM.format(resource=case.resource, coordinator=case.coordinator)
    assert {BY_NAME[name].code for name in names} <= {quad.op for quad in compile_text(text).quads}
    return run_text(text)[0].output


@pytest.mark.parametrize("name", CASES)
def test_instruction(name: str) -> None:
    assert [line.replace(" ", "_") for line in ran(CASES[name], name)] == CASES[name].prints.split()


@pytest.mark.parametrize("mode", ADDRESSING)
def test_addressing_mode(mode: str) -> None:
    names, case = ADDRESSING[mode]
    assert ran(case, *names) == case.prints.split()
