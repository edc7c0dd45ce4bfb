"""A test whose double, action, condition or fake blocks ends, and says who has held it."""

from __future__ import annotations

import signal
import threading
import time

import pytest

from lfield.errors import Stuck
from lfield.testing.mission.team import Team

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal work() { }
}
coordinator Boss {
    init(string[] arg) { findPost("one").work(); while (true) sleep(1.0); }
}
"""


@pytest.fixture
def posted(tmp_path, lfield_mission, monkeypatch):
    """Makes a team with a double for its resource, and hardly any patience."""
    monkeypatch.setattr("lfield.testing.mission.team.PATIENCE", 0.5)

    def made(double: object = None) -> Team:
        (tmp_path / "post.L").write_text(PROGRAM)
        (tmp_path / "post.dL").write_text("//Post:one@alpha\n//Boss:boss@alpha\n")
        team: Team = lfield_mission(tmp_path / "post.dL", doubles={"one": double} if double else {})
        return team

    return made


class Blocks:
    def work(self) -> None:
        threading.Event().wait()


class Swallows:
    def work(self) -> None:
        try:
            time.sleep(1e6)
        except BaseException:
            return


@pytest.mark.parametrize("double", [Blocks(), Swallows()], ids=["blocks", "swallows"])
def test_a_double_that_blocks_is_interrupted_and_named(posted, double):
    team = posted(double)
    with pytest.raises(Stuck, match=r"at 0\.\d+ s of the mission the test has run for 0.5 s") as stuck:
        team.run(10.0)
    assert f"held by {type(double).__name__}.work (test_mission_patience.py:" in str(stuck.value)


def nap() -> None:
    time.sleep(1e6)


def test_an_action_that_takes_too_long_is_the_one_that_is_named(posted):
    team = posted()
    team.at(3.0, lambda: nap())
    with pytest.raises(Stuck, match=r"at 3.000 s .*held by nap \(test_mission_patience.py:\d+\)"):
        team.run(10.0)


def test_so_is_a_condition_and_what_runs_in_a_thread(posted):
    with pytest.raises(Stuck, match=r"held by .*<lambda> \(test_mission_patience"):
        posted().run(until=lambda: threading.Lock().acquire() and threading.Event().wait())
    team = posted()
    (life,) = team._fleet.lives.values()
    team.at(1.0, lambda: life.process.loop.enter(lambda: life.process.loop.run_in_executor(None, nap)))
    with pytest.raises(Stuck, match=r"at 1.002 s .*held by nap"):
        team.run(10.0)


def test_who_is_only_slow_has_no_culprit(posted):
    team = posted()
    with pytest.raises(Stuck, match=r"s of the mission the test has run for 0.5 s of real time\n"):
        team.run(until_done=True, at_most=1e9)


def test_an_alarm_of_somebody_else_is_there_again_and_rings_first_where_it_is_sooner(posted, monkeypatch):
    rung = []
    before = signal.signal(signal.SIGALRM, lambda *_: rung.append(time.monotonic()))
    left, _ = signal.setitimer(signal.ITIMER_REAL, 30.0)
    try:
        posted().run(1.0)
        assert 25.0 < signal.getitimer(signal.ITIMER_REAL)[0] < 30.0
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        posted(type("Short", (), {"work": lambda self: time.sleep(0.3)})()).run(1.0)
        assert len(rung) == 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if left:
            signal.setitimer(signal.ITIMER_REAL, left)
