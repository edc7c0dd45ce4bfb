"""Whom a command asks, and where: each host once, at the socket of whoever runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.errors import NothingRuns, UsageError
from lfield.mission.team import team_of
from lfield.operator.addressed import names_of, only_mission, open_team, parties_of, parties_of_team, picked
from lfield.operator.runs import Note, Run

ROWS = [("Post", "near", "alpha", ()), ("Post", "far", "bravo", ())]
TEAM = team_of(ROWS, {"Post": "resource"}, {"bravo": 9})


def run(id: str, *here: str, team=TEAM, file="/m/tour.dL", **addresses: str) -> Run:
    """A run of some hosts, which knows all of the team at these addresses."""
    reached = team.reached | addresses
    doors = {host: f"{host}.sock" for host in here}
    return Run(Path(f"/run/{id}"), Note(file, team.deployment.hex(), "ann", 7, 1.0, 60.0, reached, doors))


ONE, TWO = run("tour-00000001", "alpha", "bravo"), run("tour-00000002", "alpha", "bravo")
OTHER = run("sow-00000003", "alpha", team=team_of(ROWS[:1], {"Post": "resource"}, {}))


def asked(parties):
    return {party.id: dict(party.addresses) for party in parties}


def test_hosts_that_run_here_are_asked_at_their_sockets():
    assert asked(parties_of([ONE])) == {
        ONE.id: {
            "alpha": "unix:/run/tour-00000001/alpha.sock",
            "bravo": "unix:/run/tour-00000001/bravo.sock",
        }
    }


def test_two_runs_of_one_mission_are_both_asked():
    parties = parties_of_team(TEAM, [ONE, TWO, OTHER], [])
    assert [party.id for party in parties] == [ONE.id, TWO.id]
    assert list(names_of(parties).values()) == [
        "tour-00000001/alpha",
        "tour-00000001/bravo",
        "tour-00000002/alpha",
        "tour-00000002/bravo",
    ]
    assert list(names_of(parties[:1]).values()) == ["alpha", "bravo"]


def test_hosts_elsewhere_are_asked_where_the_run_knows_them():
    one = run("tour-00000001", "alpha", bravo="10.0.0.2:8181")
    assert asked(parties_of([one]))[one.id]["bravo"] == "10.0.0.2:8181"


def test_hosts_by_themselves_are_one_team():
    """Two services on one computer: each knows the other at its address, and that is asked once."""
    bravo, alpha = run("tour-00000002", "bravo"), run("tour-00000001", "alpha")
    (party,) = parties_of([bravo, alpha])
    assert party.runs == (bravo, alpha)
    assert dict(party.addresses) == {
        "alpha": "unix:/run/tour-00000001/alpha.sock",
        "bravo": "unix:/run/tour-00000002/bravo.sock",
    }
    assert list(party.addresses) == ["alpha", "bravo"]


def test_a_host_that_is_not_the_one_next_door_is_asked_too():
    """alpha looks for bravo where no bravo of this computer is."""
    alpha = run("tour-00000001", "alpha", bravo="10.0.0.2:8181")
    assert asked(parties_of([alpha, run("tour-00000002", "bravo")])) == {
        "tour-00000001": {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.2:8181"},
        "tour-00000002": {"bravo": "unix:/run/tour-00000002/bravo.sock"},
    }


def test_a_host_elsewhere_that_two_runs_know_is_asked_once():
    team = team_of([*ROWS, ("Post", "last", "carol", ())], {"Post": "resource"}, {})
    (party,) = parties_of(
        [run("tour-00000001", "alpha", team=team), run("tour-00000002", "bravo", team=team)]
    )
    assert list(party.addresses) == ["alpha", "bravo", "carol"]
    assert party.addresses["carol"] == "carol:8181"


def test_runs_of_other_missions_are_their_own():
    assert [party.id for party in parties_of([ONE, OTHER])] == [ONE.id, OTHER.id]


def test_a_map_comes_before_the_sockets():
    assert asked(parties_of_team(TEAM, [ONE, TWO], ["bravo=10.0.0.9:1"])) == {
        ONE.id: {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.9:1"},
        TWO.id: {"alpha": "unix:/run/tour-00000002/alpha.sock"},
    }


def test_a_mission_that_nobody_runs_here_is_asked_where_it_says():
    assert asked(parties_of_team(TEAM, [OTHER], ["alpha=10.0.0.9:1"])) == {
        "": {"alpha": "10.0.0.9:1", "bravo": "bravo:9"}
    }
    with pytest.raises(UsageError, match="no host 'carol'"):
        parties_of_team(TEAM, [], ["carol=10.0.0.9:1"])


def test_one_run_is_picked():
    runs = [ONE, TWO, OTHER]
    assert picked(runs, "") == runs
    assert picked(runs, TWO.id) == picked(runs, "00000002") == [TWO]
    with pytest.raises(
        UsageError, match="no run tour: there is tour-00000001, tour-00000002 and sow-00000003"
    ):
        picked(runs, "tour")
    assert picked([], "") == []
    with pytest.raises(NothingRuns, match="and no run tour"):
        picked([], "tour")


def test_the_mission_that_runs_is_known(tmp_path):
    file = tmp_path / "mission.dL"
    file.write_text("//Post:near@alpha\n")
    team = open_team(file)
    runs = [run("mission-00000001", "alpha", team=team, file=str(file))]
    assert only_mission(runs) == file
    with pytest.raises(UsageError, match=r"several missions run here, name one: .*mission.dL and /m/tour.dL"):
        only_mission([*runs, ONE])
    file.write_text("//Post:near@bravo\n")
    with pytest.raises(UsageError, match="has changed since it was started"):
        only_mission(runs)
