"""Futures in the debugger: variables, steps over calls that wait; the library in L has no steps."""

from __future__ import annotations

import pytest

from lfield.cli.debugging.command_line import DebuggerCommands
from lfield.errors import UsageError
from lfield.replay.debugger.debugger import Breakpoint, Debugger
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.testing.recorded_run import record_mission

PROGRAM = """
resource Arm {
    init(string[] arg) { }
    portal lift(real metres) emit real { sleep(metres); return metres; }
    portal fail() { throw new Exception("broken"); }
}
coordinator Boss {
    private boolean enough(real metres) {
        return metres > 0.5;
    }
    init(string[] arg) {
        future<void> bad = async findArm("left").fail();
        future<real>[] lifts = {async findArm("left").lift(0.8)};
        lifts.append(async findArm("right").lift(0.4));
        int first = lifts.race(enough);
        real high = lifts[first].await();
        try { bad.await(5.0); } catch (Exception e) {
            print(e.message());
        }
    }
}
"""
ENOUGH, LIFTS, APPEND, RACE, AWAIT, TRY, CAUGHT, END = 9, 13, 14, 15, 16, 17, 18, 20


@pytest.fixture(scope="module")
def lifting(tmp_path_factory: pytest.TempPathFactory) -> TeamTimeline:
    folder = tmp_path_factory.mktemp("mission")
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//Arm:left@alpha\n//Arm:right@bravo\n//Boss:boss@desk\n")
    return TeamTimeline(*record_mission(folder / "mission.dL", 20.0))


def printed(debugger: Debugger, expression: str) -> list[str]:
    return DebuggerCommands(debugger).execute(f"print {expression}")


def lines(debugger: Debugger, move) -> list[int]:
    """The lines of the coordinator at which a move stops."""
    found = []
    while move(debugger):
        found.append(debugger.stack()[0].line.line)
    return found


def test_a_future_shows_its_call_and_its_result(lifting):
    debugger = Debugger(lifting)
    debugger.add_breakpoint(Breakpoint("mission.L", RACE))
    assert debugger.resume()
    (lifts,) = (v for v in debugger.variables(debugger.stack()[0]) if v.name == "lifts")
    frame = debugger.stack()[0]
    futures = debugger.parts(frame, lifts)
    assert [v.type for v in futures] == ["future<real>", "future<real>"]
    calls = [debugger.parts(frame, v)[0] for v in futures]
    assert [(v.value, v.has_parts) for v in calls] == [
        ("left.lift() started", False),
        ("right.lift() started", False),
    ]
    assert printed(debugger, "bad == null") == ["bad == null = false"]
    assert printed(debugger, "lifts.length() == 2") == ["lifts.length() == 2 = true"]
    assert debugger.step_over()
    output = "".join(printed(debugger, "lifts"))
    assert "left.lift() returned" in output
    assert "right.lift() returned" in output


@pytest.mark.few(0)
def test_steps_stop_in_the_program_and_not_in_the_library(lifting):
    debugger = Debugger(lifting)
    debugger.enter()
    assert lines(debugger, Debugger.step_over) == [LIFTS, APPEND, RACE, AWAIT, TRY, CAUGHT, END]
    debugger.go_to(debugger.team.start)
    debugger.enter()
    stops = lines(debugger, Debugger.step_line)
    assert ENOUGH in stops
    assert all(line <= END for line in stops)
    debugger.go_to(debugger.team.start)
    debugger.add_breakpoint(Breakpoint("mission.L", ENOUGH))
    assert debugger.resume()
    # The frame of the library between the two is not shown.
    assert [(f.method, f.line.line) for f in debugger.stack()] == [
        ("Boss.enough", ENOUGH),
        ("Boss.init", RACE),
    ]
    assert debugger.step_out()
    assert debugger.stack()[0].line.line == AWAIT
    assert debugger.step_over(backward=True)
    assert debugger.stack()[0].line.line == RACE


@pytest.mark.parametrize(
    "text", ["bad.done()", "lifts[0].await() > 0.5", "!enough(1.0)", "lifts.length(1) == 2"]
)
def test_a_condition_that_calls_a_method_is_refused(lifting, text):
    """Only the program calls methods, so such a condition would never hold."""
    with pytest.raises(UsageError):
        Debugger(lifting).condition(text)
