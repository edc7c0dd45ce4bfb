"""Refusals of services and operators' commands: unknown keys, wrong signers and addresses, concurrent pushes,
full disks.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable

import pytest
from robots import told

from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.keystore import read_keys
from lfield.operator.client import observer_transport
from lfield.operator.fleet.activation import new_ballot
from lfield.operator.fleet.service_link import ServiceLinks
from lfield.testing.keyring import Keyring
from lfield.wire.service_messages import Ballot, BallotState, Proposal, ServiceMessage, VoteReport

pytestmark = pytest.mark.process


@pytest.fixture
def team(lfield, robots):
    made = robots("alpha", "bravo")
    made.up()
    made.mission()
    return made


def test_a_bundle_by_a_person_without_the_right_is_refused_by_every_robot(lfield, here, team) -> None:
    here("build", "mission.dL", status=0)
    lfield.keys.put("me", lfield.keys.issue("person", "maria", Right.OBSERVE, Right.OPERATE))
    refused = here("push", "mission.dL", status=65)
    assert "command" in " ".join(refused.err)
    here("status", status=0)
    # The services refuse a request of such a person also for a bundle that another person has signed.
    lfield.keys.put("me", lfield.keys.issue("person", "anna", Right.OBSERVE, Right.OPERATE, Right.COMMAND))
    here("sign", "mission.lfm", status=0)
    lfield.keys.put("me", lfield.keys.issue("person", "maria", Right.OBSERVE, Right.OPERATE))
    refused = here("push", "mission.lfm", status=1)
    assert "takes the right to command" in " ".join(refused.err)
    for command, status in (("start", 1), ("stop", 1), ("rollback", 64)):
        assert here(command).status == status
    assert {each["bundle"] for each in told(here("status", "--json")).values()} == {""}


@pytest.mark.few(0)
def test_a_bundle_whose_signer_has_no_right_is_refused_when_it_is_stored(lfield, here, team) -> None:
    """The keys of another authority sign the bundle, and a person with the right pushes it."""
    here("build", "mission.dL", status=0)
    Keyring(lfield.folder / "other").sign(lfield.folder / "mission.lfm")
    refused = here("push", "mission.lfm", "--json")
    assert (refused.status, told(refused)["outcome"]) == (1, "staged")
    assert {each["code"] for each in told(refused)["sent"].values()} == {"signature"}


@pytest.mark.few(0)
def test_a_refusal_is_reported_once(lfield, here, team) -> None:
    lfield.keys.put("me", lfield.keys.issue("person", "watcher", Right.OBSERVE))
    refused = here("stop", status=1)
    assert refused.err[0].startswith("alpha: REFUSED")
    assert refused.err[0].lower().count("refused") == 1


@pytest.mark.few(0)
def test_keys_of_another_authority_are_refused(lfield, here, team) -> None:
    other = Keyring(lfield.folder / "other").give() / "me"
    for command in ("status", "stop", "rollback"):
        refused = here(command, "--keys", other, status=1)
        assert "alpha: REFUSED" in " ".join(refused.err)
    # The unreached robot determines the status: a repeated command may succeed.
    team.kill("bravo")
    here("status", "--keys", other, status=69)


@pytest.mark.few(0)
def test_a_wrong_address_is_detected_by_the_certificate(lfield, here, team) -> None:
    text = team.inventory.read_text()
    (mission, service), (other_mission, other_service) = team.ports["alpha"], team.ports["bravo"]
    text = text.replace(str(mission), "M").replace(str(service), "S")
    text = text.replace(str(other_mission), str(mission)).replace(str(other_service), str(service))
    team.inventory.write_text(text.replace("M", str(other_mission)).replace("S", str(other_service)))
    refused = here("push", "mission.dL", status=69)
    assert refused.err[0].startswith("alpha: NOT REACHED: ")
    assert "bravo answered at the address of alpha" in refused.err[0]


@pytest.mark.few(0)
def test_an_inventory_without_a_host_of_the_mission_is_named(lfield, here, team) -> None:
    team.inventory.write_text(team.inventory.read_text().replace("bravo:", "brovo:"))
    refused = here("push", "mission.dL", status=64)
    assert "has no host 'bravo': did you mean 'brovo'?" in refused.err[0]


def test_two_bundles_never_run_in_one_mission(lfield, here, team) -> None:
    """The rule also holds if each start leaves out the host of the other bundle."""
    team.mission(rounds=1000, pause=0.5)
    here("push", "mission.dL", status=0)
    team.mission(rounds=1000, pause=0.5, text="call")
    here("push", "mission.dL", "--without", "bravo", status=0)
    here("start", "--without", "bravo", status=0)
    other = here("start", "--without", "alpha", "--json")
    assert (other.status, told(other)["started"]) == (1, False)
    assert "alpha runs bundle" in told(other)["text"]


@pytest.mark.few(0)
def test_a_command_that_leaves_out_every_host_is_refused(here, team) -> None:
    for command in ("start", "stop"):
        here(command, "--without", "alpha", "--without", "bravo", status=64)


@pytest.mark.few(0)
def test_a_damaged_bundle_is_named_and_repaired_by_a_push(lfield, here, team) -> None:
    here("push", "mission.dL", status=0)
    for path in lfield.folder.glob("state-*/lfield-*/service/bundles/*.lfm"):
        path.write_bytes(path.read_bytes()[:-600] + bytes(600))
    refused = here("start", status=1)
    # The other host may still start when one has ended.
    assert "is not a valid bundle" in " ".join(refused.err)
    here("push", "mission.dL", status=0)
    here("start", status=0)


@pytest.mark.few(0)
def test_keys_of_a_person_that_have_expired_are_named(lfield, here, team) -> None:
    lfield.keys.put("me", lfield.keys.issue("person", "anna", *ALL_RIGHTS, lasts=1.0))
    # The clocks of the processes cannot be set, and the shortest certificate is valid for a second.
    time.sleep(1.5)
    refused = here("status", status=1)
    assert "expired" in " ".join(refused.err)


@pytest.mark.few(0)
def test_a_bundle_that_was_staged_is_activated_later_without_being_sent_again(lfield, here, team) -> None:
    here("build", "mission.dL", status=0)
    here("sign", "mission.lfm", status=0)
    staged = told(here("push", "mission.lfm", "--stage", "--json"))
    assert staged["outcome"] == "staged"
    # Another push in between does not remove it.
    team.mission(text="call")
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    later = told(here("push", "mission.lfm", "--json"))
    assert (later["outcome"], later["bundle"]) == ("activated", staged["bundle"])
    assert [each["bytes"] for each in later["sent"].values()] == [0, 0]


@pytest.fixture
def staged(lfield, here, team) -> Callable[[], Ballot]:
    """`staged()`: a ballot on a bundle that both robots have stored."""
    here("push", "mission.dL", "--stage", status=0)
    digest = bytes.fromhex(told(here("status", "--json"))["alpha"]["stored"][0])
    return lambda: new_ballot(digest, ["alpha", "bravo"], "anna")


@pytest.fixture
def send(lfield, team) -> Callable[[str, ServiceMessage], BallotState]:
    """`send(host, message)`: a message of another operator, and the answer."""
    keys = read_keys(lfield.folder / "config/lfield/keys/me", "person")

    async def ask(host: str, message: ServiceMessage) -> BallotState:
        links = ServiceLinks(observer_transport(keys), {host: f"127.0.0.1:{team.ports[host][1]}"})
        try:
            return await links.ask(host, message, BallotState, 8.0)
        finally:
            links.close()

    return lambda host, message: asyncio.run(ask(host, message))


@pytest.mark.few(0)
def test_the_second_of_two_concurrent_pushes_is_refused_until_the_first_is_decided(
    here, team, staged, send
) -> None:
    ballot = staged()
    assert send("alpha", Proposal(ballot)).votes == {"alpha": "yes"}
    second = here("push", "mission.dL", "--json")
    assert (second.status, told(second)["outcome"]) == (1, "aborted")
    assert "by anna" in told(second)["reasons"]["alpha"]
    # The first ballot binds the service, so it starts no mission.
    here("start", status=1)
    assert told(here("status", "--json"))["alpha"]["ballot"]["outcome"] == "open"
    assert send("bravo", Proposal(ballot)).votes == {"bravo": "yes"}
    # The two services complete the ballot without the desk.
    team.services["alpha"].wait_for("active, decided by the votes of alpha and bravo")
    team.services["bravo"].wait_for("active, decided by the votes of alpha and bravo")
    assert send("alpha", VoteReport(ballot.id, {})).outcome == "activated"


@pytest.mark.few(0)
def test_an_activation_is_aborted_by_command_if_a_robot_is_lost(here, team, staged, send) -> None:
    ballot = staged()
    team.kill("bravo")
    send("alpha", Proposal(ballot))
    here("start", "--without", "bravo", status=1)
    assert told(here("rollback", "--lost", "bravo", "--json"))["aborted"] == ["alpha"]
    assert told(here("status", "--json"))["alpha"]["ballot"]["outcome"] == "aborted"
    here("rollback", "--lost", "bravo", status=64)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a small disk")
def test_a_full_disk_is_named_and_nothing_is_lost(lfield, here, robots) -> None:
    import subprocess

    team = robots("alpha", "bravo")
    disk = lfield.folder / "state-bravo"
    disk.mkdir(mode=0o700)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=15m,mode=700", "lfield-test", disk], check=False
    )
    if mounted.returncode:
        pytest.fail("a tmpfs cannot be mounted here")
    try:
        team.up()
        team.mission()
        refused = here("push", "mission.dL", "--json")
        assert (refused.status, told(refused)["outcome"]) == (1, "staged")
        assert "16 MiB" in told(refused)["sent"]["bravo"]["refusal"]
        here("status", status=0)
    finally:
        lfield.end()
        subprocess.run(["umount", "-l", disk], check=True)
