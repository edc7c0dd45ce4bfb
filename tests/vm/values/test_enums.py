"""Enums as displayed: decoded blocks, a debugger, listings, tests of missions; and the verifier."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest
from msgspec.structs import replace

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.program import INT, Program, TypeRecord
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError
from lfield.replay.debugger.expressions import ValueUnknown, WatchExpression, WatchScope
from lfield.replay.debugger.moment import Moment
from lfield.replay.debugger.value_tree import ValueReader
from lfield.testing.golden import compile_text, run_text
from lfield.vm.inspection.block_view import view
from lfield.vm.inspection.traceback import stack
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.threads import threads
from lfield.vm.person_calls.value_conversion import EncodedValue, Mismatch, values_of

TEXT = """
enum Phase { SEARCH, LIFT, HOME }
class Step { public Phase phase; }
resource R {
    Phase now = Phase.LIFT;
    Phase[] all = {Phase.HOME, Phase.SEARCH};
    map<Phase, Phase> next = new map<Phase, Phase>();
    Step step = new Step();
    int number = 2;
    init(string[] arg) {
        Phase held = Phase.HOME;
        next[Phase.SEARCH] = Phase.LIFT;
        step.phase = held;
        while (true) yield();
    }
    portal given(Phase p, Phase[] more) emit Phase { return more[0]; }
}
"""


def running() -> tuple[Machine, Block]:
    _, machine = run_text(TEXT)
    return machine, machine.agents["r"].block


def test_a_decoded_block_shows_member_names() -> None:
    machine, block = running()
    frame_locals = view(block, machine.program)
    fields = dict(frame_locals.fields)
    assert fields["now"] == "LIFT"
    assert fields["all"].endswith("{HOME, SEARCH}")
    assert fields["next"].endswith("{SEARCH: LIFT}")
    assert fields["step"].endswith("{HOME}")
    assert fields["number"] == "2"
    assert ("held", "HOME") in frame_locals.threads[0].frames[0].locals


def test_a_number_without_a_member_is_shown_as_a_number() -> None:
    """The verifier of a block checks references, not the numbers of enums."""
    machine, block = running()
    block.w[block.w[layout.W_SELF] + 1] = 77
    assert dict(view(block, machine.program).fields)["now"] == "77"


def test_a_debugger_has_types_and_names() -> None:
    machine, block = running()
    reader = ValueReader(block, machine.program)
    record = machine.program.core.classes[machine.program.class_index["R"]]
    types = {field.name: field.type for field in record.fields}
    assert [reader.type_name(types[name]) for name in ("now", "all", "number")] == ["Phase", "Phase[]", "int"]
    assert reader.variable("now", types["now"], 2).value == "HOME"
    assert str(reader.plain((types["now"], 1))) == "LIFT"
    home, search = (reader.plain((types["now"], number)) for number in (2, 0))
    assert home > search  # type: ignore[operator]
    assert not home <= search  # type: ignore[operator]
    assert reader.plain((types["number"], 1)) == 1


def watch_scope() -> WatchScope:
    machine, block = running()
    moment = SimpleNamespace(table=SimpleNamespace(program=machine.program), agents=machine.agents)
    frames = [("r", stack(block, machine.program, place)[0].frame) for place in threads(block)]
    return WatchScope(cast(Moment, moment), frames)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("held == Phase.HOME", True),
        ("held == Phase.LIFT || now == Phase.LIFT", True),
        ("now < held && Phase.SEARCH < now", True),
        ("all[1] == Phase.SEARCH", True),
        ("number == 2", True),
    ],
)
def test_a_watch_expression_may_name_members(text: str, value: object) -> None:
    assert WatchExpression(text).value(watch_scope()) == value


def test_a_watch_expression_refuses_other_types() -> None:
    for text in ("held == 2", 'held == "HOME"'):
        with pytest.raises(ValueUnknown):
            WatchExpression(text).value(watch_scope())


def test_a_mission_test_gets_member_names() -> None:
    program = compile_text(TEXT)
    portal = next(method for method in program.core.methods if method.name == "given")
    kind, array = portal.slots[1], portal.slots[2]
    block = Block(bytearray(8 * 4096), 64, 4096)
    arguments = [
        EncodedValue(program, kind, "HOME").put(block),
        EncodedValue(program, array, ["LIFT"]).put(block),
    ]
    assert values_of(block, program, [kind, array], arguments) == ["HOME", ["LIFT"]]
    for wrong in ("Home", 1, None, True):
        with pytest.raises(Mismatch) as error:
            EncodedValue(program, kind, wrong)
        assert error.value.expected == "Phase"


def test_a_program_with_an_enum_is_encoded_and_listed() -> None:
    program = compile_text(TEXT)
    again = decode(encode(program))
    assert again.digest == program.digest
    listing = disassemble(again)
    assert "enum Phase\n    0  SEARCH\n    1  LIFT\n    2  HOME\n" in listing
    assert "portal R.given(Phase, Phase[]) Phase" in listing


def test_member_names_are_part_of_the_identity_of_a_program() -> None:
    assert compile_text(TEXT).digest != compile_text(TEXT.replace("LIFT", "RAISE")).digest


def test_an_unused_constant_or_function_does_not_change_a_program() -> None:
    text = "resource R { init(string[] arg) { } }"
    unused = "const int ONE = 1; int twice(int n) { return 2 * n; } "
    assert compile_text(text).digest == compile_text(unused + text).digest


def changed(program: Program, record: TypeRecord) -> Program:
    """The program with another record for the type of the enum."""
    types = tuple(record if one.kind == INT and one.of else one for one in program.core.types)
    return Program(replace(program.core, types=types), program.debug, program.digest)


def test_the_verifier_refuses_an_enum_without_members() -> None:
    program = compile_text(TEXT)
    verify(program)
    index = program.class_index
    for of in (0, 1, index["R"], index["Step"], len(program.core.classes), -1):
        with pytest.raises(ProgramFileError):
            verify(changed(program, TypeRecord(INT, of)))


def test_the_verifier_distinguishes_enums_from_other_values() -> None:
    program = compile_text(TEXT)
    kind = next(i for i, one in enumerate(program.core.types) if one.kind == INT and one.of)
    step = program.class_index["Step"]
    record = program.core.classes[step]
    for wrong in (1, 3, 4):  # boolean, real, string
        fields = tuple(replace(field, type=wrong) if field.type == kind else field for field in record.fields)
        classes = list(program.core.classes)
        classes[step] = replace(record, fields=fields)
        core = replace(program.core, classes=tuple(classes))
        with pytest.raises(ProgramFileError):
            verify(Program(core, program.debug, program.digest))
