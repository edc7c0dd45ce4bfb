"""The commands of the terminal, and its windows."""

from __future__ import annotations

import signal

import pytest

from lfield.cli.debugging import search_watch
from lfield.cli.debugging.command_line import DebuggerCommands
from lfield.cli.debugging.search_watch import interruptible
from lfield.errors import UsageError
from lfield.replay.debugger import host_timeline
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.host_timeline import SearchCancelled
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.testing.recorded_run import record_mission


@pytest.fixture
def commands(debugger) -> DebuggerCommands:
    debugger.step()
    return DebuggerCommands(debugger)


def _run(commands: DebuggerCommands, *texts: str) -> list[str]:
    lines: list[str] = []
    for text in texts:
        lines = commands.execute(text)
    return lines


def test_a_session_moves_in_both_directions(commands):
    _run(commands, "break mission.L:87 if leg == 1", "continue")
    assert "int leg = 1" in _run(commands, "vars")
    assert "real step = 4.0" in _run(commands, "print step")
    assert "mission.L:88" in _run(commands, "next")[0]
    assert "mission.L:87" in _run(commands, "back next")[0]
    assert _run(commands, "n") == _run(commands, "rs", "step")
    assert _run(commands, "continue back") == _run(commands, "time 0", "c")
    assert _run(commands, "breakpoints") == ["1  mission.L:87 if leg == 1"]
    assert _run(commands, "delete 1") == []


def test_threads_and_frames_are_selected(commands):
    _run(commands, "portal")
    assert len(_run(commands, "threads")) >= 1
    assert "pilot" in _run(commands, "thread pilot")[0]
    assert _run(commands, "stack")[0].startswith("> 0")
    assert any("fc.battery" in line for line in _run(commands, "end", "readings"))


def test_an_object_is_printed_with_its_parts(commands):
    _run(commands, "break mission.L:87", "c")
    lines = _run(commands, "print first")
    assert lines[1:3] == ['  string who = "lead"', lines[2]]
    assert _run(commands, "print nothing")[0].startswith("no value")


def test_quit_ends_the_session(commands):
    _run(commands, "quit")
    assert commands.is_done


@pytest.mark.parametrize(
    "text",
    [
        "dance", "time never", "break x.L:1", "break mission.L:9999", "break ?", "delete 1", "frame 77",
        "thread nobody", "until", "change", "print", "until leg =", "back vars", "back start",
        "break mission.L:89 if nosuch == 1", "break mission.L:89 if 5",
    ],
)  # fmt: skip
def test_a_mistake_is_reported_and_moves_nothing(commands, text):
    place = commands.debugger.place
    with pytest.raises(UsageError):
        commands.execute(text)
    assert commands.debugger.place == place


def test_the_error_for_a_command_without_a_way_back_says_so(commands):
    with pytest.raises(UsageError) as refused:
        commands.execute("back start")
    assert "does not go backward" in str(refused.value)


def test_every_view_prints_lines(commands):
    _run(commands, "portal")
    for text in ("where", "list", "list 2", "effects", "events", "help", "vars", "stack", "", "hop pilot"):
        assert isinstance(commands.execute(text), list)


def test_the_windows_show_the_position(commands):
    pytest.importorskip("prompt_toolkit")
    from prompt_toolkit.output import DummyOutput

    from lfield.cli.debugging.debug_screen import DebugScreen

    screen = DebugScreen(commands, DummyOutput())
    screen.execute("break mission.L:87")
    screen.execute("continue")
    assert next(line for line in screen.lines("source") if line.startswith(">")).split()[1] == "87"
    assert any(line.startswith("int leg") for line in screen.lines("variables"))
    screen.execute("dance")
    assert "dance" in screen.lines("output")[-1]


def test_an_interrupt_ends_a_search_but_not_the_debugger(debugger, monkeypatch):
    monkeypatch.setattr(host_timeline, "REPORT_EVERY", 0.0)
    monkeypatch.setattr(search_watch, "SHOWN_AFTER", 0.0)
    debugger.enter()
    place, displayed = debugger.place, []
    target = debugger.condition_target("1 == 2")
    with interruptible(debugger.team, displayed.append):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(SearchCancelled):
            debugger.search(target)
    assert debugger.place == place
    with interruptible(debugger.team, displayed.append):
        assert not debugger.search(debugger.condition_target("1 == 2"))
    assert any("searching" in text for text in displayed)
    assert displayed[-1] == ""
    assert debugger.search(debugger.portal_target())


LOOPS = """
resource Post {
    int ticks;
    init(string[] arg) { }
    loop blink at 2.0 {
        ticks += 1;
        emitted(ticks);
    }
    private void emitted(int n) { print(i2s(n)); }
}
coordinator Boss { init(string[] arg) { sleep(3.0); } }
"""


def test_the_fields_of_loops_are_not_shown(tmp_path):
    (tmp_path / "mission.L").write_text(LOOPS)
    (tmp_path / "mission.dL").write_text("//Post:post@alpha\n//Boss:boss@alpha\n")
    commands = DebuggerCommands(Debugger(TeamTimeline(*record_mission(tmp_path / "mission.dL", 10.0))))
    _run(commands, "break mission.L:7", "c")
    assert any(line.endswith("{1}") for line in _run(commands, "vars"))
    assert _run(commands, "print this")[1:] == ["  int ticks = 1"]
