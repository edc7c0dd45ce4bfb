"""Constants, enums and functions across files: order, names, and hiding."""

from __future__ import annotations

from pathlib import Path

import pytest
from lang_expectations import CAPABILITIES

from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import CheckResult, check_file, check_text
from lfield.lang.language_library import FUNCTIONS
from lfield.lang.types import INT, EnumType


def checked(folder: Path, **files: str) -> CheckResult:
    """The program whose first file is `main`."""
    for name, text in files.items():
        (folder / f"{name}.L").write_text(text, encoding="utf-8")
    return check_file(folder / "main.L", capabilities=CAPABILITIES)


def drawn(found: CheckResult) -> list[str]:
    return [f"{Path(d.span.source.name).stem}:{d.span.line} {d.code}" for d in found.diagnostics]


MAIN = """include "limits.L";
include "shapes.L";
const real FAST = SLOW * 2;
resource Arm {
    Phase phase = FIRST;
    init(string[] arg) { print(area(FAST)); }
}
"""
LIMITS = """include "main.L";
const real SLOW = 2.5;
const Phase FIRST = Phase.LIFT;
"""
SHAPES = """include "limits.L";
enum Phase { SEARCH, LIFT }
real area(real side) { return side * clipped(side); }
real clipped(real x) { return min(x, FAST); }
"""


def test_declarations_of_all_files_share_one_namespace(tmp_path: Path) -> None:
    program = checked(tmp_path, main=MAIN, limits=LIMITS, shapes=SHAPES).or_raise()
    assert [enum.name for enum in program.enums] == ["Phase"]
    (arm,) = program.units
    assert arm.fields[0].type == EnumType("Phase")
    assert sorted(method.name for method in arm.library_methods) == ["area", "clipped"]


def test_order_of_includes_does_not_matter(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    lines = MAIN.split("\n")
    swapped = "\n".join([lines[1], lines[0], *lines[2:]])
    first = compile_program(checked(one, main=MAIN, limits=LIMITS, shapes=SHAPES).or_raise())
    second = compile_program(checked(other, main=swapped, limits=LIMITS, shapes=SHAPES).or_raise())
    assert first.digest == second.digest


def test_name_in_two_files_is_reported_with_the_other_place(tmp_path: Path) -> None:
    found = checked(tmp_path, main=MAIN + "const int SLOW = 1;", limits=LIMITS, shapes=SHAPES)
    assert drawn(found) == ["limits:2 L307"]
    assert "main.L, line 8" in found.diagnostics[0].message


def test_cycle_of_constants_over_files_is_reported(tmp_path: Path) -> None:
    limits = LIMITS.replace("2.5", "FAST / 2")
    found = checked(tmp_path, main=MAIN, limits=limits, shapes=SHAPES)
    assert drawn(found) == ["main:3 L320"]
    assert found.diagnostics[0].message.endswith("FAST - SLOW - FAST")


def test_missing_file_gives_no_further_errors(tmp_path: Path) -> None:
    assert drawn(checked(tmp_path, main=MAIN, shapes=SHAPES)) == ["main:1 L601"]


HIDING = """
const int n = 1;
int twice(int x) { return 2 * x; }
int both(int x) { return twice(x) + n; }
class Box {
    public int n = 7;
    public int own() { return twice(n) + both(1); }
    private int twice(int x) { return -x; }
}
class Other {
    public int get() { int n = 5; return twice(n); }
}
"""


def test_members_and_locals_hide_top_level_names() -> None:
    program = check_text(HIDING).or_raise()
    box, other = program.units
    assert [method.name for method in box.library_methods] == ["both", "twice"]
    assert [method.name for method in other.library_methods] == ["twice"]
    # The function `both` calls the function `twice`, not the method of Box.
    (both,) = (method for method in box.library_methods if method.name == "both")
    called = both.body[0].value.left.method  # type: ignore[attr-defined]
    assert called in box.library_methods
    (own,) = (method for method in box.methods if method.name == "own")
    assert own.body[0].value.left.method in box.methods  # type: ignore[attr-defined]


def test_enum_or_function_precedes_a_capability_of_its_name() -> None:
    text = "enum Lift { UP, DOWN } coordinator Boss { init(string[] arg) { Lift l = Lift.DOWN; } }"
    program = check_text(text, capabilities=CAPABILITIES).or_raise()
    assert [unit.name for unit in program.units] == ["Boss"]
    text = "int findLift(int n) { return n; } coordinator Boss { init(string[] arg) { print(findLift(1)); } }"
    program = check_text(text, capabilities=CAPABILITIES).or_raise()
    assert [unit.name for unit in program.units] == ["Boss"]


@pytest.mark.parametrize("word", ["const", "enum"])
def test_const_and_enum_are_names_elsewhere(word: str) -> None:
    text = f"""
    class {word} {{ public int {word}; public {word}({word} {word}) {{ this.{word} = 1; }} }}
    {word} f({word} {word}) {{ return {word}; }}
    const int {word}s = 3;
    enum {word}ed {{ {word}, other }}
    resource R {{
        int {word};
        init(string[] arg) {{ {word} = f(null).{word} + {word}s; this.{word}({word}ed.{word}); }}
        private void {word}({word}ed x) {{ }}
    }}
    """
    assert [d.render() for d in check_text(text).diagnostics] == []


@pytest.mark.few(0)
def test_long_chain_and_deep_cycle_need_no_recursion() -> None:
    chain = "const int A0 = 1; " + " ".join(f"const int A{i} = A{i - 1} + 1;" for i in range(1, 3000))
    found = check_text(
        f"{chain} const int SUM = {' + '.join(['1'] * 5000)}; class K {{ public int n = A2999 + SUM; }}"
    )
    assert found.diagnostics == []
    cycle = " ".join(f"const int B{i} = B{(i + 1) % 3000};" for i in range(3000))
    assert [d.code for d in check_text(cycle).diagnostics] == ["L320"]


def test_constants_are_checked_like_literals() -> None:
    program = """
    const real NEVER = -1.0;
    const string LATER = "payload >=";
    resource Crane {
        init(string[] arg) { }
        portal lift(real height) emit real { return height; }
        portal stop() { }
    }
    coordinator Boss {
        init(string[] arg) {
            within (NEVER) { print(1); }
            findLift(LATER);
            while (ALWAYS) yield();
            print("never");
        }
    }
    const boolean ALWAYS = true;
    """
    found = check_text(program, capabilities=CAPABILITIES)
    assert sorted(d.code for d in found.diagnostics) == ["L422", "L812"]
    found = check_text(
        program.replace("-1.0", "1.0").replace("payload >=", "payload >= 1"), capabilities=CAPABILITIES
    )
    assert [d.code for d in found.diagnostics] == ["L902"]


#: Effects of the library functions by name. Add a new one to one of the two sets, and to purity.py if it does
#: more than compute.
PURE = {
    *("s2i", "s2f", "i2f", "f2i", "i2s", "f2s", "b2s", "abs", "min", "max", "sqrt", "sin", "cos", "tan"),
    *("asin", "acos", "atan2", "exp", "log", "pow", "floor", "ceil", "round", "mapArea"),
    "surveyStrips",
}
IMPURE = {"print", "yield", "sleep", "now", "random"}


def test_each_library_function_is_pure_or_reported() -> None:
    assert {function.name for function in FUNCTIONS if function.scope == "any"} == PURE | IMPURE
    values = {"int": "1", "real": "0.5", "string": '"1"', "boolean": "true"}
    for function in FUNCTIONS:
        arguments = ", ".join(values[str(kind)] for kind in function.parameters)
        text = f"void f() {{ {function.name}({arguments}); }}"
        codes = [found.code for found in check_text(text).diagnostics]
        assert codes == ([] if function.name in PURE else ["L437"]), text


def test_functions_have_no_access_to_their_caller() -> None:
    text = "int f() { return n; } class Box { private int n; public int get() { return f(); } }"
    (found,) = check_text(text).diagnostics
    assert (found.code, found.span.line, found.span.column) == ("L301", 1, 18)
    assert (
        check_text("int f(int k) { return k; } class K { public int n = f(2); }")
        .or_raise()
        .units[0]
        .fields[0]
        .type
        == INT
    )
