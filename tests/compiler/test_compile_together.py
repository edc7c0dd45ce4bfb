"""The code of `together`, `within`, `reserve`, and `finally`."""

from __future__ import annotations

import pytest
from listing import instructions

from lfield.bytecode.disassembler import disassemble
from lfield.testing.golden import compile_text

ARM = """
resource Arm {
    init(string[] arg) { }
    portal lift(int n) emit int { return n; }
    portal stop() { }
}
class Sum {
    public int a;
    public Sum(int a) { this.a = a; }
    public int get() { return a; }
    public int printed() { print(a); return a; }
    public int deep() { return printed(); }
}
"""


def boss(body: str, members: str = "") -> str:
    return (
        f'{ARM} coordinator Boss {{ init(string[] arg) {{ Arm arm = findArm("arm"); work(arm, new Sum(1)); }}'
        f" private void work(Arm arm, Sum sum) {{ {body} }} {members} }}"
    )


def instruction_names(body: str) -> list[str]:
    """The names of the instructions of `work` that call a method or a portal, or run in the machine."""
    words = ("gather", "begin", "start", "fetch", "leave", "limit", "hold", "take", "drop", "pcall", "call")
    words += ("print_int", "sleep")
    found = (line.split(",")[0] for line in instructions(compile_text(boss(body)), "Boss.work"))
    return [word for word in found if word in words]


def test_a_together_gathers_begins_and_fetches() -> None:
    assert instructions(compile_text(boss("int n = 5; together { n = arm.lift(3); }")), "Boss.work") == [
        "move, ^3, 5",
        "newarray, ^4, int[], 1",
        "move, ^5, 0",
        "pute, ^4, ^5, ^3",
        "gather",
        "pop, ^6",
        "push, ^6",
        "push, ^4",
        "push, 0",
        "push, ^1",
        "push, 3",
        "begin, Arm.lift(int)",
        "push, ^6",
        "fetch",
        "jmp, L20",
        "push, ^6",
        "push, ^7",
        "leave",
        "throw, ^7",
        "gete, ^3, ^4, 0",
        "rtn",
    ]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("together { arm.stop(); arm.stop(); }", "gather begin begin fetch leave"),
        # Pure computation does not start the collected calls.
        ("together { arm.lift(sum.get()); arm.lift(new Sum(2).a); }",
         "gather call begin call begin fetch leave"),
        ("together { int k = sum.get(); arm.lift(k); if (k > sum.get()) arm.stop(); }",
         "gather call begin call begin fetch leave"),
        # Any other statement starts the collected calls first.
        ("together { arm.stop(); print(1); arm.stop(); }",
         "gather begin start print_int begin fetch leave"),
        ("together { arm.stop(); sleep(1); }", "gather begin start sleep fetch leave"),
        ("together { arm.stop(); arm.lift(sum.deep()); }",
         "gather begin start call begin fetch leave"),
        ("together { arm.stop(); while (sum.deep() > 3) arm.stop(); }",
         "gather begin begin start call fetch leave"),
        ("together { arm.stop(); if (sum.a > 3) return; }", "gather begin start fetch leave"),
        ("while (true) { together { arm.stop(); while (true) break; if (sum.a > 3) break; } }",
         "gather begin start fetch leave"),
        ("together { arm.stop(); throw sum; }", "gather begin start leave"),
        ("together { arm.stop(); together { arm.stop(); print(1); } arm.stop(); }",
         "gather begin start gather begin start print_int fetch leave begin fetch leave"),
        ("together { arm.stop(); within (3) { print(1); } }",
         "gather begin start limit print_int fetch leave"),
        ("together { arm.stop(); try { print(1); } finally { print(2); } }",
         "gather begin start print_int print_int fetch leave"),
        # Jumps within an inner loop do not leave the together.
        ("together { for (int i = 0; i < 3; i = i + 1) { if (i == 1) continue; arm.stop(); } }",
         "gather begin fetch leave"),
    ],
)  # fmt: skip
def test_collected_calls_start_before_code_that_takes_time(body: str, expected: str) -> None:
    assert instruction_names(body) == expected.split()


def test_a_time_limit_is_a_handler_row() -> None:
    text = boss("within (2) { arm.stop(); }")
    assert instructions(compile_text(text), "Boss.work") == [
        "push, 2.0",
        "limit",
        "pop, ^3",
        "push, ^1",
        "pcall, Arm.stop()",
        "rtn",
    ]
    assert "limit ^3\n" in disassemble(compile_text(text))


def test_an_empty_time_limit_has_no_handler_row() -> None:
    assert "limit ^" not in disassemble(compile_text(boss("within (2) { }")))


def test_a_reserve_takes_at_its_start_and_drops_on_every_exit() -> None:
    text = boss("reserve (arm) { arm.stop(); }")
    assert instructions(compile_text(text), "Boss.work") == [
        "push, ^1",
        "hold",
        "pop, ^3",
        "push, ^3",
        "take",
        "push, ^1",
        "pcall, Arm.stop()",
        "move, ^4, null",
        "push, ^3",
        "drop",
        "eqnull, ^5, ^4",
        "bnz, L14, ^5",
        "throw, ^4",
        "rtn",
    ]
    listed = disassemble(compile_text(text))
    rows = [line.split() for line in listed.splitlines() if " reserved " in line or " finally " in line]
    (first, *reserved), (second, *_) = rows
    assert (first, reserved) == (second, ["reserved", "^3"])


def test_collected_calls_start_before_a_method_that_reserves() -> None:
    text = boss("together { arm.stop(); kept(arm); }", "private void kept(Arm arm) { reserve (arm) { } }")
    words = [line.split(",")[0] for line in instructions(compile_text(text), "Boss.work")]
    assert [word for word in words if word in ("begin", "start", "call", "fetch")] == [
        "begin",
        "start",
        "call",
        "fetch",
    ]


def test_all_exits_share_one_drop() -> None:
    exits = "if (sum.a > 1) break; if (sum.a > 2) return; continue;"
    assert instruction_names(f"while (true) {{ reserve (arm) {{ {exits} }} }}") == ["hold", "take", "drop"]


def test_the_code_of_a_finally_occurs_once() -> None:
    exits = "if (sum.a > 1) break; if (sum.a > 2) return; continue;"
    assert instruction_names(f"while (true) {{ try {{ {exits} }} finally {{ print(7); }} }}") == ["print_int"]


def test_nested_finally_code_grows_linearly() -> None:
    def size(depth: int) -> int:
        nest = "print(1);"
        for _ in range(depth):
            nest = f"while (true) {{ try {{ if (sum.a > 1) break; }} finally {{ {nest} }} }}"
        return len(instructions(compile_text(boss(nest)), "Boss.work"))

    assert size(12) - size(8) == size(8) - size(4)


def test_a_program_without_these_statements_has_no_code_of_them() -> None:
    program = compile_text(boss("try { arm.stop(); } catch (Exception e) { print(1); }"))
    assert {row.kind for method in program.core.methods for row in method.handlers} == {0}
    assert not {quad.op for quad in program.quads} & set(range(1600, 1700))
    assert "ticket" not in disassemble(program)
