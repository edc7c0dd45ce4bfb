"""Services that do not listen for a while: requests of the operator, and a ballot, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from lfield.cli.fleet.push import service_states
from lfield.errors import AddressError, NoListener
from lfield.operator.fleet.activation import VOTE_TIMEOUT, BallotResult, activate, new_ballot
from lfield.operator.fleet.service_link import RESTART_TIME, ServiceLinks
from lfield.service import ballots
from lfield.service.ballots import ActivationState
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.service_messages import BallotState, Proposal, VoteQuery, VoteReport

HOSTS = ["alpha", "bravo"]


class ServiceState:
    """One service: its answers, and when (s after the start of the loop) it does not listen."""

    def __init__(self, host: str, away: tuple[float, float] = (0.0, 0.0)) -> None:
        self._host, self._away = host, away
        self._state = ActivationState()

    def require_listening(self) -> None:
        start, end = self._away
        if start <= elapsed() < end:
            raise NoListener(self._host)

    async def ask(self, message: Any, kind: type, within: float) -> BallotState:
        await asyncio.sleep(0.5)
        # A restart breaks its links.
        self.require_listening()
        match message:
            case Proposal(ballot):
                self._state = ballots.propose(self._state, self._host, ballot, "")
                return ballots.answer(self._state, self._host, ballot.id)
            case VoteQuery(id, True):
                self._state = ballots.close(self._state, id)
            case VoteReport(id, votes):
                self._state = ballots.learn(self._state, self._host, id, votes)
        return ballots.answer(self._state, self._host, message.id)


class DirectLinks(ServiceLinks):
    """Links without a network."""

    def __init__(self, *services: ServiceState) -> None:
        super().__init__(None, {}, None)  # type: ignore[arg-type]
        self._services = dict(zip(HOSTS, services, strict=True))

    @asynccontextmanager
    async def link(self, host: str) -> AsyncIterator[Any]:
        self._services[host].require_listening()
        yield self._services[host]


def elapsed() -> float:
    """Seconds since the start of the loop (`jumping_loop`)."""
    return asyncio.get_running_loop().time() - 1000.0


async def answered(away: tuple[float, float], restart: float) -> float:
    """The time of the answer of a service."""
    links = DirectLinks(ServiceState("alpha"), ServiceState("bravo", away))
    await links.ask("bravo", VoteQuery(bytes(16)), BallotState, 60.0, restart=restart)
    return elapsed()


def test_a_restarting_service_is_asked_again_for_a_bounded_time() -> None:
    assert 2.0 <= run_jumping(answered((0.0, 2.0), RESTART_TIME)) < 4.0
    with pytest.raises(NoListener):
        run_jumping(answered((0.0, 2.0), 0.0))
    with pytest.raises(NoListener):
        run_jumping(answered((0.0, 50.0), RESTART_TIME))


async def first_states(away: tuple[float, float]) -> tuple[Any, float]:
    """The first state that a push receives from a service, and the time."""
    links = DirectLinks(ServiceState("alpha"), ServiceState("bravo", away))
    return (await service_states(links, ["bravo"]))["bravo"], elapsed()


def test_a_push_does_not_wait_for_a_service_that_never_listened() -> None:
    """A service that has answered is asked again: it is restarting."""
    found, end = run_jumping(first_states((0.0, 50.0)))
    assert isinstance(found, NoListener)
    assert end < 1.5


async def result(*away: tuple[float, float]) -> tuple[BallotResult, float]:
    """The result of a ballot, and its time."""
    links = DirectLinks(*(ServiceState(host, each) for host, each in zip(HOSTS, away, strict=True)))
    found = await activate(links, new_ballot(bytes(32), HOSTS, "anna"))
    return found, elapsed()


@pytest.mark.parametrize("start", [0.0, 0.2, 0.6])
def test_a_service_that_restarts_during_the_vote_still_votes(start: float) -> None:
    found, end = run_jumping(result((0.0, 0.0), (start, start + 3.0)))
    assert (found.outcome, sorted(found.informed), found.unreached) == ("activated", HOSTS, {})
    assert end < 6.0


def test_a_late_service_votes_no_and_its_reason_is_reported() -> None:
    found, _ = run_jumping(result((0.0, 0.0), (0.0, VOTE_TIMEOUT + 5.0)))
    assert (found.outcome, found.votes) == ("aborted", {"alpha": "yes", "bravo": "no"})
    assert isinstance(found.late["bravo"], AddressError)
    assert found.unreached == {}


def test_a_missing_service_leaves_the_ballot_open_with_its_error() -> None:
    found, _ = run_jumping(result((0.0, 0.0), (0.0, 1000.0)))
    assert (found.outcome, list(found.unreached)) == ("open", ["bravo"])
