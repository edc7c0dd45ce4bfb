"""Computers die on virtual time: `lfield test examples/04-the-mission-survives`."""

from __future__ import annotations

import pytest


def acts(team, portal):
    """The calls of a portal that have started."""
    return [call for call in team.calls if call.portal == portal]


@pytest.mark.few(0)
def test_without_failures_every_part_is_made_once(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.said("survivor: complete; the coordinator migrated 5 times")
    assert not team.said("told at")
    assert [len(acts(team, portal)) for portal in ("flyTo", "driveTo", "reach", "moveTo")] == [2, 1, 2, 1]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("said", "later", "host", "step"),
    [
        ("the scout is at (4, 2)", 0.8, "sky", 2),
        ("the truck is there", 1.5, "ground", 4),
        ("the hook is down", 0.3, "bench", 5),
    ],
)
def test_a_host_that_dies_in_a_call_costs_that_call_and_the_program_is_told(
    lfield_mission, said, later, host, step
):
    team = lfield_mission("mission.dL")
    team.run(until=said)
    team.run(later)
    team.crash(host)
    team.run(1.0)
    team.boot(host)
    team.run(until_done=True)
    assert team.ended == {"survivor": "done"}
    assert team.said(f"survivor: told at step {step}: ")
    assert team.said("survivor: complete") == 1


@pytest.mark.few(0)
def test_all_three_computers_lose_their_power_at_once(lfield_mission):
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


def test_a_majority_goes_on_when_the_host_of_the_coordinator_never_comes_back(lfield_mission):
    team = lfield_mission("table.dL")
    # It has been at the other arm, where its shadow is.
    team.run(until=lambda: len(team.hops) == 2)
    team.run(0.5)
    team.power_off(team.hops[-1].target)
    team.run(until="clearer recovered on this host")
    recovered = team.now
    team.run(until_done=True)
    assert team.said("told at part")
    assert team.said("clearer: complete; 12 parts are in the box")
    assert recovered < 30.0
