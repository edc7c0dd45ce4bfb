"""The report of a push or a rollback on its vote, and its exit status."""

from __future__ import annotations

import json

import pytest

from lfield import exit_status
from lfield.cli.fleet.ballot_report import PushReport
from lfield.errors import HandshakeError, NoListener
from lfield.operator.fleet.activation import BallotResult, new_ballot
from lfield.wire.service_messages import BallotState, Vote

DIGEST = bytes(range(32))


def result(**votes: Vote) -> BallotResult:
    """The result of a ballot of alpha and bravo, from the reports of the voters."""
    found = BallotResult(new_ballot(DIGEST, ["alpha", "bravo"], "anna", bytes))
    for host, vote in votes.items():
        reasons = {host: "lead.fc is off the ground"} if vote == "no" else {}
        found.add(host, BallotState(found.ballot.id, found.ballot, {host: vote}, reasons, "open"))
    return found


@pytest.mark.parametrize(
    ("votes", "status", "outcome"),
    [
        ({"alpha": "yes", "bravo": "yes"}, exit_status.DONE, "activated"),
        ({"alpha": "yes", "bravo": "no"}, exit_status.FAILED, "aborted"),
        ({"bravo": "no"}, exit_status.FAILED, "aborted"),
        ({"alpha": "yes"}, exit_status.UNKNOWN_OUTCOME, "open"),
        ({}, exit_status.UNKNOWN_OUTCOME, "open"),
    ],
)
def test_the_exit_status_follows_the_votes(capsys, votes: dict[str, Vote], status: int, outcome: str) -> None:
    assert PushReport(DIGEST, as_json=True).on_result(result(**votes)) == status
    decoded = json.loads(capsys.readouterr().out)
    assert (decoded["outcome"], decoded["votes"], decoded["bundle"]) == (outcome, votes, DIGEST.hex())


def test_each_no_vote_is_printed_with_its_reason(capsys) -> None:
    PushReport(DIGEST, as_json=False).on_result(result(alpha="yes", bravo="no"))
    assert "bravo: votes no: lead.fc is off the ground" in capsys.readouterr().err


def test_hosts_that_do_not_know_the_result_are_named(capsys) -> None:
    PushReport(DIGEST, as_json=False).on_result(result(alpha="yes", bravo="yes"))
    assert "will learn it from the others" in capsys.readouterr().out


def test_a_host_that_cannot_store_its_vote_is_named_with_the_reason(capsys) -> None:
    found = result(bravo="yes")
    found.unreached["alpha"] = HandshakeError("cannot write state.json: No space left on device")
    # The host answers the report of the votes without a vote.
    found.add("alpha", BallotState(found.ballot.id, None, {}, {}, "open"))
    assert PushReport(DIGEST, as_json=False).on_result(found) == exit_status.UNKNOWN_OUTCOME
    assert "alpha: no vote: cannot write state.json" in capsys.readouterr().err


def test_a_host_that_voted_too_late_is_named_with_the_reason(capsys) -> None:
    found = result(alpha="yes")
    found.unreached["bravo"] = NoListener("10.0.0.2:8182")
    closed = BallotState(found.ballot.id, None, {"bravo": "no"}, {"bravo": "closed"}, "aborted")
    found.add("bravo", closed)
    assert PushReport(DIGEST, as_json=False).on_result(found) == exit_status.FAILED
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("bravo")]
    assert "closed" in line
    assert "10.0.0.2:8182" in line
