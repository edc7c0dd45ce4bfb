"""Whom a command asks, and where: each host once, at the socket of whoever runs it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from lfield.errors import NothingRuns, UsageError
from lfield.mission.team import team_of
from lfield.operator.addressed import (
    believed_of,
    names_of,
    only_mission,
    only_party,
    open_team,
    parties_of,
    parties_of_team,
    picked,
)
from lfield.operator.runs import Note, Run

ROWS = [("Post", "near", "alpha", ()), ("Post", "far", "bravo", ())]
TEAM = team_of(ROWS, {"Post": "resource"}, {"bravo": 9})


def run(id: str, *here: str, team=TEAM, file="/m/tour.dL", **addresses: str) -> Run:
    """A run of some hosts, which knows all of the team at these addresses."""
    reached = team.reached | addresses
    doors = {host: f"{host}.sock" for host in here}
    return Run(Path(f"/run/{id}"), Note(file, team.deployment.hex(), 7, 1.0, 60.0, reached, doors))


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


# --- what other users say -------------------------------------------------------------------------------


def claimed(id: str, *here: str, user="mallory", **more) -> Run:
    """A run of another user, who says that these hosts are there."""
    made = run(id, *here, **more)
    return replace(made, folder=Path(f"/tmp/lfield-7/{id}"), owner=user, is_foreign=True)


def test_the_word_of_another_user_takes_no_way_to_a_host_away():
    """bravo is on another computer, and somebody here says that it is at their door."""
    alpha, false = run("tour-00000001", "alpha", bravo="10.0.0.2:1"), claimed("tour-00000002", "bravo")
    for runs in ([alpha, false], [false, alpha]):
        assert asked(parties_of(runs)) == {
            "tour-00000001": {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.2:1"},
            "mallory/tour-00000002": {"bravo": "unix:/tmp/lfield-7/tour-00000002/bravo.sock"},
        }
    same = claimed("tour-00000002", "bravo", bravo="10.0.0.2:1", alpha="alpha:8181")
    assert asked(parties_of([alpha, same]))["tour-00000001"]["bravo"] == "10.0.0.2:1"


def test_nor_the_hosts_of_a_mission_that_is_named():
    false = claimed("tour-00000002", "alpha", "bravo")
    (team, beside) = parties_of_team(TEAM, [false], ["alpha=10.0.0.9:1"])
    assert (team.user, dict(team.addresses)) == ("", {"alpha": "10.0.0.9:1", "bravo": "bravo:9"})
    assert (beside.user, list(beside.addresses)) == ("mallory", ["bravo"])


def test_nor_an_answer_of_a_run_that_is_called_the_same():
    own, same = run("tour-00000001", "alpha", "bravo"), claimed("tour-00000001", "alpha", "bravo")
    parties = parties_of([same, own])
    places = [place for party in parties for place in party.places]
    assert len(set(places)) == 4
    assert [party.id for party in parties] == ["tour-00000001", "mallory/tour-00000001"]
    assert [place.user for place in places] == ["", "", "mallory", "mallory"]
    assert picked([same, own], "00000001") == picked([same, own], own.id) == [own]


def test_what_a_run_asks_over_the_network_is_not_asked_for_another_user_too():
    alpha, other = run("tour-00000001", "alpha"), claimed("tour-00000002", "alpha")
    (own, beside) = parties_of([alpha, other])
    assert list(own.addresses) == ["alpha", "bravo"]
    assert list(beside.addresses) == ["alpha"]


def test_runs_of_one_other_user_are_one_team_and_those_of_two_are_not():
    first, second = claimed("tour-00000001", "alpha"), claimed("tour-00000002", "bravo")
    assert [party.runs for party in parties_of([first, second])] == [(first, second)]
    third = claimed("tour-00000002", "bravo", user="bob")
    assert [party.user for party in parties_of([first, third])] == ["mallory", "bob"]


def test_a_run_that_is_named_is_believed():
    false = claimed("tour-00000002", "alpha", "bravo")
    (named,) = picked([ONE, false], "mallory/tour-00000002")
    assert (named.id, named.user) == ("mallory/tour-00000002", "")
    assert [party.user for party in parties_of_team(TEAM, [named], [])] == [""]


def test_one_team_is_looked_at_whatever_others_say_they_run():
    own, false = parties_of([ONE]), parties_of([claimed("tour-00000002", "alpha")])
    assert only_party([*own, *false]) == own[0]
    assert only_party(false) == false[0]
    assert believed_of([*own, *false]) == own
    with pytest.raises(UsageError, match="runs here 2 times, as tour-00000001 and tour-00000002: pick one"):
        only_party(parties_of([ONE, TWO]))


NAMES_BY_ADDRESS = [
    ({"bravo": "localhost:9"}, {"alpha": "localhost:8181"}),
    ({"alpha": "0.0.0.0:8181", "bravo": "10.0.0.2:9"}, {"alpha": "10.0.0.2:8181", "bravo": "0.0.0.0:9"}),
    ({}, {}),
]


@pytest.mark.parametrize(("of_one", "of_other"), NAMES_BY_ADDRESS)
def test_hosts_of_a_team_that_run_here_one_by_one_are_one_team(of_one, of_other):
    """Each run knows the other's host by another address, as in `--map bravo=localhost:9`."""
    one, other = run("tour-00000001", "alpha", **of_one), run("tour-00000002", "bravo", **of_other)
    party = only_party(parties_of([one, other]))
    assert party.addresses == {
        "alpha": "unix:/run/tour-00000001/alpha.sock",
        "bravo": "unix:/run/tour-00000002/bravo.sock",
    }


def test_a_host_that_runs_here_twice_makes_two_teams():
    twice = [run("tour-00000001", "alpha", bravo="localhost:9"), run("tour-00000002", "alpha", "bravo")]
    with pytest.raises(UsageError):
        only_party(parties_of(twice))


def test_no_file_is_opened_since_another_user_names_it(tmp_path):
    """It may be a fifo, which waits for ever."""
    fifo = tmp_path / "mission\x1b[31m.dL"
    os.mkfifo(fifo)
    false = claimed("tour-00000002", "alpha", file=str(fifo))
    for runs in ([false], picked([false], false.id)):
        with pytest.raises(UsageError, match="only other users run missions here") as error:
            only_mission(runs)
        assert "mallory/tour-00000002" in str(error.value)
        assert "\x1b" not in str(error.value)


def test_names_of_hosts_order_no_terminal():
    (party,) = parties_of([run("tour-00000001", "a\x1b[31m", **{"a\x1b[31m": "10.0.0.1:1"})])
    assert "a\\u{1b}[31m" in names_of([party]).values()
