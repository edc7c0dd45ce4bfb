"""Votes of one host: proposals, closing queries, votes of others, and stored ballots."""

from __future__ import annotations

import pytest

from lfield.service import ballots
from lfield.service.ballots import MAX_CLOSED, MAX_EARLIER, MAX_PAST, ActivationState
from lfield.service.bundle_store import ServiceRecord, _decoder, _encoder
from lfield.wire.fields import MAX_LABEL
from lfield.wire.service_messages import Ballot, BallotState, Vote

X, Y, Z = (bytes([n]) * 32 for n in range(1, 4))
HOSTS = ["alpha", "bravo", "carol"]
ALL_YES: dict[str, Vote] = dict.fromkeys(HOSTS, "yes")


def ballot(number: int = 1, digest: bytes = X, hosts: list[str] = HOSTS) -> Ballot:
    return Ballot(number.to_bytes(16), digest, hosts, "anna")


def voted(number: int = 1, digest: bytes = X, refusal: str = "") -> ActivationState:
    return ballots.propose(ActivationState(), "alpha", ballot(number, digest), refusal)


def decided(state: ActivationState, number: int, digest: bytes, votes: dict[str, Vote]) -> ActivationState:
    """The state after a yes to a ballot and the votes of the others."""
    proposal = ballot(number, digest)
    return ballots.learn(ballots.propose(state, "alpha", proposal, ""), "alpha", proposal.id, votes)


def test_yes_vote_binds_until_all_votes_are_known() -> None:
    state = voted()
    assert state.open_ballot is not None
    assert state.open_ballot.missing == ["bravo", "carol"]
    state = ballots.learn(state, "alpha", ballot().id, {"bravo": "yes"})
    assert state.open_ballot is not None
    assert state.active == b""
    state = ballots.learn(state, "alpha", ballot().id, {"carol": "yes"})
    assert state.open_ballot is None
    assert state.active == X
    assert ballots.answer(state, "alpha", ballot().id).votes == ALL_YES


def test_refusal_aborts_the_ballot_and_does_not_bind() -> None:
    state = voted(refusal="a vehicle flies " * 100)
    known = ballots.answer(state, "alpha", ballot().id)
    assert (known.outcome, known.votes) == ("aborted", {"alpha": "no"})
    assert len(known.reasons["alpha"]) <= MAX_LABEL
    assert state.open_ballot is None


def test_one_no_vote_aborts_the_ballot() -> None:
    state = ballots.learn(voted(), "alpha", ballot().id, {"carol": "no"})
    assert state.open_ballot is None
    assert ballots.answer(state, "alpha", ballot().id).outcome == "aborted"
    assert state.active == b""


@pytest.mark.parametrize("refusal", ["", "it flies"])
def test_repeated_proposal_changes_nothing(refusal: str) -> None:
    state = voted(refusal=refusal)
    assert ballots.propose(state, "alpha", ballot(), "" if refusal else "it flies now") == state


def test_host_outside_the_ballot_is_not_bound() -> None:
    state = ballots.propose(ActivationState(), "dora", ballot(), "")
    assert state == ActivationState()


def test_query_closes_a_ballot_only_before_the_vote() -> None:
    state = ballots.close(ActivationState(), ballot().id)
    assert ballots.answer(state, "alpha", ballot().id).votes == {"alpha": "no"}
    late = ballots.propose(state, "alpha", ballot(), "")
    assert late == state
    assert late.open_ballot is None
    assert ballots.close(voted(), ballot().id) == voted()


def test_unknown_ballot_is_open() -> None:
    known = ballots.answer(ActivationState(), "alpha", ballot().id)
    assert known == BallotState(ballot().id, None, {}, {}, "open")


def test_bound_host_refuses_another_ballot_and_stays_bound() -> None:
    state = ballots.propose(voted(1, X), "alpha", ballot(2, Y), "")
    assert ballots.answer(state, "alpha", ballot(2).id).outcome == "aborted"
    bound = state.open_ballot
    assert bound is not None
    assert bound.id == ballot(1).id


def test_returning_host_learns_the_vote_given_by_an_operator() -> None:
    others = ballots.learn(voted(), "alpha", ballot().id, {"bravo": "yes", "carol": "no"})
    known = ballots.answer(others, "alpha", ballot().id)
    lost = ballots.propose(ActivationState(), "carol", ballot(), "")
    lost = ballots.learn(lost, "carol", ballot().id, known.votes)
    assert ballots.answer(lost, "carol", ballot().id).outcome == known.outcome == "aborted"
    assert lost.active == b""


def test_own_yes_vote_is_not_learnt_from_others() -> None:
    state = ballots.learn(ActivationState(), "alpha", ballot().id, ALL_YES)
    assert state == ActivationState()


def test_votes_of_hosts_outside_the_ballot_do_not_count() -> None:
    state = ballots.learn(voted(), "alpha", ballot().id, {"dora": "no"})
    assert state.open_ballot is not None


def test_no_vote_closes_a_ballot_before_its_proposal() -> None:
    state = ballots.learn(ActivationState(), "alpha", ballot().id, {"bravo": "no"})
    assert ballots.answer(state, "alpha", ballot().id).votes == {"alpha": "no"}
    assert ballots.learn(ActivationState(), "alpha", ballot().id, {"bravo": "yes"}) == ActivationState()


def test_decision_does_not_change() -> None:
    state = decided(ActivationState(), 1, X, ALL_YES)
    assert ballots.learn(state, "alpha", ballot().id, {"carol": "no"}) == state


@pytest.mark.parametrize("votes", [ALL_YES, {"bravo": "no"}], ids=["activated", "aborted"])
def test_votes_of_an_earlier_ballot_are_stored(votes: dict[str, Vote]) -> None:
    """Another host may still be bound by it, and must not receive a no vote on request."""
    state = decided(ActivationState(), 1, X, votes)
    before = ballots.answer(state, "alpha", ballot(1).id)
    state = decided(state, 2, Y, ALL_YES)
    after = ballots.answer(ballots.close(state, ballot(1).id), "alpha", ballot(1).id)
    assert (after.votes, after.outcome) == (before.votes, before.outcome)
    assert after.votes["alpha"] == "yes"
    repeated = ballots.propose(state, "alpha", ballot(1, X), "")
    assert repeated == state
    assert repeated.active == Y


def test_earlier_bundles_are_stored_once_per_activation() -> None:
    state = decided(ActivationState(), 1, X, ALL_YES)
    assert state.previous == b""
    state = decided(state, 2, X, ALL_YES)
    assert state.previous == b""
    state = decided(state, 3, Y, ALL_YES)
    assert (state.active, state.previous) == (Y, X)
    # A rollback is an activation too.
    state = decided(state, 4, X, ALL_YES)
    assert (state.active, state.previous, state.earlier) == (X, Y, (X, Y))


def test_stored_lists_are_bounded() -> None:
    state = ActivationState()
    for number in range(2 * MAX_PAST):
        state = ballots.close(state, ballot(10_000 + number).id)
        state = decided(state, number, bytes([number % 251]) * 32, ALL_YES)
    assert len(state.closed) == MAX_CLOSED
    assert len(state.past) == MAX_PAST
    assert len(state.earlier) == MAX_EARLIER
    assert _decoder.decode(_encoder.encode(ServiceRecord(state))).activation == state


def test_at_most_one_of_two_concurrent_proposals_is_activated() -> None:
    """Host by host in all orders: each host says yes to the first of two proposals only."""
    for pattern in range(8):
        states = {host: ActivationState() for host in HOSTS}
        for n, host in enumerate(HOSTS):
            order = [ballot(1, X), ballot(2, Y)] if pattern >> n & 1 else [ballot(2, Y), ballot(1, X)]
            for proposal in order:
                states[host] = ballots.propose(states[host], host, proposal, "")
        for number in (1, 2):
            votes: dict[str, Vote] = {}
            for host, state in states.items():
                votes |= ballots.answer(state, host, ballot(number).id).votes
            for host in HOSTS:
                states[host] = ballots.learn(states[host], host, ballot(number).id, votes)
        assert all(state.open_ballot is None for state in states.values())
        active = {state.active for state in states.values()}
        assert active == ({X} if pattern == 7 else {Y} if pattern == 0 else {b""})
