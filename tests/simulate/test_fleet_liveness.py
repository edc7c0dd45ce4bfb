"""Triangles with a cut link, hosts that crash, lost disks: no host reports a loss while a copy lives."""

from __future__ import annotations

import random
from itertools import combinations
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.replication.locate.outcomes import UnavailableHosts
from lfield.replication.membership.membership import Membership
from lfield.simulate.host_fleet import Fleet, FleetOptions
from simulation_testing.fault_injection import FaultRates

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Walker {
    init(string[] arg) {
        for (int i = 1; i < arg.length(); i = i + 1) {
            try { findPost(arg[i]).stay(4.0); } catch (UnreachableResourceException gone) { }
        }
    }
}
"""
HOSTS = ("alpha", "bravo", "carol")
EDGES = list(combinations(HOSTS, 2))
#: A start that is younger than a census is not part of it.
YOUNG = 3.0


def mission(folder: Path, way: str, home: str = "alpha", program: str = PROGRAM) -> Mission:
    lines = [f"//Post:{host[0]}@{host}" for host in HOSTS]
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text("\n".join([*lines, f"//Walker:walker@{home}?{way}", ""]))
    return load_mission(folder / "mission.dL")


class LossCheck:
    """No start has two copies, and no loss is reported while a copy can continue."""

    def __init__(self) -> None:
        self.told = 0
        self.since: dict[tuple[str, int], float] = {}

    def __call__(self, fleet: Fleet) -> None:
        alive = {
            (known.agent, known.generation)
            for life in fleet.runs.values()
            for known in life.core.mobility.known_states()
            if known.state in ("RUN", "FROZEN", "PREPARED")
        }
        for start in alive:
            self.since.setdefault(start, fleet.now)
        for at, host, text in fleet.log[self.told :]:
            if text.startswith("walker lost: "):
                old = {start for start in alive if at - self.since[start] > YOUNG}
                assert not old, f"{host}: {text} while {old} live"
        self.told = len(fleet.log)


WORDS = {exit_status.DONE: "done", exit_status.FAILED: "lost", exit_status.UNKNOWN_OUTCOME: "unheard"}


def outcomes(fleet: Fleet) -> dict[str, str]:
    """The outcomes with which hosts ended."""
    return {host: WORDS[status] for host, status in fleet.left.items()}


@pytest.mark.few(5)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("edge", EDGES, ids="-".join)
@pytest.mark.parametrize("way", ["a&b&c", "c&b&a", "b&b&b"])
def test_one_cut_link_of_a_triangle_does_not_change_the_end(tmp_path, edge, way, seed):
    fleet = Fleet(
        mission(tmp_path, way), seed, LossCheck(), options=FleetOptions(lost_after=5.0, unreachable_after=8.0)
    )
    fleet.run(3.0)
    fleet.cut(*edge)
    fleet.run(80.0)
    assert outcomes(fleet) == dict.fromkeys(HOSTS, "done")


@pytest.mark.parametrize("edge", EDGES, ids="-".join)
def test_a_restored_link_does_not_change_the_end(tmp_path, edge):
    fleet = Fleet(mission(tmp_path, "c&b&a&c"), 1, LossCheck(), options=FleetOptions(lost_after=3.0))
    for _ in range(6):
        fleet.run(2.5)
        fleet.cut(*edge)
        fleet.run(2.5)
        fleet.heal(*edge)
    fleet.run(40.0)
    assert outcomes(fleet) == dict.fromkeys(HOSTS, "done")


@pytest.mark.parametrize(
    "way", ["c&c&c&c&c&c", "b&b&b&b&b&b", "c&b&c&b&c&b"], ids=["cut off", "near", "both"]
)
def test_an_unreachable_host_is_unheard_with_or_without_the_walker(tmp_path, way):
    """All hosts without knowledge report the same; those with the walker continue."""
    fleet = Fleet(
        mission(tmp_path, way), 2, LossCheck(), options=FleetOptions(lost_after=4.0, unreachable_after=3.0)
    )
    fleet.run(10.0)
    for other in ("bravo", "carol"):
        fleet.cut("alpha", other)
    fleet.run(80.0)
    assert outcomes(fleet) == {"alpha": "unheard", "bravo": "done", "carol": "done"}
    (line,) = [text for _, host, text in fleet.log if host == "alpha" and "outcome unknown" in text]
    assert "has been unreachable for" in line


def test_a_chain_of_hosts_reports_the_end_at_its_far_side(tmp_path):
    """Alpha is linked with bravo only, bravo with carol only, carol with dana."""
    (tmp_path / "mission.L").write_text(PROGRAM)
    hosts = ["alpha", "bravo", "carol", "dana"]
    lines = [f"//Post:{host[0]}@{host}" for host in hosts]
    lines.append("//Walker:walker@alpha?b&c&d&d&d&d&d")
    (tmp_path / "mission.dL").write_text("\n".join(lines) + "\n")
    fleet = Fleet(load_mission(tmp_path / "mission.dL"), 3, LossCheck(), options=FleetOptions(lost_after=4.0))
    for one, other in (("alpha", "carol"), ("alpha", "dana"), ("bravo", "dana")):
        fleet.later(12.0, lambda one=one, other=other: fleet.cut(one, other))
    fleet.run(80.0)
    assert outcomes(fleet) == dict.fromkeys(hosts, "done")


@pytest.mark.few(4)
@pytest.mark.parametrize("away", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("home", ["alpha", "bravo"])
def test_a_host_with_proof_of_a_loss_informs_the_others_before_it_ends(tmp_path, home, seed, away):
    """Also the host that returned: no status depends on which host checks first."""
    fleet = Fleet(
        mission(tmp_path, "c&c&c&c&c", home),
        seed,
        LossCheck(),
        options=FleetOptions(lost_after=4.0, keeps=False),
    )
    fleet.run(8.0 + seed / 20)
    fleet.crash("carol")
    fleet.run(away)
    fleet.boot("carol")
    fleet.run(30.0)
    assert outcomes(fleet) == dict.fromkeys(HOSTS, "lost")
    times = [at for at, _, text in fleet.log if text.startswith("walker lost: ")]
    assert max(times) - min(times) < 2.0


def test_a_host_that_crashes_and_stays_away_proves_nothing(tmp_path):
    fleet = Fleet(mission(tmp_path, "c&c&c&c&c"), 5, LossCheck(), options=FleetOptions(lost_after=5.0))
    fleet.run(8.0)
    fleet.crash("carol")
    fleet.run(30.0)
    assert outcomes(fleet) == {"alpha": "unheard", "bravo": "unheard"}


ROUGH = FaultRates(cut=2.0, one_way=4.0, reset=6.0, kill=15.0, stop=15.0)
ROUND = PROGRAM.replace("int i = 1; i < arg.length(); i = i + 1", "int i = 1; true; i = i % 3 + 1")


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(12))
def test_under_random_faults_no_loss_is_reported_while_a_copy_lives(tmp_path, seed):
    fleet = Fleet(
        mission(tmp_path, "a&b&c", program=ROUND.replace("4.0", "0.5")),
        seed,
        LossCheck(),
        options=FleetOptions(unreachable_after=2.0, lost_after=4.0, keeps=False),
    )
    ROUGH.inject(fleet, random.Random(seed))
    fleet.run(100.0)


@pytest.mark.few(0)
def test_losses_are_reported_under_random_faults(tmp_path):
    """Shows that the check above has cases to check."""
    observed = set()
    for seed in range(12):
        way = mission(tmp_path, "a&b&c", program=ROUND.replace("4.0", "0.5"))
        fleet = Fleet(way, seed, options=FleetOptions(unreachable_after=2.0, lost_after=4.0, keeps=False))
        ROUGH.inject(fleet, random.Random(seed))
        fleet.run(100.0)
        observed |= set(outcomes(fleet).values())
        if {"lost", "unheard"} <= observed:
            return
    raise AssertionError(observed)


def test_a_judge_that_counts_a_silent_host_as_lost_is_found(tmp_path, monkeypatch):
    """A host without an answer counts as ended."""

    def absent(self, answered, now, lost_after, unmet):
        return UnavailableHosts(ended=[host for host in HOSTS if host not in answered])

    way = mission(tmp_path, "c&c&c&c&c")
    fleet = Fleet(way, 0, LossCheck(), options=FleetOptions(lost_after=4.0, keeps=False))
    fleet.run(8.0)
    monkeypatch.setattr(Membership, "unavailable_hosts", absent)
    fleet.cut("alpha", "carol")
    with pytest.raises(AssertionError, match="lost"):
        fleet.run(10.0)


# Generations


def generations(fleet: Fleet) -> set[int]:
    return {
        known.generation
        for life in fleet.runs.values()
        for known in life.core.mobility.known_states()
        if known.agent == "walker"
    }


def test_after_a_crash_a_coordinator_continues_as_the_same_start(tmp_path):
    fleet = Fleet(mission(tmp_path, "a&a&a&a&a&a&a&a"), 6)
    fleet.run(5.0)
    for number in (1, 2):
        fleet.crash("alpha")
        fleet.boot("alpha")
        fleet.run(5.0)
        assert generations(fleet) == {1}
        # Its portals change nothing, so only its start was stored.
        lines = [text for _, _, text in fleet.log if text.startswith("walker restarted: ")]
        assert len(lines) == number


def test_a_later_run_counts_on_from_the_disk(tmp_path):
    fleet = Fleet(mission(tmp_path, "a"), 6, options=FleetOptions(lost_after=4.0))
    for number in (1, 2, 3):
        fleet.run(20.0)
        assert fleet.left == dict.fromkeys(HOSTS, 0)
        fleet.left.clear()
        for host in HOSTS:
            fleet.boot(host)
        fleet.run(2.0)
        assert max(generations(fleet)) == number + 1


def test_a_host_with_a_new_disk_waits_for_all_and_learns_of_its_live_coordinator(tmp_path):
    fleet = Fleet(mission(tmp_path, "b&c&a&a&a&a&a&a&a"), 7)
    fleet.run(5.0)
    fleet.crash("alpha")
    fleet.boot("alpha")
    fleet.crash("bravo")
    fleet.run(20.0)
    fleet.crash("alpha")
    fleet.lose_disk("alpha")
    fleet.boot("alpha")
    fleet.run(30.0)
    assert "walker" not in fleet.runs["alpha"].core.machine.agents
    reason = "walker not started: this host has no record of earlier starts, and bravo has to answer first"
    assert [host for _, host, text in fleet.log if text.startswith(reason)] == ["alpha"]
    fleet.boot("bravo")
    fleet.run(3.0)
    assert "walker not started again: it is alive on another host" in [
        text.strip() for _, _, text in fleet.log
    ]
    assert generations(fleet) == {1}


def test_a_start_that_cannot_be_stored_does_not_begin(tmp_path):
    fleet = Fleet(mission(tmp_path, "a&b&c"), 8)
    fleet.disks["alpha"].full, fleet.disks["alpha"].reserve = True, 0
    fleet.run(5.0)
    assert generations(fleet) == set()
    (line,) = [text for _, host, text in fleet.log if host == "alpha" and "journal write failed" in text]
    assert "no space is left" in line
    fleet.disks["alpha"].full = False
    fleet.run(20.0)
    assert generations(fleet) == {1}
