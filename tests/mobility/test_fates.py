"""Every rule by which a host tells what became of a coordinator."""

from __future__ import annotations

import pytest

from lfield.mobility.fates import Fate, fates
from lfield.wire.messages import Known

HOMES = {"tom": "alpha"}


def row(state, sequence=0, where="", *, generation=1, outcome="", detail="", id="tom"):
    return Known(id, generation, sequence, sequence, state, where, outcome, detail)


def fate(records, gone=()):
    return fates(HOMES, records, gone).get("tom")


@pytest.mark.parametrize("outcome", ["done", "died", "lost"])
def test_an_ending_that_anybody_knows_counts(outcome):
    known = {"alpha": [row("MOVED", 1, "bravo")], "carol": [row("EXITED", 1, "bravo", outcome=outcome)]}
    assert fate(known, gone=("bravo",)) == Fate("tom", outcome, "")


def test_an_ending_keeps_its_detail():
    ended = row("EXITED", outcome="died", detail="NullException: nothing there")
    assert fate({"alpha": [ended]}) == Fate("tom", "died", "NullException: nothing there")


@pytest.mark.parametrize("state", ["RUN", "FROZEN", "PREPARED"])
def test_one_that_is_somewhere_is_alive(state):
    records = {"alpha": [row("MOVED", 1, "bravo")], "bravo": [row(state, 1, "carol")]}
    assert fate(records, gone=("carol",)) is None


def test_one_that_went_to_a_host_that_is_gone_is_lost():
    found = fate({"alpha": [row("MOVED", 3, "bravo")], "carol": [row("MOVED", 2, "alpha")]}, gone=("bravo",))
    assert found == Fate("tom", "lost", "it went to bravo (transfer 3), which is gone")


def test_one_in_doubt_towards_a_host_that_is_gone_is_lost():
    found = fate({"alpha": [row("IN DOUBT", 4, "bravo")]}, gone=("bravo",))
    assert found == Fate("tom", "lost", "it went to bravo (transfer 4), which is gone")


def test_one_in_doubt_towards_a_host_that_is_there_may_yet_live():
    assert fate({"alpha": [row("IN DOUBT", 4, "bravo")]}, gone=("carol",)) is None


def test_an_earlier_departure_to_a_host_that_is_gone_does_not_count():
    records = {"alpha": [row("MOVED", 2, "bravo")], "carol": [row("RUN", 5)]}
    assert fate(records, gone=("bravo",)) is None


def test_a_departure_to_a_host_that_answers_is_awaited():
    assert fate({"alpha": [row("MOVED", 1, "bravo")]}, gone=("carol",)) is None


@pytest.mark.parametrize("there", [[], [row("MOVED", 2, "alpha")]])
def test_one_that_went_to_a_host_that_knows_nothing_of_it_is_lost(there):
    """That host was restarted: its memory began after the arrival."""
    found = fate({"alpha": [row("MOVED", 3, "bravo")], "bravo": there})
    assert found == Fate("tom", "lost", "it went to bravo (transfer 3), which was restarted")


def test_a_copy_that_arrived_under_the_same_number_is_the_coordinator():
    records = {"alpha": [row("MOVED", 1, "bravo")], "bravo": [row("RUN", 1)]}
    assert fate(records, gone=("bravo",)) is None


def test_the_latest_start_counts():
    records = {"alpha": [row("MOVED", 9, "bravo"), row("RUN", 0, generation=2)]}
    assert fate(records, gone=("bravo",)) is None


def test_a_start_that_gave_way_to_an_earlier_one_does_not_count():
    gave_way = row("EXITED", 0, "alpha", generation=2, outcome="superseded")
    assert fate({"alpha": [gave_way], "bravo": [row("RUN", 1)]}) is None
    assert fate({"alpha": [gave_way, row("MOVED", 1, "bravo")]}, gone=("bravo",)).outcome == "lost"


def test_one_that_nobody_has_seen_is_lost_with_its_host():
    assert fate({"bravo": []}, gone=("alpha",)) == Fate("tom", "lost", "its host alpha is gone")
    assert fate({"bravo": []}, gone=("carol",)) is None


def test_only_coordinators_of_the_team_are_counted():
    strangers = [row("EXITED", outcome="done", id="echo"), row("EXITED", outcome="done", id="stranger")]
    assert fates(HOMES, {"alpha": strangers}, ()) == {}
