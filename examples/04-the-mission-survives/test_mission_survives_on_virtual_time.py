"""Computers die on virtual time: `lfield test examples/04-the-mission-survives`."""

from __future__ import annotations

import pytest


def acts(team, portal):
    """The started calls of a portal."""
    return [call for call in team.calls if call.portal == portal]


@pytest.mark.few(0)
def test_every_part_is_executed_once_without_failures(lfield_mission):
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
def test_failed_host_costs_one_call_and_the_program_is_informed(lfield_mission, said, later, host, step):
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


def test_majority_continues_when_the_coordinators_host_is_lost(lfield_mission):
    team = lfield_mission("table.dL")
    # The coordinator has visited the other arm, where its copy is.
    team.run(until=lambda: len(team.hops) == 2)
    team.run(0.5)
    team.power_off(team.hops[-1].target)
    team.run(until="clearer recovered on this host")
    recovered = team.now
    team.run(until_done=True)
    assert team.said("told at part")
    assert team.said("clearer: complete; 12 parts are in the box")
    assert recovered < 30.0
