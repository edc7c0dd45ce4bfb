"""The report of `lfield forget`: hosts that discarded a copy, silent hosts, or no host."""

from __future__ import annotations

import argparse

import pytest
from scripted_snapshots import batch_of

from lfield.cli.operations import forget
from lfield.errors import AddressError, CoordinatorAlive
from lfield.operator import client
from lfield.operator.targets import HostRef, TargetTeam
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import ForgetResponse, Status
from lfield.wire.subscription_messages import EventBatch

ALPHA, BRAVO = HostRef("", "alpha"), HostRef("", "bravo")
SILENT = AddressError("bravo:8181", "no answer within 8 s")
GONE = "bravo: no answer; a copy of tom there would continue: "


def run(monkeypatch, capsys, before: dict, answers: dict):
    """The exit status, or the exception; the output; the errors."""

    def told(parties, request, keys):
        return before if request is client.SNAPSHOT else answers

    team = TargetTeam((), {"alpha": "alpha:8181", "bravo": "bravo:8181"})
    monkeypatch.setattr(forget, "selected_runs", lambda args: [])
    monkeypatch.setattr(forget, "selected_teams", lambda args, runs: [team])
    monkeypatch.setattr(client, "ask_teams", told)
    try:
        end = forget.run(argparse.Namespace(agent="tom", keys=None))
    except CoordinatorAlive as error:
        end = error
    return end, *capsys.readouterr()


def snapshot_with(*known: CoordinatorState) -> EventBatch:
    return batch_of(Status("alpha", "alpha:8181", 1.0, b"p" * 32, b"d" * 32, [], list(known), [], [], []))


IN_DOUBT = {ALPHA: snapshot_with(CoordinatorState("tom", 1, 2, 1, "MOVED", "bravo")), BRAVO: SILENT}


def test_discarded_copies_and_silent_hosts_are_reported(monkeypatch, capsys):
    answers = {ALPHA: ForgetResponse([1]), BRAVO: SILENT}
    assert run(monkeypatch, capsys, IN_DOUBT, answers) == (
        69,
        "alpha: tom, start 1, is given up as lost\n",
        f"{GONE}{SILENT}\n",
    )


def test_a_copy_discarded_with_all_hosts_answering_is_a_success(monkeypatch, capsys):
    answers = {ALPHA: ForgetResponse([1]), BRAVO: ForgetResponse([])}
    output = run(monkeypatch, capsys, IN_DOUBT, answers)
    assert output == (0, "alpha: tom, start 1, is given up as lost\n", "")


@pytest.mark.parametrize("other", [SILENT, ForgetResponse([])])
def test_a_forget_without_a_discarded_copy_is_reported(monkeypatch, capsys, other):
    # The team has continued the coordinator between the two requests.
    error, out, _ = run(monkeypatch, capsys, IN_DOUBT, {ALPHA: ForgetResponse([]), BRAVO: other})
    assert (error.exit_status, out) == (69, "")
    assert str(error) == (
        "no copy of tom was given up: no host that answers has it in doubt, lost or parked any more; "
        "'lfield ps' shows where it is"
    )


def test_without_any_answer_nothing_is_claimed(monkeypatch, capsys):
    silent = {ALPHA: SILENT, BRAVO: SILENT}
    error, out, prompts = run(monkeypatch, capsys, silent, silent)
    assert (str(error), out) == ("no host has answered: it is unknown whether a copy of tom was given up", "")
    assert prompts.count("no answer; a copy of tom there would continue") == 2
