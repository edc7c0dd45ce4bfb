"""Hosts fail, on virtual time: `lfield test examples/04-the-mission-survives`."""

from __future__ import annotations

import pytest


def call_count(team, portal):
    return sum(call.portal == portal for call in team.calls)


@pytest.mark.few(0)
def test_each_portal_is_called_once_per_step_without_failures(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.said("survivor: complete; the coordinator migrated 5 times")
    assert not team.said("caught at")
    assert [call_count(team, portal) for portal in ("flyTo", "driveTo", "reach", "moveTo")] == [2, 1, 2, 1]


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("line", "seconds", "host", "step"),
    [
        ("the scout is at (4, 2)", 0.8, "sky", 2),
        ("the truck is there", 1.5, "ground", 4),
        ("the hook is down", 0.3, "bench", 5),
    ],
)
def test_restart_of_a_host_raises_an_exception_and_the_step_is_repeated(
    lfield_mission, line, seconds, host, step
):
    team = lfield_mission("mission.dL")
    team.run(until=line)
    team.run(seconds)
    team.crash(host)
    team.run(1.0)
    team.boot(host)
    team.run(until_done=True)
    assert team.ended == {"survivor": "done"}
    assert team.said(f"survivor: caught at step {step}: ")
    assert team.said("survivor: complete") == 1


@pytest.mark.few(0)
def test_mission_completes_after_power_loss_of_all_computers(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="the truck is there")
    team.run(1.0)
    hosts = ("sky", "ground", "bench")
    for host in hosts:
        team.power_off(host)
    team.run(5.0)
    for host in hosts:
        team.boot(host)
    team.run(until_done=True)
    assert team.ended == {"survivor": "done"}
    assert team.said("survivor: complete") == 1


def test_another_host_continues_the_coordinator_of_a_lost_host(lfield_mission):
    team = lfield_mission("table.dL")
    # After two hops, the host of the other arm has a copy of the coordinator.
    team.run(until=lambda: len(team.hops) == 2)
    team.run(0.5)
    team.power_off(team.hops[-1].target)
    team.run(until="clearer recovered on this host")
    recovered = team.now
    team.run(until_done=True)
    assert team.said("caught at part")
    assert team.said("clearer: complete; 12 parts are in the box")
    assert recovered < 30.0
