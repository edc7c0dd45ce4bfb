"""A test whose double, action, condition or fake blocks ends, and names the blocking code."""

from __future__ import annotations

import signal
import threading
import time

import pytest

from lfield.errors import Stuck
from lfield.testing.mission.mission_team import MissionTeam

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
    """Makes a team with a double for its resource, and a time limit (s) after its creation."""

    def made(double: object = None, making: float = 120.0, patience: float = 0.5) -> MissionTeam:
        monkeypatch.setattr("lfield.testing.mission.mission_team.PATIENCE", making)
        (tmp_path / "post.L").write_text(PROGRAM)
        (tmp_path / "post.dL").write_text("//Post:one@alpha\n//Boss:boss@alpha\n")
        team: MissionTeam = lfield_mission(tmp_path / "post.dL", doubles={"one": double} if double else {})
        monkeypatch.setattr("lfield.testing.mission.mission_team.PATIENCE", patience)
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
def test_a_blocking_double_is_interrupted_and_named(posted, double):
    team = posted(double)
    with pytest.raises(Stuck, match=r"at 0\.\d+ s of the mission time has not advanced for 0.5 s") as stuck:
        team.run(10.0)
    assert f"held by {type(double).__name__}.work (test_mission_patience.py:" in str(stuck.value)


def nap() -> None:
    time.sleep(1e6)


def test_a_slow_action_is_named(posted):
    team = posted()
    team.at(3.0, lambda: nap())
    with pytest.raises(Stuck, match=r"at 3.000 s .*held by nap \(test_mission_patience.py:\d+\)"):
        team.run(10.0)


def test_a_slow_condition_or_thread_is_named(posted):
    with pytest.raises(Stuck, match=r"held by .*<lambda> \(test_mission_patience"):
        posted().run(until=lambda: threading.Lock().acquire() and threading.Event().wait())
    team = posted()
    (life,) = team._fleet.runs.values()
    team.at(1.0, lambda: life.process.loop.enter(lambda: life.process.loop.run_in_executor(None, nap)))
    with pytest.raises(Stuck, match=r"at 1.002 s .*held by nap"):
        team.run(10.0)


def test_a_busy_loop_at_one_instant_is_interrupted(posted):
    team = posted()

    def again() -> None:
        team.at(team.now, again)

    team.at(2.0, again)
    with pytest.raises(
        Stuck, match=r"at 2.000 s of the mission time has not advanced for 0.5 s of real time"
    ):
        team.run(10.0)


def test_slow_code_that_advances_is_not_interrupted(posted):
    team, started = posted(patience=1.0), time.monotonic()
    for moment in range(1, 9):
        team.at(moment, lambda: time.sleep(0.15))
    team.run(10.0)
    assert time.monotonic() - started > 1.0


def test_the_creation_of_a_team_has_a_time_limit(posted):
    class Shy:
        @property
        def live_attributes(self) -> dict[str, object]:
            time.sleep(1e6)
            return {}

    with pytest.raises(
        pytest.fail.Exception, match=r"before the mission has started time .*Shy\.live_attributes"
    ):
        posted(Shy(), making=2.0)


def test_an_alarm_of_another_owner_is_restored_and_fires_in_time(posted, monkeypatch):
    rung = []
    before = signal.signal(signal.SIGALRM, lambda *_: rung.append(time.monotonic()))
    left, _ = signal.setitimer(signal.ITIMER_REAL, 230.0)
    try:
        posted(patience=2.0).run(1.0)
        assert 100.0 < signal.getitimer(signal.ITIMER_REAL)[0] < 230.0
        team = posted(type("Short", (), {"work": lambda self: time.sleep(0.3)})(), patience=2.0)
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        team.run(1.0)
        assert len(rung) == 1
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
        # It also fires where it is later than the check interval, and where time advances.
        signal.setitimer(signal.ITIMER_REAL, 0.7)
        for moment in range(2, 10):
            team.at(moment, lambda: time.sleep(0.15))
        team.run(10.0)
        assert len(rung) == 2
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if left:
            signal.setitimer(signal.ITIMER_REAL, left)
