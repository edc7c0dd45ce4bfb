"""The report of a deep recursion has both ends of its stack."""

import random

import pytest

from lfield.cli.views.journal_view import thread_lines
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_text, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.inspection.traceback import split_ends
from lfield.vm.machine import Machine

FALLS = """
resource Well {
    init(string[] arg) { while (true) yield(); }
    portal drop(int depth) { fall(depth); }
    private void fall(int n) {
        if (n == 0) throw new Exception("the ground");
        fall(n - 1);
    }
}
coordinator Boss { init(string[] arg) { findWell("well").drop(%d); } }
"""


def test_the_report_of_a_deep_recursion_has_both_ends() -> None:
    desk, _ = run_text(FALLS % 900)
    (boss,) = desk.endings
    lines = [line.strip() for line in boss.report.splitlines()]
    assert lines[0] == "Exception: the ground"
    assert lines[1:3] == ["at Well.fall (golden.L:6) in well", "at Well.fall (golden.L:7) in well"]
    assert lines[11] == "... 886 more calls ... in well"
    assert lines[-3:] == [
        "at Well.fall (golden.L:7) in well",
        "at Well.drop (golden.L:4) in well",
        "at Boss.init (golden.L:10)",
    ]
    assert len(lines) == 19


def test_a_stack_that_is_not_deep_is_complete() -> None:
    desk, _ = run_text(FALLS % 14)
    assert desk.endings[0].report.count("at Well.fall") == 15


def test_an_inspected_stack_has_both_ends() -> None:
    program = compile_text(
        "resource A { init(string[] a) { fall(0); } private void fall(int n) { fall(n + 1); } }"
    )
    machine = Machine(
        program, MachineTeam(team_for(program, []), 0, 1), GoldenWorld(), ManualClock(), random.Random(1)
    )
    agent = machine.start(machine.team[0], AgentLimits(), generation=1)
    run_until_idle(machine, ManualClock())
    (thread,) = view(agent.block, program).threads
    lines = list(thread_lines(thread))
    assert (len(thread.frames), len(lines)) == (1000, 1 + 16 * 3 + 1)
    assert lines[31] == "  ... 984 more calls ..."


@pytest.mark.parametrize(("count", "between"), [(0, 0), (16, 0), (17, 0), (18, 2), (1000, 984)])
def test_a_single_frame_is_never_left_out(count: int, between: int) -> None:
    inner, left_out, outer = split_ends(range(count))
    assert left_out == between
    assert [*inner, *outer] == [i for i in range(count) if i < 10 or i >= count - 6 or not between]
