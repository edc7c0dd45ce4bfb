"""Ballots of up to four hosts in all orders of messages: lost, repeated, late, and with restarts.

A host consists of its stored state: a restart loses only messages. So every sent message may arrive at any
time, any number of times.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import product

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.service import ballots
from lfield.service.ballots import ActivationState
from lfield.wire.service_messages import Ballot, BallotOutcome, Vote

NAMES = ["alpha", "bravo", "carol", "delta"]


def ballot(number: int, hosts: Iterable[str]) -> Ballot:
    return Ballot(number.to_bytes(16), bytes([number]) * 32, list(hosts), "anna")


def own_vote(state: ActivationState, host: str, id: bytes) -> Vote | None:
    return ballots.answer(state, host, id).votes.get(host)


@dataclass
class Team:
    """Hosts by name, the proposals of desks, and the answers of each host to them."""

    states: dict[str, ActivationState]
    proposals: list[Ballot]
    outcomes: dict[bytes, BallotOutcome] = field(default_factory=dict)

    def change(self, host: str, state: ActivationState) -> None:
        """Store a state of a host. Decisions and votes do not change on any host."""
        before, self.states[host] = self.states[host], state
        for proposal in self.proposals:
            vote = own_vote(before, host, proposal.id)
            assert vote in (None, own_vote(state, host, proposal.id)), f"{host} changed its vote"
            known = ballots.answer(state, host, proposal.id)
            if known.outcome != "open":
                assert self.outcomes.setdefault(proposal.id, known.outcome) == known.outcome
            if known.outcome == "activated":
                for other in proposal.hosts:
                    assert own_vote(self.states[other], other, proposal.id) == "yes"
        if vote_binds(state):
            assert state.active == before.active

    def query(self, host: str, other: str, id: bytes, *, closes: bool) -> dict[str, Vote]:
        """The answer of another host."""
        if closes:
            self.change(other, ballots.close(self.states[other], id))
        return ballots.answer(self.states[other], other, id).votes

    def learn(self, host: str, id: bytes, votes: dict[str, Vote]) -> None:
        self.change(host, ballots.learn(self.states[host], host, id, votes))

    def meet(self) -> None:
        """Connect all hosts: every bound host queries all others and closes its ballot."""
        for host in list(self.states):
            if (bound := self.states[host].open_ballot) is not None:
                for other in bound.missing:
                    self.learn(host, bound.id, self.query(host, other, bound.id, closes=True))
        assert [host for host, state in self.states.items() if state.open_ballot is not None] == []


def vote_binds(state: ActivationState) -> bool:
    bound = state.open_ballot
    if bound is None:
        return False
    assert "no" not in bound.votes.values()
    return True


def steps(team: Team) -> Iterator[tuple[str, ...] | tuple[str, str, int, bool]]:
    """The possible next steps: a proposal arrives; a bound host asks; an answer is lost after a close."""
    for host, (number, proposal) in product(team.states, enumerate(team.proposals)):
        if host in proposal.hosts and own_vote(team.states[host], host, proposal.id) is None:
            yield "propose", host, str(number)
            yield "refuse", host, str(number)
    for host, state in team.states.items():
        if (bound := state.open_ballot) is not None:
            for other in bound.missing:
                for closes in ("", "closes"):
                    yield "ask", host, other, closes
                yield "lost", host, other, "closes"


def perform(team: Team, step: tuple) -> None:  # type: ignore[type-arg]
    match step:
        case ("propose" | "refuse" as what, host, number):
            proposal = team.proposals[int(number)]
            refusal = "it flies" if what == "refuse" else ""
            team.change(host, ballots.propose(team.states[host], host, proposal, refusal))
        case (what, host, other, closes):
            bound = team.states[host].open_ballot
            assert bound is not None
            votes = team.query(host, other, bound.id, closes=bool(closes))
            if what == "ask":
                team.learn(host, bound.id, votes)


@pytest.mark.parametrize(
    ("hosts", "sets"),
    [
        (2, [NAMES[:2]]),
        (3, [NAMES[:3]]),
        (2, [NAMES[:2], NAMES[:2]]),
        (3, [NAMES[:3], NAMES[:2]]),
    ],
    ids=["two", "three", "two ballots", "one without a host"],
)
def test_all_message_orders_of_a_small_team_agree_and_end(hosts: int, sets: list[list[str]]) -> None:
    proposals = [ballot(number, some) for number, some in enumerate(sets, 1)]
    start = {name: ActivationState() for name in NAMES[:hosts]}
    known = set[bytes]()
    queue = [(start, dict[bytes, BallotOutcome]())]
    while queue:
        states, outcomes = queue.pop()
        Team(dict(states), proposals, dict(outcomes)).meet()
        for step in steps(Team(states, proposals)):
            team = Team(dict(states), proposals, dict(outcomes))
            perform(team, step)
            key = msgspec.msgpack.encode((team.states, sorted(team.outcomes.items())))
            if key not in known:
                known.add(key)
                queue.append((team.states, team.outcomes))
    assert len(known) > 10


@st.composite
def scenarios(draw: st.DrawFn) -> tuple[int, list[list[str]], list[tuple[int, int, int, int]]]:
    hosts = draw(st.integers(1, 4))
    names = NAMES[:hosts]
    sets = draw(
        st.lists(
            st.lists(st.sampled_from(names), min_size=1, unique=True).map(sorted), min_size=1, max_size=3
        )
    )
    number = st.integers(0, 3)
    return hosts, sets, draw(st.lists(st.tuples(number, number, number, number), max_size=60))


@pytest.mark.few(0)
@given(scenarios())
@settings(max_examples=1000)
def test_late_repeated_and_lost_messages_give_one_outcome(
    scenario: tuple[int, list[list[str]], list[tuple[int, int, int, int]]],
) -> None:
    hosts, sets, events = scenario
    names = NAMES[:hosts]
    team = Team(
        {name: ActivationState() for name in names},
        [ballot(number, some) for number, some in enumerate(sets, 1)],
    )
    sent: list[tuple[bytes, dict[str, Vote]]] = []
    for kind, first, second, third in events:
        host, other = names[first % hosts], names[second % hosts]
        proposal = team.proposals[third % len(sets)]
        if kind == 0 and host in proposal.hosts:
            refusal = "it flies" if second == 3 else ""
            team.change(host, ballots.propose(team.states[host], host, proposal, refusal))
        elif kind in (1, 2) and host in proposal.hosts:
            sent.append((proposal.id, team.query(other, host, proposal.id, closes=kind == 2)))
        elif kind == 3 and sent:
            # An answer of any age, delivered to any host, also as the report of a desk.
            id, votes = sent[(second * 4 + third) % len(sent)]
            if host in next(each for each in team.proposals if each.id == id).hosts:
                team.learn(host, id, votes)
    team.meet()
