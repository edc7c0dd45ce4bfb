"""A path between two hosts is silent for a while: whether the link is closed, and when traffic resumes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lfield.mission.loader import load_mission
from lfield.net.health.link_heartbeats import (
    IDLE_LOST_AFTER,
    IDLE_PING_EVERY,
    LOST_AFTER,
    PING_EVERY,
    SUSPECT_AFTER,
)
from lfield.simulate.host_fleet import Fleet
from lfield.wire.coordinator_messages import TransferAccepted
from lfield.wire.messages import Backpressure

PROGRAM = "resource Post { init(string[] arg) { } }\n"
HOSTS = ("alpha", "bravo")
ENDS = (HOSTS, HOSTS[::-1])


@pytest.fixture(autouse=True)
def links_are_busy(request, monkeypatch) -> None:
    """Treat the idle links between these hosts as busy, except in tests with "idle" in their name."""
    if "idle" not in request.node.name:
        monkeypatch.setattr("lfield.net.health.link_monitor.IDLE_AFTER", math.inf)


def fleet_of(folder: Path, seed: int) -> Fleet:
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("".join(f"//Post:{host}s@{host}\n" for host in HOSTS))
    fleet = Fleet(load_mission(folder / "mission.dL"), seed)
    fleet.run(20.0)
    assert linked(fleet) == [True, True]
    return fleet


def linked(fleet: Fleet) -> list[bool]:
    return [other in fleet.runs[host].host.peers.incarnations for host, other in ENDS]


def links(fleet: Fleet) -> list[object]:
    return [fleet.runs[host].host.peers.link_of(other) for host, other in ENDS]


def silences(fleet: Fleet) -> list[float]:
    """Time since each host last received from the other, by its own clock."""
    both = [(fleet.runs[host].host.peers, other) for host, other in ENDS]
    return [peers.now() - (peers.last_contact_at(other) or 0.0) for peers, other in both]


def silence(fleet: Fleet, seconds: float) -> None:
    """Drop all packets in both directions without an error."""
    fleet.network.silence(*HOSTS)
    fleet.network.silence(*HOSTS[::-1])
    fleet.run(seconds)


def seconds_until_received(fleet: Fleet) -> float:
    """Seconds from the return of the path until both hosts receive again."""
    back = fleet.now
    fleet.heal(*HOSTS)
    while not all(linked(fleet)) or max(silences(fleet)) > fleet.now - back:
        fleet.run(0.05)
        assert fleet.now < back + 20.0
    return fleet.now - back


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("seconds", [1.0, 5.0, 15.0, 30.0])
def test_traffic_resumes_within_a_second_of_the_return_of_the_path(tmp_path, seconds, seed):
    fleet = fleet_of(tmp_path, seed)
    silence(fleet, seconds)
    assert seconds_until_received(fleet) <= 1.2
    fleet.run(30.0)
    assert linked(fleet) == [True, True]


def test_a_link_that_recovers_before_its_time_out_is_kept(tmp_path):
    fleet = fleet_of(tmp_path, 1)
    before = links(fleet)
    silence(fleet, SUSPECT_AFTER + 0.5)
    assert linked(fleet) == [True, True]
    seconds_until_received(fleet)
    fleet.run(30.0)
    assert links(fleet) == before


def test_a_silent_link_on_a_calm_path_is_closed_after_the_minimum_time(tmp_path):
    fleet = fleet_of(tmp_path, 1)
    silence(fleet, LOST_AFTER - 1.5 * PING_EVERY)
    assert linked(fleet) == [True, True]
    fleet.run(2.5 * PING_EVERY + 0.1)
    assert linked(fleet) == [False, False]


@pytest.mark.parametrize("seed", range(3))
def test_the_silence_of_an_idle_link_is_noticed_within_ten_seconds(tmp_path, seed):
    fleet = fleet_of(tmp_path, seed)
    fleet.run(60.0 + seed)
    silence(fleet, IDLE_LOST_AFTER - IDLE_PING_EVERY - 2 * PING_EVERY)
    assert linked(fleet) == [True, True]
    fleet.run(10.0)
    assert linked(fleet) == [False, False]


def test_an_idle_link_sends_rare_heartbeats_and_a_hop_makes_it_busy(tmp_path):
    fleet = fleet_of(tmp_path, 1)
    fleet.run(20.0)
    alpha = fleet.runs["alpha"].host.peers
    pauses = []
    for _ in range(60):
        fleet.run(1.0)
        pauses.append(max(silences(fleet)))
    assert IDLE_PING_EVERY - 1.0 <= max(pauses) <= IDLE_PING_EVERY + 1.5
    assert linked(fleet) == [True, True]
    silence(fleet, 1.0)
    alpha.send("bravo", Backpressure("full"))
    alpha.send("bravo", TransferAccepted("tom", 1, 1))
    fleet.run(LOST_AFTER + 2.5 * PING_EVERY)
    assert linked(fleet)[0] is False
