"""What `lfield forget` says of the answers: who gave what up, who is silent, or that nothing was given up."""

from __future__ import annotations

import argparse

import pytest

from lfield.cli.team import forget
from lfield.errors import AddressError, CoordinatorAlive
from lfield.operator import ask
from lfield.operator.addressed import Party, Place
from lfield.wire.coordinators import Known
from lfield.wire.observing import Forgotten, Status

ALPHA, BRAVO = Place("", "alpha"), Place("", "bravo")
SILENT = AddressError("bravo:8181", "no answer within 8 s")
GONE = "bravo: has not answered; should it have tom, that goes on there: "


def run(monkeypatch, capsys, before: dict, answers: dict):
    """The status, or what was raised; what was printed; what was said on stderr."""

    def told(parties, request, keys):
        return before if request is ask.STATUS else answers

    party = Party((), {"alpha": "alpha:8181", "bravo": "bravo:8181"})
    monkeypatch.setattr(forget, "meant_runs", lambda args: [])
    monkeypatch.setattr(forget, "meant_parties", lambda args, runs: [party])
    monkeypatch.setattr(ask, "ask_parties", told)
    try:
        end = forget.run(argparse.Namespace(agent="tom", keys=None))
    except CoordinatorAlive as error:
        end = error
    return end, *capsys.readouterr()


def status_with(*known: Known) -> Status:
    return Status("alpha", "alpha:8181", 1.0, b"p" * 32, b"d" * 32, [], list(known), [], [], [])


IN_DOUBT = {ALPHA: status_with(Known("tom", 1, 2, 1, "MOVED", "bravo")), BRAVO: SILENT}


def test_what_was_given_up_is_told_and_who_is_silent(monkeypatch, capsys):
    answers = {ALPHA: Forgotten([1]), BRAVO: SILENT}
    assert run(monkeypatch, capsys, IN_DOUBT, answers) == (
        69,
        "alpha: tom, start 1, is given up as lost\n",
        f"{GONE}{SILENT}\n",
    )


def test_when_every_host_has_heard_it_all_is_well(monkeypatch, capsys):
    answers = {ALPHA: Forgotten([1]), BRAVO: Forgotten([])}
    told = run(monkeypatch, capsys, IN_DOUBT, answers)
    assert told == (0, "alpha: tom, start 1, is given up as lost\n", "")


@pytest.mark.parametrize("other", [SILENT, Forgotten([])])
def test_that_nothing_was_given_up_is_said(monkeypatch, capsys, other):
    # The team has gone on with it between the two questions.
    error, out, _ = run(monkeypatch, capsys, IN_DOUBT, {ALPHA: Forgotten([]), BRAVO: other})
    assert (error.exit_status, out) == (69, "")
    assert str(error) == (
        "nothing of tom was given up: no host that answers has it in doubt, lost or parked any more; "
        "'lfield ps' shows where it is"
    )


def test_where_nobody_answers_nothing_is_claimed(monkeypatch, capsys):
    nobody = {ALPHA: SILENT, BRAVO: SILENT}
    error, out, said = run(monkeypatch, capsys, nobody, nobody)
    assert (str(error), out) == ("no host has answered: nothing of tom is known to be given up", "")
    assert said.count("has not answered; should it have tom, that goes on there") == 2
