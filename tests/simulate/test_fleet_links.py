"""Teams of more than nine hosts: links are opened on demand, and closed when they are not needed."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed_link
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY
from lfield.simulate.host_fleet import Fleet, FleetOptions, copies
from simulation_testing.fault_injection import FaultRates

POST = """
resource Post {
    init(string[] arg) { }
    portal stay(string who, int number, real seconds) {
        write(who + " " + i2s(number) + "\\n");
        sleep(seconds);
    }
}
"""
WALKER = """
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        int number = 0;
        while (true) {
            number = number + 1;
            try {
                all[random(all.length())].stay(arg[0], number, 0.05);
            } catch (UnreachableResourceException gone) { }
            sleep(0.3);
        }
    }
}
"""
GUEST = """
coordinator Walker {
    init(string[] arg) {
        for (int i = 1; i < arg.length(); i = i + 1) findPost(arg[i]).stay("guest", i, 4.0);
    }
}
"""


def team(folder: Path, hosts: int, coordinators: str = "", program: str = "") -> Mission:
    """A mission; coordinators are `name@host?argument`, hosts are numbered."""
    lines = [f"//Post:p{n}@host{n}" for n in range(hosts)]
    lines += [f"//Walker:{words}" for words in coordinators.split()]
    (folder / "mission.L").write_text(POST + program)
    (folder / "mission.dL").write_text("\n".join(lines) + "\n")
    return load_mission(folder / "mission.dL")


def one_copy(fleet: Fleet) -> None:
    for start, hosts in copies(fleet).items():
        assert len(hosts) == 1, f"{start} runs on {hosts} at {fleet.now:.3f} s"


def links(fleet: Fleet, host: str) -> set[str]:
    return set(fleet.runs[host].host.peers.incarnations)


def stamps(fleet: Fleet) -> Counter[str]:
    return Counter(text.strip() for _, _, text in fleet.log if text.startswith(("w", "guest")))


def logged(fleet: Fleet, words: str) -> list[str]:
    return [host for _, host, text in fleet.log if words in text]


@pytest.mark.few(0)
@pytest.mark.parametrize("hosts", [3, 9, 12, 40])
def test_an_idle_host_sends_at_most_eight_messages_between_two_heartbeats(tmp_path, monkeypatch, hosts):
    sent: list[str] = []

    def encode(message, encoded=framed_link.encode):
        sent.append(type(message).__name__)
        return encoded(message)

    monkeypatch.setattr(framed_link, "encode", encode)
    fleet = Fleet(team(tmp_path, hosts))
    fleet.run(30.0)
    sent.clear()
    fleet.run(65.0)
    assert set(sent) == {"Ping", "Pong"}
    assert len(sent) / hosts / 65.0 * IDLE_PING_EVERY == pytest.approx(min(8, hosts - 1), rel=0.15)


@pytest.mark.few(0)
def test_walkers_reach_all_hosts_with_each_call_made_once_and_unneeded_links_closed(tmp_path):
    fleet = Fleet(team(tmp_path, 24, "w0@host0?w0 w9@host9?w9 w20@host20?w20", WALKER), 1, one_copy)
    fleet.run(60.0)
    recorded = stamps(fleet)
    assert set(recorded.values()) == {1}
    for walker in ("w0", "w9", "w20"):
        numbers = [int(stamp.split()[1]) for stamp in recorded if stamp.startswith(walker)]
        assert sorted(numbers) == list(range(1, len(numbers) + 1))
        assert len(numbers) > 100
    assert not logged(fleet, " lost\n")
    for host, life in fleet.runs.items():
        # A walker stays for half a second, and links for ten.
        assert life.core.membership.neighbours <= links(fleet, host)
        assert len(links(fleet, host)) < 23
    held = Counter(frozenset((host, other)) for host in fleet.runs for other in links(fleet, host))
    assert set(held.values()) == {2}


@pytest.mark.few(0)
@pytest.mark.parametrize("seed", range(6))
def test_two_hosts_that_dial_each_other_at_once_have_one_link(tmp_path, seed):
    fleet = Fleet(team(tmp_path, 24), seed)
    fleet.run(5.0)
    assert "host12" not in links(fleet, "host0")
    for one, other in (("host0", "host12"), ("host12", "host0")):
        life = fleet.runs[one]
        life.process.loop.soon(
            lambda life=life, other=other: life.host.peers.require_link(other), seed * 0.002
        )
    fleet.run(1.0)
    assert "host12" in links(fleet, "host0")
    assert "host0" in links(fleet, "host12")
    connections = [
        connection
        for connection in fleet.network._connections
        if not connection.is_over and {end.machine.name for end in connection.ends} == {"host0", "host12"}
    ]
    assert len(connections) == 1
    fleet.run(25.0)
    assert "host12" not in links(fleet, "host0")
    assert not logged(fleet, " lost\n")


@pytest.mark.few(1)
@pytest.mark.parametrize("victim", ["host1", "host9"], ids=["a neighbour", "far off"])
def test_all_hosts_learn_the_end_when_a_host_without_coordinator_crashes(tmp_path, victim):
    fleet = Fleet(
        team(tmp_path, 16, "w@host0?p12&p5&p7&p3", GUEST), 2, one_copy, options=FleetOptions(lost_after=5.0)
    )
    fleet.run(6.0)
    fleet.crash(victim)
    fleet.run(30.0)
    assert fleet.left == dict.fromkeys(fleet.runs.keys() | fleet.left.keys(), exit_status.DONE)
    assert len(fleet.left) == 15


@pytest.mark.few(0)
def test_all_hosts_report_unheard_when_the_host_with_the_coordinator_crashes(tmp_path):
    fleet = Fleet(
        team(tmp_path, 16, "w@host0?p9&p9&p9&p9", GUEST), 3, one_copy, options=FleetOptions(lost_after=5.0)
    )
    fleet.run(6.0)
    fleet.crash("host9")
    fleet.run(40.0)
    assert set(fleet.left.values()) == {exit_status.UNKNOWN_OUTCOME}
    assert len(fleet.left) == 15


@pytest.mark.few(0)
def test_all_hosts_report_a_loss_when_that_host_returns_without_the_coordinator(tmp_path):
    fleet = Fleet(
        team(tmp_path, 16, "w@host0?p9&p9&p9&p9", GUEST), 4, one_copy, options=FleetOptions(lost_after=20.0)
    )
    fleet.run(6.0)
    fleet.crash("host9")
    fleet.run(1.0)
    fleet.boot("host9")
    fleet.run(40.0)
    assert fleet.left == dict.fromkeys((f"host{n}" for n in range(16)), exit_status.FAILED)


@pytest.mark.few(0)
@pytest.mark.parametrize("seed", range(3))
def test_cut_links_make_no_host_count_as_silent(tmp_path, seed):
    """Host 9 has no reachable neighbour left; others still have contact with it."""
    fleet = Fleet(
        team(tmp_path, 16, "w@host0?p9&p9&p9", GUEST), seed, one_copy, options=FleetOptions(lost_after=6.0)
    )
    fleet.run(6.0)
    for other in sorted(fleet.runs["host9"].core.membership.neighbours):
        fleet.cut("host9", other)
    fleet.run(60.0)
    assert fleet.left == dict.fromkeys((f"host{n}" for n in range(16)), exit_status.DONE)


ROUGH = FaultRates(cut=1.0, one_way=2.0, reset=2.0, slow=4.0, kill=10.0, stop=10.0, power=30.0)


@pytest.mark.few(0)
@pytest.mark.parametrize("seed", range(3))
def test_under_random_faults_no_start_has_two_copies(tmp_path, seed):
    fleet = Fleet(
        team(tmp_path, 20, "w0@host0?w0 w5@host5?w5", WALKER),
        seed,
        one_copy,
        options=FleetOptions(unreachable_after=3.0),
    )
    storm = ROUGH.inject(fleet, random.Random(seed))
    fleet.run(60.0)
    assert len(storm.faults) > 60
    assert sum(stamps(fleet).values()) > 30


@pytest.mark.few(0)
def test_cut_and_broken_links_alone_repeat_no_call(tmp_path):
    fleet = Fleet(team(tmp_path, 20, "w0@host0?w0 w5@host5?w5", WALKER), 5, one_copy)
    FaultRates(cut=1.0, reset=1.0, one_way=2.0, slow=2.0).inject(fleet, random.Random(5))
    fleet.run(60.0)
    recorded = stamps(fleet)
    assert set(recorded.values()) == {1}
    assert sum(recorded.values()) > 50
