"""The hosts that receive a command, and their addresses: each host once, at the socket of its user."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from msgspec.structs import replace

from lfield.errors import NoMissionRunning, UsageError
from lfield.mission.team import team_of
from lfield.operator.runs import Run, RunManifest
from lfield.operator.targets import (
    display_names,
    open_team,
    running_mission,
    select_runs,
    single_target,
    targets_of_runs,
    targets_of_team,
    trusted_targets,
)

ROWS = [("Post", "near", "alpha", ()), ("Post", "far", "bravo", ())]
TEAM = team_of(ROWS, {"Post": "resource"}, {"bravo": 9})


def run(id: str, *here: str, team=TEAM, file="/m/tour.dL", **addresses: str) -> Run:
    """A run of some hosts of a team with these addresses."""
    reached = team.addresses_by_host | addresses
    sockets = {host: f"{host}.sock" for host in here}
    return Run(Path(f"/run/{id}"), RunManifest(file, team.deployment.hex(), 7, 1.0, 60.0, reached, sockets))


ONE, TWO = run("tour-00000001", "alpha", "bravo"), run("tour-00000002", "alpha", "bravo")
OTHER = run("sow-00000003", "alpha", team=team_of(ROWS[:1], {"Post": "resource"}, {}))


def asked(targets):
    return {target.id: dict(target.addresses) for target in targets}


def test_hosts_that_run_here_are_asked_at_their_sockets():
    assert asked(targets_of_runs([ONE])) == {
        ONE.id: {
            "alpha": "unix:/run/tour-00000001/alpha.sock",
            "bravo": "unix:/run/tour-00000001/bravo.sock",
        }
    }


def test_two_runs_of_one_mission_are_both_asked():
    targets = targets_of_team(TEAM, [ONE, TWO, OTHER], [])
    assert [target.id for target in targets] == [ONE.id, TWO.id]
    assert list(display_names(targets).values()) == [
        "tour-00000001/alpha",
        "tour-00000001/bravo",
        "tour-00000002/alpha",
        "tour-00000002/bravo",
    ]
    assert list(display_names(targets[:1]).values()) == ["alpha", "bravo"]


def test_remote_hosts_are_asked_at_the_addresses_of_the_run():
    one = run("tour-00000001", "alpha", bravo="10.0.0.2:8181")
    assert asked(targets_of_runs([one]))[one.id]["bravo"] == "10.0.0.2:8181"


def test_runs_of_single_hosts_of_a_mission_are_one_team():
    """Two services on one computer: each has the address of the other, which is used once."""
    bravo, alpha = run("tour-00000002", "bravo"), run("tour-00000001", "alpha")
    (target,) = targets_of_runs([bravo, alpha])
    assert target.runs == (bravo, alpha)
    assert dict(target.addresses) == {
        "alpha": "unix:/run/tour-00000001/alpha.sock",
        "bravo": "unix:/run/tour-00000002/bravo.sock",
    }
    assert list(target.addresses) == ["alpha", "bravo"]


def test_a_remote_host_with_the_name_of_a_local_one_is_asked_too():
    """alpha has an address for bravo that is not that of the local bravo."""
    alpha = run("tour-00000001", "alpha", bravo="10.0.0.2:8181")
    assert asked(targets_of_runs([alpha, run("tour-00000002", "bravo")])) == {
        "tour-00000001": {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.2:8181"},
        "tour-00000002": {"bravo": "unix:/run/tour-00000002/bravo.sock"},
    }


def test_a_remote_host_that_two_runs_know_is_asked_once():
    team = team_of([*ROWS, ("Post", "last", "carol", ())], {"Post": "resource"}, {})
    (target,) = targets_of_runs(
        [run("tour-00000001", "alpha", team=team), run("tour-00000002", "bravo", team=team)]
    )
    assert list(target.addresses) == ["alpha", "bravo", "carol"]
    assert target.addresses["carol"] == "carol:8181"


def test_runs_of_other_missions_are_teams_of_their_own():
    assert [target.id for target in targets_of_runs([ONE, OTHER])] == [ONE.id, OTHER.id]


def test_a_map_option_overrides_the_sockets():
    assert asked(targets_of_team(TEAM, [ONE, TWO], ["bravo=10.0.0.9:1"])) == {
        ONE.id: {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.9:1"},
        TWO.id: {"alpha": "unix:/run/tour-00000002/alpha.sock"},
    }


def test_a_mission_that_does_not_run_here_is_asked_at_its_addresses():
    assert asked(targets_of_team(TEAM, [OTHER], ["alpha=10.0.0.9:1"])) == {
        "": {"alpha": "10.0.0.9:1", "bravo": "bravo:9"}
    }
    with pytest.raises(UsageError, match="no host 'carol'"):
        targets_of_team(TEAM, [], ["carol=10.0.0.9:1"])


def test_one_run_is_selected():
    runs = [ONE, TWO, OTHER]
    assert select_runs(runs, "") == runs
    assert select_runs(runs, TWO.id) == select_runs(runs, "00000002") == [TWO]
    with pytest.raises(
        UsageError, match="no run tour; running: tour-00000001, tour-00000002 and sow-00000003"
    ):
        select_runs(runs, "tour")
    assert select_runs([], "") == []
    with pytest.raises(NoMissionRunning, match="no run tour: no mission is running"):
        select_runs([], "tour")


def test_the_running_mission_is_found(tmp_path):
    file = tmp_path / "mission.dL"
    file.write_text("//Post:near@alpha\n")
    team = open_team(file)
    runs = [run("mission-00000001", "alpha", team=team, file=str(file))]
    assert running_mission(runs) == file
    with pytest.raises(UsageError, match=r"several missions run here, name one: .*mission.dL and /m/tour.dL"):
        running_mission([*runs, ONE])
    file.write_text("//Post:near@bravo\n")
    with pytest.raises(UsageError, match="has changed since it was started"):
        running_mission(runs)


# --- runs that other users claim -----------------------------------------------------------------


def claimed(id: str, *here: str, user="mallory", **more) -> Run:
    """A run of another user that claims these hosts."""
    made = run(id, *here, **more)
    return replace(made, folder=Path(f"/tmp/lfield-7/{id}"), owner=user, is_foreign=True)


def test_a_claimed_run_does_not_replace_the_address_of_a_host():
    """bravo is on another computer, and another local user claims its socket."""
    alpha, false = run("tour-00000001", "alpha", bravo="10.0.0.2:1"), claimed("tour-00000002", "bravo")
    for runs in ([alpha, false], [false, alpha]):
        assert asked(targets_of_runs(runs)) == {
            "tour-00000001": {"alpha": "unix:/run/tour-00000001/alpha.sock", "bravo": "10.0.0.2:1"},
            "mallory/tour-00000002": {"bravo": "unix:/tmp/lfield-7/tour-00000002/bravo.sock"},
        }
    same = claimed("tour-00000002", "bravo", bravo="10.0.0.2:1", alpha="alpha:8181")
    assert asked(targets_of_runs([alpha, same]))["tour-00000001"]["bravo"] == "10.0.0.2:1"


def test_a_claimed_run_does_not_replace_hosts_of_a_named_mission():
    false = claimed("tour-00000002", "alpha", "bravo")
    (team, extra) = targets_of_team(TEAM, [false], ["alpha=10.0.0.9:1"])
    assert (team.user, dict(team.addresses)) == ("", {"alpha": "10.0.0.9:1", "bravo": "bravo:9"})
    assert (extra.user, list(extra.addresses)) == ("mallory", ["bravo"])


def test_a_claimed_run_with_the_same_id_keeps_its_own_answers():
    own, same = run("tour-00000001", "alpha", "bravo"), claimed("tour-00000001", "alpha", "bravo")
    targets = targets_of_runs([same, own])
    places = [place for target in targets for place in target.host_refs]
    assert len(set(places)) == 4
    assert [target.id for target in targets] == ["tour-00000001", "mallory/tour-00000001"]
    assert [place.user for place in places] == ["", "", "mallory", "mallory"]
    assert select_runs([same, own], "00000001") == select_runs([same, own], own.id) == [own]


def test_remote_addresses_of_a_run_are_not_asked_for_another_user():
    alpha, other = run("tour-00000001", "alpha"), claimed("tour-00000002", "alpha")
    (own, other_target) = targets_of_runs([alpha, other])
    assert list(own.addresses) == ["alpha", "bravo"]
    assert list(other_target.addresses) == ["alpha"]


def test_runs_of_one_other_user_are_one_team_and_of_two_users_are_two():
    first, second = claimed("tour-00000001", "alpha"), claimed("tour-00000002", "bravo")
    assert [target.runs for target in targets_of_runs([first, second])] == [(first, second)]
    third = claimed("tour-00000002", "bravo", user="bob")
    assert [target.user for target in targets_of_runs([first, third])] == ["mallory", "bob"]


def test_a_run_of_another_user_is_trusted_if_it_is_named():
    false = claimed("tour-00000002", "alpha", "bravo")
    (named,) = select_runs([ONE, false], "mallory/tour-00000002")
    assert (named.id, named.user) == ("mallory/tour-00000002", "")
    assert [target.user for target in targets_of_team(TEAM, [named], [])] == [""]


def test_the_own_team_is_selected_despite_claims_of_other_users():
    own, false = targets_of_runs([ONE]), targets_of_runs([claimed("tour-00000002", "alpha")])
    assert single_target([*own, *false]) == own[0]
    assert single_target(false) == false[0]
    assert trusted_targets([*own, *false]) == own
    with pytest.raises(UsageError, match="runs here 2 times, as tour-00000001 and tour-00000002: pick one"):
        single_target(targets_of_runs([ONE, TWO]))


NAMES_BY_ADDRESS = [
    ({"bravo": "localhost:9"}, {"alpha": "localhost:8181"}),
    ({"alpha": "0.0.0.0:8181", "bravo": "10.0.0.2:9"}, {"alpha": "10.0.0.2:8181", "bravo": "0.0.0.0:9"}),
    ({}, {}),
]


@pytest.mark.parametrize(("of_one", "of_other"), NAMES_BY_ADDRESS)
def test_hosts_of_a_team_that_run_here_singly_are_one_team(of_one, of_other):
    """Each run has another address of the other's host, as in `--map bravo=localhost:9`."""
    one, other = run("tour-00000001", "alpha", **of_one), run("tour-00000002", "bravo", **of_other)
    target = single_target(targets_of_runs([one, other]))
    assert target.addresses == {
        "alpha": "unix:/run/tour-00000001/alpha.sock",
        "bravo": "unix:/run/tour-00000002/bravo.sock",
    }


def test_a_host_that_runs_here_twice_makes_two_teams():
    twice = [run("tour-00000001", "alpha", bravo="localhost:9"), run("tour-00000002", "alpha", "bravo")]
    with pytest.raises(UsageError):
        single_target(targets_of_runs(twice))


def test_a_file_that_another_user_names_is_not_opened(tmp_path):
    """The file may be a FIFO, which would block without end."""
    fifo = tmp_path / "mission\x1b[31m.dL"
    os.mkfifo(fifo)
    false = claimed("tour-00000002", "alpha", file=str(fifo))
    for runs in ([false], select_runs([false], false.id)):
        with pytest.raises(UsageError, match="only other users run missions here") as error:
            running_mission(runs)
        assert "mallory/tour-00000002" in str(error.value)
        assert "\x1b" not in str(error.value)


def test_host_names_are_escaped_for_the_terminal():
    (target,) = targets_of_runs([run("tour-00000001", "a\x1b[31m", **{"a\x1b[31m": "10.0.0.1:1"})])
    assert "a\\u{1b}[31m" in display_names([target]).values()
