"""The part of one host in ballots about the activation of a bundle. Pure.

The result of a ballot is a function of the votes: activated when every host has voted yes, aborted with one
no. No desk decides, so after the end of a desk the hosts can settle every ballot among
themselves: a host that has not voted votes no on a request with `closes`, and each host reports the votes
that it knows. A host that has voted yes is *bound*: it starts no mission until it knows the result.

Every function returns a new value. The caller stores the value before it sends a message.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct
from msgspec.structs import replace

from lfield.text.suggestions import listed
from lfield.wire.fields import MAX_LABEL, Hash, OrderId, truncate
from lfield.wire.service_messages import Ballot, BallotState, BundleInfo, Vote, ballot_outcome

#: The most ballots that a host remembers to have refused without a proposal, and the most earlier ballots
#: whose votes it remembers. An undecided host that asks after so many later ballots gets a vote against: its
#: bundle is an older one in any case.
MAX_CLOSED, MAX_PAST = 128, 128
#: The reason of a vote that was asked for with `closes`.
CLOSED = "the ballot was closed before its proposal arrived"


class ActivationState(Struct, frozen=True):
    """The durable state of a host: its active bundle, the earlier ones (newest last), and its last ballot.

    `past` are the decided ballots before that, without their proposals: another host may still be bound by
    one and ask for the votes. `closed` are ids of ballots in which this host has voted no while not bound.
    """

    active: Hash = b""
    earlier: tuple[Hash, ...] = ()
    ballot: BallotState | None = None
    past: tuple[BallotState, ...] = ()
    closed: tuple[OrderId, ...] = ()

    @property
    def previous(self) -> bytes:
        """The bundle that was active before; b"" for none."""
        return self.earlier[-1] if self.earlier else b""

    @property
    def protected_bundles(self) -> list[bytes]:
        """The bundles that are never removed."""
        return [self.active, self.previous]

    @property
    def open_ballot(self) -> BallotState | None:
        """The ballot that binds this host; None if none does."""
        return self.ballot if self.ballot is not None and self.ballot.outcome == "open" else None


#: The most earlier bundles that are remembered.
MAX_EARLIER = 8


def propose(state: ActivationState, host: str, ballot: Ballot, refusal: str) -> ActivationState:
    """The state after the vote of `host` on a proposal: no for a `refusal`, yes without one.

    A repeated proposal has no effect, nor has one in which `host` does not take part.
    """
    if host not in ballot.hosts or _has_voted(state, ballot.id):
        return state
    if state.open_ballot is not None:
        return _closed(state, ballot.id)
    vote: Vote = "no" if refusal else "yes"
    reasons = {host: truncate(refusal, MAX_LABEL)} if refusal else {}
    past = state.past
    if (last := state.ballot) is not None:
        past = (*past, replace(last, ballot=None, reasons={}))[-MAX_PAST:]
    voted = BallotState(ballot.id, ballot, {}, reasons, "open")
    return _with_votes(replace(state, ballot=voted, past=past), {host: vote})


def close(state: ActivationState, id: bytes) -> ActivationState:
    """The state after a query that closes a ballot: a vote against it, unless the host has voted."""
    return state if _has_voted(state, id) else _closed(state, id)


def learn(state: ActivationState, host: str, id: bytes, votes: Mapping[str, Vote]) -> ActivationState:
    """The state after the votes of other hosts. A yes of `host` itself is only cast by `propose`.

    A no of `host` that others report was given by an operator, who assumed that `host` is lost: then they
    have aborted. A vote against a ballot whose proposal has not arrived closes it.
    """
    if state.ballot is None or state.ballot.id != id:
        return close(state, id) if "no" in votes.values() else state
    return _with_votes(state, {name: vote for name, vote in votes.items() if name != host or vote == "no"})


def answer(state: ActivationState, host: str, id: bytes) -> BallotState:
    """The votes and reasons of a ballot that are known to the host."""
    if (known := _known(state, id)) is not None:
        return known
    if id in state.closed:
        return BallotState(id, None, {host: "no"}, {host: _closed_reason(state)}, "aborted")
    return BallotState(id, None, {}, {}, "open")


def coordinators_elsewhere(mission: BundleInfo | None, hosts: Collection[str]) -> str:
    """The reason why the coordinators of a mission that has not ended may be on other hosts than these, or
    ''.
    """
    remedy = "let it end, or 'lfield stop --discard', with --without for hosts that are lost"
    if mission is None:
        return f"the mission has not ended, and its coordinators are unknown; {remedy}"
    found = [f"{agent} of {home}" for agent, home in mission.coordinators.items() if home not in hosts]
    if not found:
        return ""
    return f"the mission has not ended, and its coordinators may run elsewhere: {listed(found)}; {remedy}"


def _with_votes(state: ActivationState, votes: Mapping[str, Vote]) -> ActivationState:
    """The state after some votes of its last ballot; an activation takes effect."""
    state_of_ballot = state.ballot
    if state_of_ballot is None or state_of_ballot.ballot is None or state_of_ballot.outcome != "open":
        return state
    all_votes = state_of_ballot.votes | {
        host: vote for host, vote in votes.items() if host in state_of_ballot.ballot.hosts
    }
    result = ballot_outcome(state_of_ballot.ballot.hosts, all_votes)
    state = replace(state, ballot=replace(state_of_ballot, votes=all_votes, outcome=result))
    digest = state_of_ballot.ballot.digest
    if result != "activated" or digest == state.active:
        return state
    earlier = (*state.earlier, state.active) if state.active else state.earlier
    return replace(state, active=digest, earlier=earlier[-MAX_EARLIER:])


def _known(state: ActivationState, id: bytes) -> BallotState | None:
    """A ballot on whose proposal this host has voted."""
    return next((each for each in (state.ballot, *state.past) if each is not None and each.id == id), None)


def _has_voted(state: ActivationState, id: bytes) -> bool:
    return id in state.closed or _known(state, id) is not None


def _closed(state: ActivationState, id: bytes) -> ActivationState:
    return replace(state, closed=(*state.closed, id)[-MAX_CLOSED:])


def _closed_reason(state: ActivationState) -> str:
    bound = state.open_ballot
    if bound is None or bound.ballot is None:
        return CLOSED
    return f"an activation by {bound.ballot.by} has no result yet: repeat this one afterwards"
