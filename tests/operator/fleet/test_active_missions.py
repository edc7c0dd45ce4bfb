"""The missions that are active on the robots of an inventory, from the states of their services."""

from __future__ import annotations

import hashlib

from msgspec.structs import replace

from lfield.operator.fleet.active_missions import (
    active_missions,
    divided_hosts,
    idle_coordinators,
    is_idle,
    left_behind,
)
from lfield.wire.service_messages import BundleInfo, RunInfo, ServiceStatus, UnfinishedCoordinator


def info(name: str, *hosts: str) -> BundleInfo:
    return BundleInfo(hashlib.sha256(name.encode()).digest(), name, hosts=list(hosts))


TWO, THREE, NEXT = (
    info("two", "alpha", "bravo"),
    info("three", "alpha", "bravo", "carol"),
    info("next", "alpha", "bravo"),
)
OTHER = info("other", "carol", "dave")


def team(**active: BundleInfo | None) -> dict[str, ServiceStatus]:
    """The states of hosts with these active bundles."""
    return {
        host: ServiceStatus(
            host,
            "1",
            found.digest if found else b"",
            b"",
            [found] if found else [],
            RunInfo(),
            None,
            [],
            "",
            0.0,
        )
        for host, found in active.items()
    }


def names(statuses: dict[str, ServiceStatus], *without: str) -> list[str]:
    return [mission.name for mission in active_missions(statuses, without)]


def test_a_robot_without_a_mission_does_not_count() -> None:
    statuses = team(alpha=TWO, bravo=TWO, carol=None)
    assert names(statuses) == names(statuses, "carol") == ["two"]
    assert divided_hosts(statuses) == []


def test_a_host_without_an_answer_belongs_to_the_mission_that_names_it() -> None:
    (found,) = active_missions(team(alpha=TWO, carol=None))
    assert found.hosts == ("alpha", "bravo")


def test_a_mission_with_another_bundle_on_one_host_is_divided() -> None:
    statuses = team(alpha=TWO, bravo=NEXT, carol=None)
    assert names(statuses) == []
    assert divided_hosts(statuses) == ["alpha", "bravo"]
    assert names(statuses, "bravo") == ["two"]
    assert divided_hosts(team(alpha=TWO, bravo=None)) == ["alpha", "bravo"]


def test_an_earlier_bundle_on_a_robot_outside_the_mission_is_no_division() -> None:
    statuses = team(alpha=TWO, bravo=TWO, carol=THREE)
    assert names(statuses) == ["two"]
    assert divided_hosts(statuses) == []
    # The team is divided if the robot runs that mission, which can no longer reach the other robots.
    statuses["carol"] = replace(statuses["carol"], run=RunInfo(THREE.digest, "running"))
    assert divided_hosts(statuses) == ["alpha", "bravo", "carol"]
    # A robot of the mission with an earlier bundle is a division.
    assert divided_hosts(team(alpha=THREE, bravo=THREE, carol=TWO)) == ["alpha", "bravo", "carol"]


def test_two_active_missions_are_told_apart_by_the_hosts_left_out() -> None:
    statuses = team(alpha=TWO, bravo=TWO, carol=OTHER, dave=OTHER)
    assert names(statuses) == ["two", "other"]
    assert divided_hosts(statuses) == []
    assert names(statuses, "carol", "dave") == ["two"]


def test_a_bundle_without_a_description_counts_where_it_is_active() -> None:
    statuses = team(alpha=TWO, bravo=TWO)
    for status in statuses.values():
        status.bundles.clear()
    (found,) = active_missions(statuses)
    assert (found.digest, found.hosts) == (TWO.digest, ("alpha", "bravo"))


def idle(run: dict[str, str], **where: str) -> tuple[dict[str, tuple[str, bool]], bool]:
    """The idle coordinators of a mission with `pilot` of alpha and `wing` of bravo, and whether all are idle.

    `run` has the phases of the hosts, `where` the state of each coordinator on its home.
    """
    homes = {"pilot": "alpha", "wing": "bravo"}
    bundle = replace(TWO, coordinators=homes)
    statuses = {
        host: replace(
            status,
            run=RunInfo(bundle.digest, phase, status=0 if phase == "ended" else None),
            unfinished=[
                UnfinishedCoordinator(agent, state, host, "two")
                for agent, state in where.items()
                if homes[agent] == host
            ],
        )
        for (host, status), phase in zip(
            team(**dict.fromkeys(run, bundle)).items(), run.values(), strict=True
        )
    }
    (mission,) = active_missions(statuses)
    found = idle_coordinators(mission, statuses)
    return {one.agent: (one.host, one.is_parked) for one in found}, is_idle(mission, found)


BOTH = {"alpha": "running", "bravo": "running"}


def test_a_parked_coordinator_is_idle() -> None:
    assert idle(BOTH, pilot="running", wing="waiting to start") == ({}, False)
    assert idle(BOTH, pilot="running", wing="parked") == ({"wing": ("bravo", True)}, False)
    parked = {"pilot": ("alpha", True), "wing": ("bravo", True)}
    assert idle(BOTH, pilot="parked", wing="parked") == (parked, True)


def test_a_coordinator_of_a_stopped_host_is_idle_unless_another_host_has_it() -> None:
    assert idle({"alpha": "running"}, pilot="running") == ({"wing": ("bravo", False)}, False)
    assert idle({"alpha": "running", "bravo": "stopped"}, pilot="moved") == (
        {"wing": ("bravo", False)},
        False,
    )
    # An ended coordinator is not reported any more.
    assert idle(BOTH, pilot="running") == ({}, False)
    assert idle({"alpha": "stopped", "bravo": "stopped"}) == ({}, False)
    # A restarting host continues with its coordinators.
    assert idle({"alpha": "running", "bravo": "waiting"}, pilot="running") == ({}, False)
    assert idle({"alpha": "ended", "bravo": "running"}) == ({}, False)


def test_a_host_that_runs_alone_after_the_end_is_left_behind() -> None:
    def left(alpha: RunInfo, bravo: RunInfo, *unfinished: UnfinishedCoordinator) -> list[str]:
        statuses = team(alpha=TWO, bravo=TWO)
        statuses["alpha"] = replace(statuses["alpha"], run=alpha, unfinished=list(unfinished))
        statuses["bravo"] = replace(statuses["bravo"], run=bravo)
        (mission,) = active_missions(statuses)
        return left_behind(mission, statuses)

    runs, over = RunInfo(TWO.digest, "running"), RunInfo(TWO.digest, "ended", status=0)
    assert left(runs, over) == ["alpha"]
    assert left(runs, runs) == left(over, over) == left(runs, replace(over, status=4)) == []
    assert left(replace(runs, reason="it starts"), over) == []
    assert left(runs, over, UnfinishedCoordinator("pilot", "in doubt", "bravo", "two")) == ["alpha"]
    # Bravo ended in an earlier run, and is left out of this one.
    assert left(runs, over, UnfinishedCoordinator("pilot", "running", "alpha", "two")) == []
