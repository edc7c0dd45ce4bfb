"""The live slots of long methods: the least solution of the flow, in a number of steps linear in the code."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Program
from lfield.errors import ProgramError
from lfield.testing.golden import compile_text
from lfield.vm.memory.data_flow import Edge, Node, solve
from lfield.vm.memory.liveness import LiveSlots

GOLDEN = Path(__file__).parents[1] / "golden"
_ENDS = ("jmp", "return", "rtn", "throw", "noreturn")


def _boss(body: str) -> Program:
    text = "resource Arm { init(string[] arg) { } portal stop() { } }\n"
    start = 'Arm arm = findArm("arm"); int x = 0; string s = "";'
    return compile_text(f"{text}coordinator Boss {{ init(string[] arg) {{ {start} {body} }} }}")


#: Bodies of a method of a given length.
SHAPES: dict[str, Callable[[int], str]] = {
    "statements": lambda n: "".join(f"x = x * 3 + {i};" for i in range(n)),
    "loops": lambda n: "".join(f"while (x < {i}) {{ if (x == 7) break; x = x + 1; }}" for i in range(n)),
    "tries": lambda n: "".join(f"try {{ x = x / 3; }} catch (Exception e) {{ x = {i}; }}" for i in range(n)),
    "finallies": lambda n: "".join(f"try {{ x = x / {i}; }} finally {{ arm.stop(); }}" for i in range(n)),
    "live slots": lambda n: (
        "".join(f"string a{i} = s;" for i in range(n)) + "".join(f"s = s + a{i};" for i in range(n))
    ),
    "calls": lambda n: "".join("arm.stop();" for _ in range(n)),
}  # fmt: skip


def _longest(program: Program) -> int:
    methods = program.core.methods
    return max(range(len(methods)), key=lambda i: methods[i].end - methods[i].entry)


def _fixed_point(program: Program, record: MethodRecord) -> list[int]:
    """The definition before every instruction, applied until nothing changes."""
    sets = [0] * (record.end - record.entry + 1)
    while True:
        before = list(sets)
        for pc in range(record.end - 1, record.entry - 1, -1):
            quad = program.quads[pc]
            row = BY_CODE[quad.op]
            live = 0 if row.name in _ENDS else sets[pc + 1 - record.entry]
            operands = list(zip(row.operands, quad[1:], strict=False))
            for operand, value in operands:
                if operand.role == "D":
                    live &= ~(1 << value)
            for operand, value in operands:
                if operand.role in ("S", "V") and value >= 0:
                    live |= 1 << value
                elif operand.role == "L":
                    live |= sets[value - record.entry]
            sets[pc - record.entry] = live | _live_in_handlers(record, sets, pc)
        if sets == before:
            return sets


def _live_in_handlers(record: MethodRecord, sets: list[int], pc: int) -> int:
    live = 0
    for row in record.handlers:
        if row.start <= pc < row.end and row.kind in (CATCH, FINALLY):
            live |= sets[row.target - record.entry] & ~(1 << row.slot)
    return live


def _compare(program: Program) -> int:
    """Compare every method; return the number of instructions."""
    compared = 0
    for number, record in enumerate(program.core.methods):
        sets, slots = _fixed_point(program, record), LiveSlots(program, number)
        for pc in range(record.entry, record.end):
            assert slots.live_at(pc) == sets[pc - record.entry]
            assert slots.live_in_handlers(pc) == _live_in_handlers(record, sets, pc)
            compared += 1
    return compared


@pytest.mark.parametrize("shape", SHAPES)
def test_live_slots_satisfy_the_definition(shape):
    assert _compare(_boss(SHAPES[shape](12))) > 20


@pytest.mark.few(0)
def test_live_slots_of_golden_programs_satisfy_the_definition():
    paths = sorted(GOLDEN.rglob("*.L"))
    compared = 0
    for path in paths:
        # Some programs have errors on purpose.
        with contextlib.suppress(ProgramError):
            compared += _compare(compile_text(path.read_text(encoding="utf-8")))
    assert compared > 1000


@pytest.mark.few(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_work_is_linear_in_the_length_of_the_code(shape, steps):
    short, long = (_boss(SHAPES[shape](n)) for n in (30, 300))
    few, many = (steps(lambda p=p: LiveSlots(p, _longest(p))) for p in (short, long))
    assert many < 12 * few


def test_the_work_is_linear_for_code_against_its_order(steps):
    def against(count: int) -> Callable[[], object]:
        nodes = [Node(1, ()), *(Node(0, (Edge(i, -1),)) for i in range(count))]
        return lambda: solve(nodes)

    assert steps(against(3000)) < 12 * steps(against(300))
    assert steps(lambda: solve([*(Node(0, (Edge(i + 1, -1),)) for i in range(300)), Node(1, ())])) < 12000


def test_the_work_is_linear_for_nested_loops(steps):
    def nested(depth: int) -> list[Node]:
        heads = [Node(0, (Edge(i + 1, -1), Edge(max(0, i - 1), -1))) for i in range(depth)]
        return [*heads, Node(1 << 5, (Edge(0, -1),))]

    assert solve(nested(40)) == [1 << 5] * 41
    assert steps(lambda: solve(nested(400))) < 12 * steps(lambda: solve(nested(40)))


def test_an_edge_masks_slots():
    assert solve([Node(3, (Edge(1, ~1),)), Node(5, (Edge(0, ~2),))]) == [7, 5]
