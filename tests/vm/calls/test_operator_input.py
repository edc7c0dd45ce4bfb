"""`read`: which thread gets a line, which lines are kept, and the end of a wait."""

from __future__ import annotations

import planted_read_bugs as bugs
import pytest
from joined_hosts import JoinedHosts

from lfield.testing.golden import compile_text
from lfield.vm.agent import TeamMember
from lfield.vm.waits.operator_input import MAX_KEPT, MAX_LINE, NO_READER, TOO_MANY, OperatorInput

PROGRAM = """
resource Desk {
    init(string[] arg) {
        if (arg.length() == 1) return;
        write("first: ");
        write(read(60.0) + "\\n");
    }
    portal ask(string who, real limit) emit string {
        try {
            return who + ": " + read(limit);
        } catch (CancelledException e) {
            write(who + " is cancelled\\n");
            sleep(0.5);
            throw e;
        }
    }
}
coordinator Asker {
    init(string[] arg) {
        try {
            within (s2f(arg[2])) { print(findDesk("desk").ask(arg[0], s2f(arg[1]))); }
        } catch (TimeLimitException e) {
            print(e.message());
        }
    }
}
"""


class Desk:
    """A host with a desk, and a coordinator for each (limit, time limit)."""

    def __init__(self, *askers: tuple[float, float], reads: tuple[str, ...] = ()) -> None:
        program = compile_text(PROGRAM)
        team = [TeamMember(0, "desk", "Desk", "resource", 0, reads)]
        for number, limits in enumerate(askers, 1):
            words = tuple(map(str, limits))
            team.append(TeamMember(number, f"a{number}", "Asker", "coordinator", 0, words))
        self.hosts = JoinedHosts(program, team)
        self.world, self.machine = self.hosts.places[0], self.hosts.places[0].machine
        self.beginning = self.run()

    @property
    def given(self) -> OperatorInput:
        return self.machine.operator_input

    def run(self, seconds: float = 0.0) -> list[str]:
        self.hosts.clock.advance(seconds)
        while self.machine.run() == 0:
            pass
        output, self.world.output[:] = list(self.world.output), []
        return output


def test_the_thread_that_has_waited_longest_gets_the_next_line() -> None:
    desk = Desk((10.0, 60.0), (10.0, 60.0))
    assert desk.given.waiting_agents == ["desk"]
    assert [desk.given.enter(text, is_kept=False) for text in ("yes", "no")] == ["", ""]
    assert desk.run() == ["a1: yes", "a2: no"]
    assert desk.given.waiting_agents == []


def test_a_line_for_an_agent_goes_to_no_other_one() -> None:
    desk = Desk((10.0, 60.0))
    assert desk.given.enter("yes", is_kept=False, agent="other") == NO_READER.format(agent="other")
    assert desk.given.enter("no", is_kept=False, agent="desk") == ""
    assert desk.run() == ["a1: no"]


def test_a_limited_number_of_lines_is_kept_without_a_reader() -> None:
    desk = Desk()
    assert desk.given.enter("from the page", is_kept=False, agent="desk") == NO_READER.format(agent="desk")
    assert {desk.given.enter(str(n), is_kept=True) for n in range(MAX_KEPT)} == {""}
    assert desk.given.enter("more", is_kept=True) == TOO_MANY


def test_a_long_line_is_cut() -> None:
    desk = Desk((10.0, 60.0))
    desk.given.enter("x" * (MAX_LINE + 1), is_kept=True)
    assert desk.run() == ["a1: " + "x" * MAX_LINE]


def test_the_limit_of_the_caller_cancels_a_wait_and_the_line_goes_to_the_next() -> None:
    desk = Desk((10.0, 1.0), (10.0, 60.0))
    output = desk.run(1.1)
    assert "a1 is cancelled" in output
    desk.given.enter("late", is_kept=False)
    assert desk.run() == ["a2: late"]


def test_each_thread_has_its_own_limit() -> None:
    desk = Desk((2.0, 60.0), (1.0, 60.0))
    assert [line.partition(":")[0] for line in desk.run(1.1)] == ["no line was entered at desk within 1 s"]
    assert [line.partition(":")[0] for line in desk.run(1.0)] == ["no line was entered at desk within 2 s"]
    assert desk.given.enter("late", is_kept=False, agent="desk") == NO_READER.format(agent="desk")


def test_a_read_in_init_is_a_pause_and_ends_the_line_of_its_question() -> None:
    desk = Desk((10.0, 60.0), reads=("init",))
    assert [desk.given.enter(text, is_kept=False) for text in ("one", "two")] == ["", ""]
    assert desk.beginning == ["first: "]
    assert desk.run() == ["one", "a1: two"]


SCENARIOS = [scenario for name, scenario in globals().items() if name.startswith("test_")]


def all_scenarios() -> None:
    for scenario in SCENARIOS:
        scenario()


@pytest.mark.parametrize("bug", bugs.READ_BUGS)
def test_a_planted_read_bug_is_found(bug: bugs.ReadBug, monkeypatch: pytest.MonkeyPatch) -> None:
    bug(monkeypatch)
    with pytest.raises(AssertionError):
        all_scenarios()
