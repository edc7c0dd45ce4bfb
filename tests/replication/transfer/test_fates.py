"""The rules by which a host determines the outcome of a coordinator."""

from __future__ import annotations

import pytest

from lfield.replication.locate.outcomes import (
    CoordinatorOutcome,
    OutcomeResolver,
    UnavailableHosts,
    local_outcomes,
    resolve_outcomes,
)
from lfield.wire.coordinator_messages import CoordinatorState

HOMES = {"tom": "alpha"}


def row(state, sequence=0, where="", *, generation=1, outcome="", detail="", id="tom", life=1):
    return CoordinatorState(id, generation, sequence, sequence, state, where, outcome, detail, life)


def fate(records, gone=(), **absent):
    return resolve_outcomes(HOMES, records, UnavailableHosts(gone, **absent)).get("tom")


@pytest.mark.parametrize("outcome", ["done", "died", "lost"])
def test_an_end_that_any_host_knows_counts(outcome):
    known = {"alpha": [row("MOVED", 1, "bravo")], "carol": [row("EXITED", 1, "bravo", outcome=outcome)]}
    assert fate(known, gone=("bravo",)) == CoordinatorOutcome("tom", outcome, "")


def test_an_end_keeps_its_detail():
    ended = row("EXITED", outcome="died", detail="NullException: nothing there")
    assert fate({"alpha": [ended]}) == CoordinatorOutcome("tom", "died", "NullException: nothing there")


def test_a_known_loss_does_not_count_while_the_home_may_have_restarted_it():
    known = {"bravo": [row("EXITED", 1, "carol", outcome="lost", detail="it went")]}
    assert fate(known, reachable_by_others=["alpha"]) is None
    assert fate(known, silent_for={"alpha": 7.0}).outcome == "unheard"
    assert fate(known, gone=["alpha"]).starts == (1,)


def test_without_a_census_a_loss_counts_only_just_after_its_proof():
    lost = [row("EXITED", 1, "carol", outcome="lost", detail="it went")]
    assert local_outcomes(HOMES, lost, ()) == {}
    assert local_outcomes(HOMES, lost, {"tom"}) == {"tom": CoordinatorOutcome("tom", "lost", "it went")}
    assert local_outcomes(HOMES, [*lost, row("RUN", 0, generation=2)], {"tom"}) == {}
    assert local_outcomes(HOMES, [row("MOVED", 1, "bravo")], {"tom"}) == {}
    assert local_outcomes(HOMES, [row("EXITED", 1, outcome="done")], ()) == {
        "tom": CoordinatorOutcome("tom", "done", "")
    }


LEFT = {"alpha": [row("MOVED", 1, "bravo")]}


@pytest.mark.parametrize(
    ("records", "gone"),
    [
        *((LEFT | {"bravo": [row(state, 1, "carol")]}, "carol") for state in ("RUN", "FROZEN", "PREPARED")),
        (LEFT, "carol"),
        ({"alpha": [row("IN DOUBT", 4, "bravo")]}, "carol"),
        # An earlier departure to an ended host.
        ({"alpha": [row("MOVED", 2, "bravo")], "carol": [row("RUN", 5)]}, "bravo"),
        # A copy that arrived under the same number.
        (LEFT | {"bravo": [row("RUN", 1)]}, "bravo"),
        # A later start.
        ({"alpha": [row("MOVED", 9, "bravo"), row("RUN", 0, generation=2)]}, "bravo"),
    ],
    ids=["RUN", "FROZEN", "PREPARED", "moved", "in doubt", "earlier departure", "same number", "later start"],
)
def test_a_coordinator_that_may_still_run_has_no_outcome(records, gone):
    assert fate(records, gone=(gone,)) is None


@pytest.mark.parametrize(
    "records",
    [
        {"alpha": [row("MOVED", 3, "bravo")], "carol": [row("MOVED", 2, "alpha")]},
        {"alpha": [row("IN DOUBT", 4, "bravo")]},
    ],
    ids=["moved", "in doubt"],
)
def test_a_departure_to_an_ended_host_is_a_loss(records):
    lost = CoordinatorOutcome("tom", "lost", "its last host bravo has ended")
    assert fate(records, gone=("bravo",)) == lost


@pytest.mark.parametrize("there", [[], [row("MOVED", 2, "alpha")]])
def test_a_departure_to_a_host_without_the_copy_is_a_loss(there):
    """The target host was restarted: its memory began after the arrival."""
    found = fate({"alpha": [row("MOVED", 3, "bravo")], "bravo": there})
    assert found == CoordinatorOutcome("tom", "lost", "it moved to bravo (transfer 3), which was restarted")


def test_a_superseded_start_does_not_count():
    gave_way = row("EXITED", 0, "alpha", generation=2, outcome="superseded")
    assert fate({"alpha": [gave_way], "bravo": [row("RUN", 1)]}) is None
    assert fate({"alpha": [gave_way, row("MOVED", 1, "bravo")]}, gone=("bravo",)).outcome == "lost"


def test_a_coordinator_without_records_is_lost_with_its_home():
    lost = CoordinatorOutcome("tom", "lost", "its host alpha has ended")
    assert fate({"bravo": []}, gone=("alpha",)) == lost
    assert fate({"bravo": []}, gone=("carol",)) is None


def test_only_coordinators_of_the_team_are_counted():
    strangers = [row("EXITED", outcome="done", id="echo"), row("EXITED", outcome="done", id="stranger")]
    assert resolve_outcomes(HOMES, {"alpha": strangers}, UnavailableHosts()) == {}


def unheard(seconds=15.0, *hosts):
    return dict.fromkeys(hosts or ("bravo",), seconds)


WAYS = [row("MOVED", 3, "bravo"), row("IN DOUBT", 3, "bravo")]


@pytest.mark.parametrize("last", WAYS, ids=lambda row: row.state)
def test_a_departure_to_a_silent_host_is_unheard_and_never_lost(last):
    assert fate({"alpha": [last]}, reachable_by_others=["bravo"]) is None
    found = fate({"alpha": [last]}, silent_for=unheard())
    assert found == CoordinatorOutcome(
        "tom", "unheard", "it moved to bravo (transfer 3), and bravo has been unreachable for 15 s"
    )
    assert "lost" not in found.detail


def test_a_coordinator_of_a_silent_home_is_unheard():
    found = fate({"bravo": []}, silent_for=unheard(12.4, "alpha"))
    assert found == CoordinatorOutcome(
        "tom", "unheard", "it starts on alpha, and alpha has been unreachable for 12 s"
    )
    assert fate({"bravo": []}, reachable_by_others=["alpha"]) is None


def test_another_life_of_the_receiver_proves_a_loss_and_the_same_life_does_not():
    """In the same life the coordinator may still wait until the devices of the host are open."""
    went = {"alpha": [row("MOVED", 3, "bravo", life=7)], "bravo": []}
    assert fate(went, state_ids={"bravo": 7}) is None
    assert fate(went, state_ids={"bravo": 8}).outcome == "lost"


@pytest.mark.parametrize(
    "proof", [{"gone": ("bravo",)}, {"state_ids": {"bravo": 8}}], ids=["gone", "restarted"]
)
def test_there_is_no_proof_while_an_unreachable_host_may_have_the_copy(proof):
    """From bravo it may have moved on to carol."""
    known = {"alpha": [row("MOVED", 3, "bravo")]} | ({"bravo": []} if "state_ids" in proof else {})
    assert fate(known, **proof, reachable_by_others=["carol"]) is None
    found = fate(known, **proof, silent_for=unheard(15.0, "carol"))
    assert found.outcome == "unheard"
    assert found.detail.endswith(
        "but it may have moved on from there, and carol has been unreachable for 15 s"
    )
    assert fate(known | {"carol": []}, **proof).outcome == "lost"


def test_a_loss_needs_the_loss_of_all_starts():
    later = row("MOVED", 1, "bravo", generation=2)
    earlier = row("MOVED", 5, "carol", generation=1)
    both = {"alpha": [earlier, later]}
    assert fate(both, gone=("bravo",), reachable_by_others=["carol"]) is None
    assert fate(both, gone=("bravo",), silent_for=unheard(15.0, "carol")).outcome == "unheard"
    assert fate(both | {"carol": [row("RUN", 5)]}, gone=("bravo",)) is None
    assert fate(both, gone=("bravo", "carol")).outcome == "lost"


def test_an_end_of_one_start_does_not_count_while_another_is_alive():
    ended = row("EXITED", 2, "alpha", generation=1, outcome="done")
    assert fate({"alpha": [ended, row("RUN", generation=2)]}) is None
    again = row("EXITED", 0, "alpha", generation=2, outcome="died")
    assert fate({"alpha": [ended, again]}).outcome == "died"


def test_an_end_does_not_count_for_a_later_start_that_has_moved():
    """A restarted host receives the end of its earlier life, and has sent the new start away already."""
    ended = row("EXITED", 2, "alpha", generation=1, outcome="done")
    went = row("MOVED", 1, "bravo", generation=2)
    assert fate({"alpha": [ended, went]}, reachable_by_others=["bravo"]) is None
    assert fate({"alpha": [ended, went]}, silent_for=unheard()).outcome == "unheard"
    # Of two parallel starts the later one is lost, and the earlier one has ended.
    assert fate({"alpha": [ended, went]}, gone=("bravo",)).outcome == "done"


def test_a_superseded_start_does_not_count_wherever_its_shadow_points():
    stopped = row("EXITED", 0, "alpha", generation=2, outcome="superseded")
    shadow = row("MOVED", 4, "bravo", generation=2)
    assert fate({"alpha": [stopped], "carol": [shadow], "bravo": [row("RUN", 1)]}) is None
    assert fate({"alpha": [stopped], "carol": [shadow]}, reachable_by_others=["bravo"]) is None
    assert fate({"alpha": [stopped], "carol": [shadow]}, silent_for=unheard()).outcome == "unheard"


def test_a_copy_given_up_in_doubt_is_alive_if_any_host_has_it():
    given_up = row("EXITED", 3, "alpha", outcome="lost", detail="refused")
    assert fate({"alpha": [given_up], "bravo": [row("RUN", 3)]}) is None
    assert fate({"alpha": [given_up]}).outcome == "lost"


def test_a_loss_is_certain_when_two_censuses_miss_the_same_transfer():
    judge = OutcomeResolver(HOMES)

    def lost(sequence):
        known = {"alpha": [row("MOVED", sequence, "bravo")], "bravo": []}
        return judge.resolve(known, UnavailableHosts(state_ids={"bravo": 2}))

    assert lost(3) == {}
    assert lost(4) == {}
    assert lost(4)["tom"].outcome == "lost"


def test_silence_counts_when_two_censuses_find_it():
    judge = OutcomeResolver(HOMES)
    known = {"alpha": [row("MOVED", 3, "bravo")]}
    assert judge.resolve(known, UnavailableHosts(silent_for=unheard(15.0))) == {}
    assert judge.resolve(known, UnavailableHosts(silent_for=unheard(15.5)))["tom"].outcome == "unheard"


def test_records_of_a_host_count_after_it_has_ended():
    judge = OutcomeResolver(HOMES)
    judge.resolve(
        {"carol": [], "alpha": [row("MOVED", 3, "bravo")]}, UnavailableHosts(reachable_by_others=["bravo"])
    )
    silent = UnavailableHosts(ended=["alpha"], silent_for=unheard())
    judge.resolve({"carol": []}, silent)
    found = judge.resolve({"carol": []}, silent)["tom"]
    assert found.detail == "it moved to bravo (transfer 3), and bravo has been unreachable for 15 s"


def test_a_copy_that_was_seen_alive_proves_its_arrival():
    judge = OutcomeResolver(HOMES)
    judge.resolve(
        {"alpha": [row("MOVED", 3, "bravo")], "bravo": [row("RUN", 3)]},
        UnavailableHosts(state_ids={"bravo": 7}),
    )
    silent = UnavailableHosts(silent_for=unheard())
    judge.resolve({}, silent)
    assert judge.resolve({}, silent)["tom"].detail.startswith("it moved to bravo (transfer 3)")
    back = {"bravo": []}
    assert judge.resolve(back, UnavailableHosts(state_ids={"bravo": 7})) == {}
    judge.resolve(back, UnavailableHosts(state_ids={"bravo": 8}))
    assert judge.resolve(back, UnavailableHosts(state_ids={"bravo": 8}))["tom"].outcome == "lost"


def test_an_end_needs_no_second_census():
    done = {"alpha": [row("EXITED", outcome="done")]}
    assert OutcomeResolver(HOMES).resolve(done, UnavailableHosts())["tom"].outcome == "done"
