"""An invalid request of a test to a team is one sentence; so is a failure of foreign code."""

from __future__ import annotations

import asyncio
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

import lfield_sim.mavlink
from lfield import exit_status
from lfield.errors import MissionTestError
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.script import run_script

FLIGHT = Path(__file__).parents[2] / "examples" / "01-first-flight" / "mission.dL"
PUMPS = """
resource Pump {
    init(string[] arg) { }
    portal flow(int litres) emit int { return litres; }
}
coordinator Boss {
    init(string[] arg) { print("got " + i2s(findPump("pump").flow(3))); sleep(60.0); }
}
"""


@pytest.fixture
def pumps(tmp_path):
    """Makes a team of a pump, and of a boss that calls it once."""
    (tmp_path / "pumps.L").write_text(PUMPS)
    (tmp_path / "pumps.dL").write_text("//Pump:pump@alpha\n//Boss:boss@bravo\n")
    teams = []

    def made(**options: object) -> MissionTeam:
        teams.append(MissionTeam(tmp_path / "pumps.dL", **options))
        return teams[-1]

    yield made
    for team in teams:
        team.close()


@pytest.mark.few(8)
@pytest.mark.parametrize(
    ("ask", "told"),
    [
        (lambda team: team.run(-1), "run(...): -1 is not a time; give seconds of at least 0"),
        (lambda team: team.run(math.nan), "run(...): nan is not a time"),
        (lambda team: team.run(math.inf), "run(...): inf is not a time"),
        (lambda team: team.run("1"), "run(...): '1' is not a time"),
        (lambda team: team.run(), "run() takes one of these: seconds, until=..., until_done=True"),
        (lambda team: team.run(until=None), "run() takes one of these"),
        (lambda team: team.run(1.0, until_done=True), "run() takes one of these"),
        (lambda team: team.run(until=""), "run(until=''): give text of a log line"),
        (lambda team: team.run(until=5), "run(until=5): give text of a log line"),
        (lambda team: team.run(until_done=True, at_most=math.nan), "run(at_most=...): nan is not a time"),
        (lambda team: team.at(math.nan, print), "at(nan, ...): nan is not a time"),
        (lambda team: team.when(10, print), "when(10, ...): write a line as mission.L:42"),
        (lambda team: team.when(None, print), "when(None, ...): write a line as mission.L:42"),
        (lambda team: team.cut(["alpha"], "bravo"), "there is no host ['alpha']; there are: alpha, bravo"),
        (lambda team: team.at(-1, print), "at(-1, ...): -1 is not a time"),
        (lambda team: team.at(1.0, "crash"), "at(1.0, ...): 'crash' is not a function; give one"),
        (lambda team: team.when("pumps.L:7", None), "when('pumps.L:7', ...): None is not a function"),
        (lambda team: team.cut("alpha", "alpha"), "alpha is given twice"),
        (lambda team: team.stop("nobody"), "there is no host 'nobody'; there are: alpha, bravo"),
    ],
)
def test_an_invalid_request_to_a_team_is_reported(pumps, ask, told):
    team = pumps()
    with pytest.raises(MissionTestError) as error:
        ask(team)
    assert str(error.value).startswith(told)
    team.run(until="got 3")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seed": None}, "seed=None: give an integer"),
        ({"seed": 1.5}, "seed=1.5: give an integer"),
        ({"doubles": "x"}, "doubles='x': give a dict, as in doubles={\"pump\": Pump()}"),
        ({"doubles": None}, "doubles=None: give a dict"),
        ({"doubles": {"pump": None}}, "the double of pump is None: give an object with its portals"),
        ({"fakes": "battery=0.3"}, "fakes='battery=0.3': give a dict, as in fakes={"),
        ({"fakes": None}, "fakes=None: give a dict"),
        ({"fakes": {"pump.m": "battery=0.3"}}, "fakes: the faults of pump.m are 'battery=0.3'; give a list"),
        ({"fakes": {"pump.m": [5]}}, "fakes: the faults of pump.m are [5]; give a list of texts"),
    ],
)
def test_a_team_that_cannot_be_made_is_reported(pumps, options, told):
    with pytest.raises(MissionTestError) as error:
        pumps(**options)
    assert str(error.value).startswith(told)


def test_a_fault_must_be_a_text(lfield_mission):
    team = lfield_mission(FLIGHT)
    for faults in ((5,), (), (["battery=0.2"],)):
        with pytest.raises(MissionTestError, match=r"lead\.fc: set\(\.\.\.\): give faults as texts"):
            team.fake("lead.fc").set(*faults)


def test_no_fault_is_set_in_a_closed_team(lfield_mission):
    team = lfield_mission(FLIGHT)
    device = team.fake("lead.fc")
    team.close()
    with pytest.raises(MissionTestError, match="this team is closed"):
        device.set("battery=0.2")


def test_a_host_that_has_ended_can_be_killed_and_stopped(pumps):
    team = pumps()
    team.crash("alpha")
    team.crash("alpha")
    team.stop("alpha")
    team.stop()
    team.power_off("alpha")
    team.run(1.0)
    assert [mark.text for mark in team.marks] == ["alpha is killed", "alpha is switched off"]


@pytest.mark.parametrize(
    "ask",
    [
        lambda team: team.run(1.0),
        lambda team: team.at(99.0, print),
        lambda team: team.when("pumps.L:6", print),
        lambda team: team.fake("pump.m"),
        lambda team: team.cut("alpha", "bravo"),
        lambda team: team.heal("alpha", "bravo"),
        lambda team: team.crash("alpha"),
        lambda team: team.power_off("alpha"),
        lambda team: team.boot("alpha"),
        lambda team: team.stop(),
        lambda team: team.pause(),
        lambda team: team.resume(),
    ],
)
def test_a_closed_team_refuses_every_request(pumps, ask):
    team = pumps()
    team.close()
    with pytest.raises(MissionTestError, match=r"^this team is closed; only its recorded data is available"):
        ask(team)
    assert not team._fleet.runs


def test_recorded_data_is_available_after_the_team_is_closed(pumps):
    team = pumps()
    team.run(70.0)
    team.close()
    team.close()
    assert team.ended == {"boss": "done"}
    assert (team.said("got 3"), len(team.calls), team.now) == (1, 1, 70.0)
    assert len(team.hops) == 1


@pytest.mark.parametrize("ways", ["double", "at", "until"])
def test_a_team_cannot_be_run_within_a_run(pumps, ways):
    def again(litres: int = 0) -> int:
        team.run(1.0)
        return litres

    team = pumps(doubles={"pump": SimpleNamespace(flow=again)} if ways == "double" else {})
    if ways == "at":
        team.at(0.0, again)
    with pytest.raises(
        MissionTestError, match="the team is running already: a double, an action or a condition"
    ):
        team.run(until=again if ways == "until" else "got 3")


def test_a_mock_is_a_valid_double(pumps):
    pump = Mock(spec=["flow"])
    pump.flow.return_value = 8
    pumps(doubles={"pump": pump}).run(until="got 8")
    pump.flow.assert_called_once_with(3)
    with pytest.raises(MissionTestError, match="has a method flwo, but Pump has no such portal"):
        pumps(doubles={"pump": Mock(spec=["flwo"])})


def test_a_call_of_sys_exit_fails_the_test_with_a_sentence(pumps, lfield_mission, monkeypatch):
    team = pumps()
    team.at(0.1, lambda: sys.exit(3))
    with pytest.raises(MissionTestError, match=r"called sys.exit\(3\)"):
        team.run(1.0)

    async def leaves(driver: object) -> None:
        sys.exit("no licence")

    monkeypatch.setattr("lfield_mavlink.driver.MavlinkDriver._open", leaves)
    with pytest.raises(MissionTestError, match=r"called sys.exit\('no licence'\)"):
        lfield_mission(FLIGHT).run(5.0)


@pytest.mark.parametrize("early", [True, False])
@pytest.mark.parametrize("cause", [RuntimeError("no water"), ValueError("no water")])
def test_a_failing_fake_is_named(lfield_mission, monkeypatch, cause, early):
    kind = type(lfield_sim.mavlink.SIM)
    serve = kind.serve

    async def fails(sim: object, args: object) -> None:
        async with asyncio.TaskGroup() as tasks:
            serving = tasks.create_task(serve(sim, args))
            await asyncio.sleep(0.0 if early else 2.0)
            serving.cancel()
        raise cause

    monkeypatch.setattr(kind, "serve", fails)
    with pytest.raises(
        (MissionTestError, pytest.fail.Exception), match=r"(lead|wing)\.fc.*: no water"
    ) as error:
        lfield_mission(FLIGHT).run(5.0)
    assert early or error.value.__cause__ is cause


@pytest.mark.parametrize(
    ("name", "status", "message"),
    [("mission.dL", exit_status.DATA, "error[L603]"), ("absent.dL", exit_status.NO_INPUT, "absent.dL")],
)
def test_an_error_of_a_script_is_a_message_and_an_exit_status(tmp_path, capsys, name, status, message):
    (tmp_path / "mission.L").write_text("include <absent/rover.L>;")
    (tmp_path / "mission.dL").write_text("//Rover:rover@alpha\n")
    with pytest.raises(SystemExit) as ended:
        run_script(lambda: MissionTeam(tmp_path / name).close())
    assert ended.value.code == status
    assert message in capsys.readouterr().err
