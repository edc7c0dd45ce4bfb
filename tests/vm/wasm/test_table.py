"""The table of the instructions of the engine: every instruction is in one place of it, or leaves."""

from __future__ import annotations

from collections import Counter

from lfield.bytecode.opcodes import BY_NAME
from lfield.vm.wasm.lowering import control_flow_graph
from lfield.vm.wasm.lowering.instruction_table import CONTROL, GROUPED, ROWS

#: Instructions of the reference engine: they have effects outside, or are rare, or long.
_LEAVES = """
    pcall gather begin start fetch leave limit settle hold take drop find findall offers explain device
    write_int write_float write_str write_bool print_int print_float print_str print_bool
    yield sleep now lived random random_int heartbeat_interval agent host teams
    tick suppress control tick_failed
    launch next ended cancel failure wait_limit wait_leave wait_enter
    s2f f2s f2s_digits exc_message exc_type exc_source exc_others noreturn
    read_line seq_start seq_stop seq_end seq_alive
"""


def test_every_instruction_is_in_one_place() -> None:
    rows = {name.partition(" of ")[0] for name in ROWS}
    assert Counter([*rows, *CONTROL, *GROUPED, *_LEAVES.split()]) == Counter(BY_NAME.keys())


def test_instructions_with_external_effects_leave_the_engine() -> None:
    assert {name for name, opcode in BY_NAME.items() if opcode.leaves_engine} <= set(_LEAVES.split())


def test_every_end_of_a_run_is_known_to_the_control_flow_graph() -> None:
    ends = {name: getattr(control_flow_graph, end) for name, end in CONTROL.items()}
    assert all(end in control_flow_graph.BlockExit.__args__ for end in ends.values())
