"""The hold of a vote, and the pause of a person: neither ends the other."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest

from lfield.authority.identity import ALL_RIGHTS, NO_RIGHTS, Identity
from lfield.authority.peer_verification import ALLOWED
from lfield.authority.rights import missing_permission
from lfield.net.transport import Link
from lfield.wire.observer_messages import BallotHold, EmergencyStopResult, Pause, with_epoch

FLIGHT = Path(__file__).parents[3] / "examples/01-first-flight/mission.dL"
LOCAL = Identity("local", "lfield", ALL_RIGHTS)
FIRST, SECOND = bytes([1]) * 16, bytes([2]) * 16


class Sender:
    """An observer of a host, which keeps its answers."""

    peer = "the test"

    def __init__(self, who: Identity) -> None:
        self.identity, self.answers = who, list[Any]()

    def send(self, message: Any) -> None:
        self.answers.append(message)


class Team:
    """The two hosts of a flight, with a service and a person at alpha."""

    def __init__(self, team: Any) -> None:
        self.team = team
        self.service, self.person = Sender(LOCAL), Sender(Identity("person", "anna", ALL_RIGHTS))
        self._orders = 0

    @property
    def host(self) -> Any:
        return self.team._fleet.runs["alpha"].host

    def _send(self, message: Any, sender: Sender) -> EmergencyStopResult | None:
        life, count = self.team._fleet.runs["alpha"], len(sender.answers)
        life.process.loop.enter(partial(self.host.on_message, "", message, cast("Link", sender)))
        self.team.run(8.0)
        return sender.answers[-1] if len(sender.answers) > count else None

    def hold(self, ballot: bytes, *, lift: bool = False) -> EmergencyStopResult | None:
        return self._send(BallotHold(ballot, lift), self.service)

    def pause(self, *, lift: bool = False) -> EmergencyStopResult | None:
        self._orders += 1
        order = Pause(self._orders.to_bytes(16), lift)
        return self._send(with_epoch(order, self.host.core.orders.epochs), self.person)

    @property
    def pauses(self) -> tuple[bool, bool]:
        """The reported pauses: a pause of a person, a hold of a ballot."""
        status = self.host.status()
        return status.paused, bool(status.ballot)

    @property
    def latched(self) -> bool:
        return "lead.fc" in self.host.guards.latched

    @property
    def is_airborne(self) -> bool:
        return bool(self.team.fake("lead.fc").facts["airborne"])


@pytest.fixture
def flight(lfield_mission: Callable[..., Any]) -> Team:
    """The team before the first take-off: lead waits until it is ready."""
    made = lfield_mission(FLIGHT)
    made.run(2.0)
    return Team(made)


def test_a_resume_of_a_person_does_not_end_the_hold_of_a_vote(flight: Team) -> None:
    assert flight.hold(FIRST) is not None
    assert (flight.pauses, flight.latched) == ((False, True), True)
    resumed = flight.pause(lift=True)
    assert resumed is not None
    assert (flight.pauses, flight.latched) == ((False, True), True)
    flight.team.run(30.0)
    assert not flight.is_airborne
    assert flight.hold(FIRST, lift=True) is not None
    assert flight.pauses == (False, False)
    flight.team.run(until=lambda: flight.is_airborne)


@pytest.mark.few(0)
@pytest.mark.parametrize("pauses_first", [True, False], ids=["pause before", "pause after"])
def test_the_end_of_a_hold_does_not_end_the_pause_of_a_person(flight: Team, pauses_first: bool) -> None:
    if pauses_first:
        flight.pause()
    flight.hold(FIRST)
    if not pauses_first:
        flight.pause()
    assert flight.pauses == (True, True)
    flight.hold(FIRST, lift=True)
    assert (flight.pauses, flight.latched) == ((True, False), True)
    flight.team.run(30.0)
    assert not flight.is_airborne
    resumed = flight.pause(lift=True)
    assert resumed is not None
    assert (resumed.trouble, flight.pauses, flight.latched) == ("", (False, False), False)
    flight.team.run(until=lambda: flight.is_airborne)


@pytest.mark.few(0)
def test_a_resume_during_a_hold_ends_the_pause_and_names_the_hold(flight: Team) -> None:
    flight.pause()
    flight.hold(FIRST)
    resumed = flight.pause(lift=True)
    assert resumed is not None
    assert resumed.trouble
    assert (flight.pauses, flight.latched) == ((False, True), True)
    flight.hold(FIRST, lift=True)
    assert (flight.pauses, flight.latched) == ((False, False), False)


@pytest.mark.few(0)
def test_the_end_of_an_earlier_ballot_does_not_end_the_hold_of_a_later_one(flight: Team) -> None:
    flight.hold(FIRST)
    flight.hold(SECOND)
    flight.hold(FIRST, lift=True)
    assert (flight.pauses, flight.latched) == ((False, True), True)
    flight.hold(SECOND, lift=True)
    assert (flight.pauses, flight.latched) == ((False, False), False)


def test_only_a_local_service_may_hold_a_host() -> None:
    person = Identity("person", "anna", ALL_RIGHTS)
    for message in (BallotHold(FIRST), BallotHold(FIRST, lift=True)):
        assert missing_permission(person, ALLOWED, message)
        assert missing_permission(Identity("host", "bravo", NO_RIGHTS), ALLOWED, message)
        assert not missing_permission(LOCAL, ALLOWED, message)
