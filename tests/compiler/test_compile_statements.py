"""Statements: jumps, loops, handlers, scopes, and unreachable code."""

from __future__ import annotations

import pytest
from listing import code, compiled, compiled_body, instructions, method

from lfield.bytecode.program import Handler, Program
from lfield.compiler.program_builder import compile_program
from lfield.errors import ProgramError
from lfield.lang.frontend import check_text


def handlers(program: Program, name: str = "R.init") -> list[tuple[int, int, int, str]]:
    """Start, end, target relative to the frame of the method, and the class caught."""
    record = method(program, name)

    def row(handler: Handler) -> tuple[int, int, int, str]:
        exception_class = program.core.classes[handler.catches].name
        at = record.entry
        return handler.start - at, handler.end - at, handler.target - at, exception_class

    return [row(handler) for handler in record.handlers]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("while (true) yield();", ["yield", "jmp, L1"]),
        ("for (;;) yield();", ["yield", "jmp, L1"]),
        ("while (!false) { yield(); }", ["yield", "jmp, L1"]),
    ],
)
def test_an_endless_wait_is_a_yield_and_a_jump(body: str, expected: list[str]) -> None:
    assert instructions(compiled_body(body)) == expected


def test_a_loop_is_tested_at_its_end() -> None:
    assert code("int i = 0; while (i < 9) i = i + 1;") == [
        "move, ^2, 0",
        "jmp, L4",
        "addi, ^2, ^2, 1",
        "slti, ^3, ^2, 9",
        "bnz, L3, ^3",
    ]


def test_continue_jumps_to_the_step_of_a_for() -> None:
    assert code("for (int i = 0; i < 9; i = i + 1) { if (i == 4) continue; yield(); }") == [
        "move, ^2, 0",
        "jmp, L7",
        "eqi, ^3, ^2, 4",
        "bnz, L6, ^3",
        "yield",
        "addi, ^2, ^2, 1",
        "slti, ^3, ^2, 9",
        "bnz, L3, ^3",
    ]


def test_break_leaves_the_innermost_loop() -> None:
    made = code("while (true) { while (true) { if (arg == null) { break; } } if (arg != null) break; }")
    assert made == ["eqnull, ^2, ^1", "bnz, L4, ^2", "jmp, L1", "eqnull, ^2, ^1", "bz, L7, ^2", "jmp, L1"]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("if (a) yield();", ["bz, L5, ^2", "yield"]),
        ("if (!a) yield();", ["bnz, L5, ^2", "yield"]),
        ("if (a && b) yield();", ["bz, L6, ^2", "bz, L6, ^3", "yield"]),
        ("if (a || b) yield();", ["bnz, L5, ^2", "bz, L6, ^3", "yield"]),
        ("if (!(a || b)) yield();", ["bnz, L6, ^2", "bnz, L6, ^3", "yield"]),
        ("if (!(a && b)) yield();", ["bz, L5, ^2", "bnz, L6, ^3", "yield"]),
        ("if (a) yield(); else sleep(1.0);", ["bz, L6, ^2", "yield", "jmp, L8", "push, 1.0", "sleep"]),
        ("if (true) yield(); else sleep(1.0);", ["yield"]),
        ("if (false) yield(); else sleep(1.0);", ["push, 1.0", "sleep"]),
        ("while (false) yield();", []),
        ("while (a && b) yield();", ["jmp, L5", "yield", "bz, L7, ^2", "bnz, L4, ^3"]),
    ],
)
def test_conditions_compile_to_jumps(body: str, expected: list[str]) -> None:
    made = code(f"boolean a = arg == null; boolean b = a; {body}")
    assert made[2:] == expected


def test_unreachable_code_is_not_compiled() -> None:
    members = "private int f(int a) { if (a == 1) return 1; else return 2; }"
    program = compiled_body("", members)
    assert instructions(program, "R.f") == ["eqi, ^2, ^1, 1", "bz, L4, ^2", "return, 1", "return, 2"]


def test_a_method_that_may_miss_its_return_ends_with_noreturn() -> None:
    """`CacheTree.find` of appendix D is such a method: it has no return after its loop."""
    program = compiled_body("", "private int f(int a) { while (a > 0) { return 1; } }")
    assert instructions(program, "R.f")[-1] == "noreturn"


def test_inner_handlers_come_first_and_do_not_protect_catches() -> None:
    program = compiled_body(
        """
        try {
            try { yield(); } catch (NullException e) { sleep(1.0); } catch (IndexException e) { }
        } catch (Exception e) { throw e; }
        """
    )
    assert instructions(program) == [
        "yield",
        "jmp, L6",
        "push, 1.0",
        "sleep",
        "jmp, L6",
        "jmp, L8",
        "throw, ^4",
        "rtn",
    ]
    assert handlers(program) == [
        (1, 2, 3, "NullException"),
        (1, 2, 6, "IndexException"),
        (1, 6, 7, "Exception"),
    ]


def test_an_empty_try_compiles_to_nothing() -> None:
    program = compiled_body("try { } catch (Exception e) { yield(); }")
    assert instructions(program) == ["rtn"]
    assert handlers(program) == []


def test_locals_in_loops_are_initialized_in_every_round() -> None:
    made = code("while (arg != null) { int i; Pair p; i = i + 1; }")
    assert made[1:3] == ["move, ^2, 0", "move, ^3, null"]


def test_locals_outside_loops_need_no_initialization() -> None:
    assert code("int i; i = i + 1;") == ["addi, ^2, ^2, 1"]


def test_a_slot_is_reused_only_for_the_same_name_and_type() -> None:
    program = compiled_body("{ int i = 1; } { int i; i = 2; } { real i = 1.0; } { int j = 3; }")
    assert instructions(program)[:-1] == [
        "move, ^2, 1",
        "move, ^2, 0",
        "move, ^2, 2",
        "move, ^3, 1.0",
        "move, ^4, 3",
    ]
    (names,) = [dict(info.names) for info in program.debug.methods if info.signature == "init(string[])"]
    assert names == {0: "this", 1: "arg", 2: "i", 3: "i", 4: "j"}


_TEAM = """\
resource Arm {
    int held;
    init(string[] arg) { while (true) yield(); }
    portal synchronized lift(int kilos) emit int { held = kilos; return held; }
}
coordinator Guide {
    Arm arm;
    init(string[] arg) {
        arm = findArm(arg[1]);
        Arm[] all = findArm();
        int lifted = all[0].lift(3);
        arm.lift(lifted);
    }
}
"""


def test_portal_calls_and_finds_compile() -> None:
    program = compiled(_TEAM, "/somewhere/team.L")
    assert instructions(program, "Guide.init") == [
        "gete, ^2, ^1, 1",
        "push, ^2",
        "find, Arm",
        "pop, ^3",
        "putf, ^0, .arm, ^3",
        "findall, Arm",
        "pop, ^4",
        "gete, ^3, ^4, 0",
        "push, ^3",
        "push, 3",
        "pcall, Arm.lift(int)",
        "pop, ^5",
        "getf, ^3, ^0, .arm",
        "push, ^3",
        "push, ^5",
        "pcall, Arm.lift(int)",
        "pop, ^6",
        "rtn",
    ]
    assert method(program, "Arm.lift").synchronized
    assert not method(program, "Guide.init").synchronized


def test_debug_information_has_sources_lines_and_signatures() -> None:
    program = compiled(_TEAM, "/somewhere/team.L")
    assert [source.name for source in program.debug.sources] == ["team.L"]
    assert program.debug.sources[0].text == _TEAM
    index = program.core.methods.index(method(program, "Guide.init"))
    record = program.core.methods[index]
    lines = [program.line(index, pc)[1] for pc in range(record.entry, record.end)]
    assert lines == [8] + [9] * 5 + [10] * 2 + [11] * 5 + [12] * 5 + [13]
    assert [program.debug.methods[i].signature for i in range(3)] == [
        "init(string[])",
        "lift(int)",
        "init(string[])",
    ]


def test_the_digest_does_not_depend_on_the_source_path() -> None:
    assert compiled(_TEAM, "/a/team.L").digest == compiled("// moved\n" + _TEAM, "/b/other.L").digest


def test_too_many_variables_are_an_error_of_their_method() -> None:
    variables = "".join(f"int v{i} = {i};" for i in range(4200))
    with pytest.raises(ProgramError) as error:
        compiled_body("", f"private void f() {{ {variables} }} private void g() {{ {variables} }}")
    found = error.value.diagnostics
    assert [d.code for d in found] == ["L499", "L499"]
    assert found[0].message == "f() needs more than 4096 variables and intermediate values"


@pytest.mark.parametrize(
    ("before", "inside", "after"),
    [
        ("", "if (arg != null) { ", " }"),
        ("", "while (arg != null) ", ""),
        ("", "try { ", " } catch (Exception e) { }"),
        ("int i = ", "(1 + ", ")"),
        ("int i = ", "arg.length() + (f(1) + f(", "))"),
        ("int i = ", "arg[f(1)].substring(0, ", ").length()"),
        ("boolean b = ", "!(arg == null || ", ")"),
        ("int i = ", "f(", ")"),
    ],
)
def test_the_deepest_nesting_the_parser_accepts_compiles(before: str, inside: str, after: str) -> None:
    """The parser limits the nesting (L211), so no program overflows the stack of the compiler."""
    innermost = {"": "yield();", "boolean b = ": "true"}.get(before, "1")
    members = "private int f(int i) { return i; }"
    for depth in range(10, 200, 10):
        body = before + inside * depth + innermost + after * depth + ";"
        checked = check_text(f"resource R {{ init(string[] arg) {{ {body} }} {members} }}")
        if checked.program is None:
            assert {d.code for d in checked.errors} == {"L211"}
            return
        assert compile_program(checked.program)
    pytest.fail("the parser accepted 200 levels")


def test_debug_information_has_each_statement_of_a_line():
    program = compiled_body("int a = 1; a = a + 1; while (a < 9) a = a * 2;\nprint(i2s(a));")
    index = next(n for n in range(len(program.core.methods)) if program.method_name(n) == "R.init")
    lines = [line for _, line in program.debug.methods[index].lines]
    first = lines[1]
    assert lines.count(first) >= 4
    assert first + 1 in lines
    starts = [pc for pc, _ in program.debug.methods[index].lines]
    assert starts == sorted(set(starts))
