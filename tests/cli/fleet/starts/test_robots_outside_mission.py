"""An inventory with more robots than the mission: only the hosts of the deployment count."""

from __future__ import annotations

import signal

import pytest
from robots import TEAM, program, told

pytestmark = pytest.mark.process


@pytest.mark.few(0)
def test_a_robot_outside_the_mission_is_ignored_by_start_status_and_rollback(lfield, here, robots) -> None:
    team = robots("alpha", "bravo", "carol")
    team.up()
    team.mission()
    first = told(here("push", "mission.dL", "--json"))
    assert first["outcome"] == "activated"
    assert not any("differ" in line for line in here("status").out)

    started = here("start", "--json")
    assert (started.status, told(started)["started"]) == (0, True)
    assert told(here("status", "--json"))["carol"]["run"]["phase"] == "stopped"
    here("stop", "--discard", status=0)
    # Its omission makes no difference.
    started = here("start", "--without", "carol", "--json")
    assert (started.status, told(started)["started"]) == (0, True)
    here("stop", "--discard", status=0)

    team.mission(text="call")
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    back = told(here("rollback", "--json"))
    assert (back["outcome"], back["bundle"]) == ("activated", first["bundle"])

    # Its absence makes no difference either.
    team.kill("carol")
    here("start", status=0)
    here("stop", "--without", "carol", "--discard", status=0)
    assert told(here("rollback", "--json"))["outcome"] == "activated"


@pytest.mark.few(0)
def test_start_asks_for_robots_or_mission_if_a_local_mission_runs_too(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    here("push", "mission.dL", status=0)
    other = lfield.mission(program(rounds=1000, pause=1.0), TEAM, name="other")
    running = lfield.start("up", "--deploy", other, "--all", "--sim")
    running.wait_for("visit 1")
    # Both have hosts of these names.
    refused = here("start", status=64)
    assert str(team.inventory) in refused.err[0]
    here("start", "other.dL", status=0)
    started = here("start", "--inventory", team.inventory, "--json")
    assert (started.status, told(started)["started"]) == (0, True)
    running.signal(signal.SIGINT)
    running.wait()
