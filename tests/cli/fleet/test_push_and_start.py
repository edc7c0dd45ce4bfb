"""Bundles that become active on all robots or none, and missions that the operator starts and stops."""

from __future__ import annotations

import os
import shutil
import signal
import time

import pytest
from robots import TEAM, program, told

pytestmark = pytest.mark.process


def until(condition, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


def is_up(here, host: str) -> bool:
    """Whether the mission's host runs without waiting."""
    run = told(here("status", "--json"))[host]["run"]
    return (run["phase"], run["reason"]) == ("running", "")


def test_a_mission_is_pushed_started_changed_and_rolled_back(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    first = told(here("push", "mission.dL", "--json"))
    assert first["outcome"] == "activated"
    assert first["votes"] == {"alpha": "yes", "bravo": "yes"}

    started = here("start", "--json")
    assert (started.status, told(started)["started"]) == (0, True)
    team.services["bravo"].wait_for("^visit 1$")
    team.services["alpha"].wait_for("status 0")
    until(lambda: not any(each["unfinished"] for each in told(here("status", "--json")).values()))

    team.mission(text="call")
    second = told(here("push", "mission.dL", "--json"))
    assert second["outcome"] == "activated"
    # Only changed pieces are sent.
    assert 0 < second["sent"]["alpha"]["bytes"] < first["sent"]["alpha"]["bytes"] / 2
    here("start", status=0)
    team.services["bravo"].wait_for("^call 1$")
    until(lambda: told(here("status", "--json"))["alpha"]["run"]["phase"] == "ended")

    back = told(here("rollback", "--json"))
    assert (back["outcome"], back["bundle"]) == ("activated", first["bundle"])
    states = told(here("status", "--json"))
    assert {each["bundle"] for each in states.values()} == {first["bundle"]}
    assert {each["signed_by"] for each in states.values()} == {"operator"}
    output = here("status")
    assert [line.split()[:3] for line in output.out[1:3]] == [
        [host, first["bundle"][:16], "mission"] for host in ("alpha", "bravo")
    ]


@pytest.mark.few(0)
def test_unfinished_coordinators_forbid_an_activation_until_discarded(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission(rounds=1000, pause=0.5)
    here("push", "mission.dL", status=0)
    here("start", status=0)
    team.services["bravo"].wait_for("^visit 2$")
    team.mission()
    refused = here("push", "mission.dL", "--json")
    assert (refused.status, told(refused)["outcome"]) == (1, "aborted")
    assert any("tom" in reason for reason in told(refused)["reasons"].values())
    # The refusal came before the vote, so no mission was held.
    assert told(refused)["votes"] == {}
    assert not any("vote no" in line for service in team.services.values() for line in service.err)

    stopped = told(here("stop", "--json"))
    assert [each["phase"] for each in stopped.values()] == ["stopped", "stopped"]
    unfinished = [each["unfinished"] for each in told(here("status", "--json")).values()]
    assert {one["agent"] for found in unfinished for one in found} == {"tom"}
    here("push", "mission.dL", status=1)
    checked = here("service", "--host", "alpha", "--state", "state-alpha", "--check")
    assert (checked.status, checked.out) == (1, ["coordinator tom of mission has not ended: moved"])
    # The mission continues at its last position until it is discarded.
    started = here("start", status=0)
    assert any(line.startswith("tom continues: it has not ended") for line in started.out)
    team.services["bravo"].wait_for("restarted")
    assert told(here("start", "--json"))["continues"] == []
    discarded = told(here("stop", "--discard", "--json"))
    assert {name for each in discarded.values() for name in each["discarded"]} == {"tom"}
    here("service", "--host", "alpha", "--state", "state-alpha", "--check", status=0)
    here("push", "mission.dL", status=0)


@pytest.mark.few(0)
def test_a_second_start_waits_for_a_missing_host(lfield, here, robots) -> None:
    """The coordinator of the first start is in all journals: the second start does not wait."""
    team = robots("alpha", "bravo", "carol")
    lfield.mission(program(), TEAM + "//Post:other@carol\n")
    team.up()
    here("push", "mission.dL", status=0)
    here("start", status=0)
    until(lambda: {each["run"]["phase"] for each in told(here("status", "--json")).values()} == {"ended"})
    # The host of carol does not run.
    team.inventory.write_text("".join(team.inventory.read_text().splitlines(keepends=True)[:-1]))
    # The command waits for 20 s.
    here("start", status=1)
    runs = {host: each["run"]["phase"] for host, each in told(here("status", "--json")).items()}
    assert runs == {"alpha": "running", "bravo": "running"}


@pytest.mark.few(0)
def test_a_killed_service_leaves_the_mission_alone_and_supervises_it_again(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission(rounds=1000, pause=0.2)
    here("push", "mission.dL", status=0)
    here("start", status=0)
    team.services["bravo"].wait_for("^visit 2$")
    team.kill("bravo")
    here("status", status=69)
    team.up("bravo")
    team.services["bravo"].wait_for("host of .* still running")
    pid = team.state("bravo")["run"]["pid"]
    # A host that is killed is started again.
    os.kill(pid, signal.SIGKILL)
    team.services["bravo"].wait_for("restarts in 2 s")
    until(lambda: team.state("bravo")["run"]["pid"] not in (0, pid))
    until(lambda: is_up(here, "bravo"))
    # So is a host that ended while its service did not run.
    team.kill("bravo")
    pid = team.state("bravo")["run"]["pid"]
    os.kill(pid, signal.SIGKILL)
    team.up("bravo")
    team.services["bravo"].wait_for("restarts in 2 s")
    # An orderly end of a service ends the mission's host.
    until(lambda: is_up(here, "bravo"))
    team.services["bravo"].signal(signal.SIGTERM)
    assert team.services["bravo"].wait() == 0
    team.services["bravo"].wait_for("ended with status 130")


@pytest.mark.few(0)
def test_a_service_whose_state_was_deleted_finds_its_host_and_votes_no(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission(rounds=1000, pause=0.2)
    here("push", "mission.dL", status=0)
    here("start", status=0)
    team.services["bravo"].wait_for("^visit 2$")
    team.kill("bravo")
    pid = team.state("bravo")["run"]["pid"]
    shutil.rmtree(lfield.folder / "state-bravo")
    team.up("bravo")
    team.services["bravo"].wait_for("host of .* still running")
    assert team.state("bravo")["run"]["pid"] == pid
    told_status = told(here("status", "--json"))["bravo"]
    assert (told_status["bundle"], told_status["run"]["phase"]) == ("", "running")
    team.mission(text="call")
    refused = told(here("push", "mission.dL", "--without", "alpha", "--json"))
    assert (refused["outcome"], refused["reasons"].keys()) == ("aborted", {"bravo"})
    assert "the vehicles of the mission's host are unknown" in refused["reasons"]["bravo"]
    # The mission ends in order, and its result is known although its file was deleted.
    stopped = told(here("stop", "--discard", "--json"))["bravo"]
    assert (stopped["phase"], stopped["trouble"]) == ("stopped", "")
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"


@pytest.mark.few(0)
def test_a_host_that_is_off_is_named_before_the_vote_and_cannot_start_the_old_bundle(
    lfield, here, robots
) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    old = told(here("push", "mission.dL", "--json"))["bundle"]
    team.kill("bravo")
    team.mission(text="call")
    missed = here("push", "mission.dL", "--json")
    assert (missed.status, told(missed)["outcome"]) == (69, "staged")
    assert list(told(missed)["errors"]) == ["bravo"]
    assert any("bravo: NOT REACHED" in line for line in missed.err)
    new = told(here("push", "mission.dL", "--without", "bravo", "--json"))
    assert (new["outcome"], new["votes"]) == ("activated", {"alpha": "yes"})

    team.up("bravo")
    states = told(here("status", "--json"))
    assert (states["alpha"]["bundle"], states["bravo"]["bundle"]) == (new["bundle"], old)
    refused = here("start", "--json")
    assert (refused.status, told(refused)["started"]) == (1, False)
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    here("start", status=0)
    team.services["bravo"].wait_for("^call 1$")
