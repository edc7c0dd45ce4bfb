"""Reservations of the resources of one host: grants, queues, leases, and durability before a grant."""

from __future__ import annotations

from functools import partial

import pytest

from lfield.host.team.reservations import (
    LOST,
    RESERVED,
    DenyWaiter,
    Effect,
    PersistHolder,
    ReservationDenied,
    Reservations,
    RetryWaiter,
)

PILOT, ROVER, SCOUT = ("pilot", 1), ("rover", 1), ("scout", 1)
LEASE, WAIT = 6.0, 5.0


class Desk:
    """A host whose disk writes when `write` is called."""

    def __init__(self, wait: float = WAIT) -> None:
        self.busy: set[str] = set()
        self.now = 0.0
        self.core = Reservations(100, LEASE, lambda _: wait, lambda _, agent: bool(self.busy - {agent}))

    def effects(self) -> list[Effect]:
        return self.core.drain_effects()

    def write(self, number: int, resource: str = "arm") -> None:
        self.core.on_durable(resource, number, self.now)

    def has(self, start: tuple[str, int], now: float) -> int:
        """Reserve a free resource."""
        self.now = now
        assert self.core.acquire(start, "arm", now, nested=False) == 0
        number = next(e.number for e in self.effects() if isinstance(e, PersistHolder) and e.holder == start)
        self.write(number)
        self.effects()
        assert self.core.acquire(start, "arm", now, nested=False) == number
        return number


@pytest.fixture
def desk() -> Desk:
    return Desk()


def refused(desk: Desk, kind: str, words: str, *asked: object) -> None:
    with pytest.raises(ReservationDenied, match=words) as found:
        desk.core.may_serve(*asked)  # type: ignore[arg-type]
    assert found.value.kind == kind


def test_a_number_is_granted_only_after_its_record_is_durable(desk: Desk) -> None:
    assert desk.core.acquire(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == [PersistHolder("arm", 101, PILOT, is_lazy=False)]
    assert desk.core.acquire(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == []
    desk.write(101)
    assert desk.effects() == [RetryWaiter(PILOT)]
    assert desk.core.acquire(PILOT, "arm", 0.1, nested=False) == 101


def test_only_its_holder_is_served_and_only_by_its_number(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.may_serve(PILOT, "arm", number, 1.0)
    refused(desk, LOST, "no longer reserved for pilot", PILOT, "arm", number - 1, 1.0)
    assert not desk.core.may_serve(ROVER, "arm", 0, 1.0)
    refused(desk, LOST, "was reserved by pilot 1.0 s ago", ROVER, "arm", 7, 1.0)


def test_a_former_holder_is_informed_of_the_later_reservation(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(ROVER, 7.0) == number + 1
    desk.core.release("arm", number + 1, 9.0)
    refused(
        desk,
        LOST,
        "arm was reserved by rover since, and that reservation ended 2.5 s ago",
        PILOT,
        "arm",
        number,
        11.5,
    )
    refused(desk, LOST, "ended 2.5 s ago: it has left the block", ROVER, "arm", number + 1, 11.5)


def test_without_a_reservation_every_start_is_served(desk: Desk) -> None:
    assert desk.core.may_serve(ROVER, "arm", 0, 0.0)
    assert not desk.core.is_contended("arm")


def test_waiting_starts_are_denied_with_the_holder_after_the_wait(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.may_serve(ROVER, "arm", 0, 1.0)
    assert desk.core.acquire(SCOUT, "arm", 2.0, nested=False) == 0
    desk.core.renew(PILOT, "arm", number, 4.0)
    desk.core.tick(6.0)
    assert desk.effects() == [RetryWaiter(ROVER)]
    refused(desk, RESERVED, "arm is reserved by pilot for 6.0 s", ROVER, "arm", 0, 6.0)
    desk.core.tick(7.0)
    assert desk.effects() == [DenyWaiter(SCOUT, "arm", "arm is reserved by pilot for 7.0 s")]


def test_a_nested_request_does_not_wait(desk: Desk) -> None:
    desk.has(PILOT, 0.0)
    for nested in (desk.core.acquire, partial(desk.core.may_serve, number=0)):
        with pytest.raises(ReservationDenied, match=r"arm is reserved by pilot for 1\.0 s") as found:
            nested(ROVER, "arm", now=1.0, nested=True)
        assert found.value.kind == RESERVED
    assert desk.core.waits_for(ROVER) == ""


def test_waiting_starts_are_served_in_order(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.may_serve(ROVER, "arm", 0, 1.0)
    assert desk.core.acquire(SCOUT, "arm", 1.1, nested=False) == 0
    desk.core.release("arm", number, 2.0)
    assert desk.effects() == [PersistHolder("arm", number, None, is_lazy=True), RetryWaiter(ROVER)]
    desk.core.tick(2.0)
    assert desk.effects() == []
    assert desk.core.may_serve(ROVER, "arm", 0, 2.0)
    desk.busy = {"rover"}
    desk.core.tick(2.1)
    assert desk.effects() == []
    desk.busy = set()
    desk.core.tick(2.2)
    assert desk.effects() == [PersistHolder("arm", number + 1, SCOUT, is_lazy=False)]


def test_a_waiting_caller_that_does_not_call_delays_others_only_shortly(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.may_serve(ROVER, "arm", 0, 1.0)
    assert desk.core.acquire(SCOUT, "arm", 1.0, nested=False) == 0
    desk.core.release("arm", number, 2.0)
    desk.effects()
    desk.core.tick(3.0)
    assert desk.effects() == [PersistHolder("arm", number + 1, SCOUT, is_lazy=False)]


def test_a_call_waits_behind_a_waiting_reservation(desk: Desk) -> None:
    desk.busy = {"rover"}
    assert desk.core.acquire(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == []
    assert not desk.core.may_serve(SCOUT, "arm", 0, 0.1)
    desk.core.tick(5.0)
    assert desk.effects() == [
        DenyWaiter(PILOT, "arm", "arm is executing calls of others, and can be reserved only after these"),
        RetryWaiter(SCOUT),
    ]
    assert desk.core.may_serve(SCOUT, "arm", 0, 5.0)


def test_with_a_wait_of_zero_requests_are_denied_at_once() -> None:
    desk = Desk(wait=0.0)
    desk.has(PILOT, 0.0)
    with pytest.raises(ReservationDenied, match="reserved by pilot"):
        desk.core.acquire(ROVER, "arm", 1.0, nested=False)
    refused(desk, RESERVED, "reserved by pilot", ROVER, "arm", 0, 1.0)


def test_a_reservation_ends_with_its_lease(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.due == LEASE
    desk.core.renew(PILOT, "arm", number, 2.0)
    assert desk.core.due == 2.0 + LEASE
    desk.core.tick(8.0)
    assert desk.effects() == [PersistHolder("arm", number, None, is_lazy=True)]
    text = r"the reservation of arm ended 3.0 s ago: its lease has expired"
    refused(desk, LOST, text, PILOT, "arm", number, 11.0)
    assert desk.core.may_serve(ROVER, "arm", 0, 11.0)


def test_a_late_or_foreign_renewal_has_no_effect(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    desk.core.renew(("pilot", 2), "arm", number, 5.0)
    desk.core.renew(PILOT, "arm", number + 1, 5.0)
    desk.core.renew(PILOT, "arm", number, 6.0)
    refused(desk, LOST, "its lease has expired", PILOT, "arm", number, 6.0)


def test_a_call_with_the_number_renews_the_lease(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.may_serve(PILOT, "arm", number, 5.0)
    assert desk.core.may_serve(PILOT, "arm", number, 10.0)


def test_a_call_without_the_number_ends_the_reservation(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.may_serve(PILOT, "arm", 0, 1.0)
    assert desk.core.held == {}
    refused(desk, LOST, "it has left the block", PILOT, "arm", number, 1.0)


def test_a_repeated_request_gets_a_new_number_that_old_releases_do_not_end(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(PILOT, 1.0) == number + 1
    desk.core.release("arm", number, 1.1)
    assert desk.core.may_serve(PILOT, "arm", number + 1, 1.2)


def test_a_later_start_takes_over_and_an_earlier_one_waits(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(("pilot", 2), 1.0) == number + 1
    refused(desk, LOST, "was reserved by pilot", PILOT, "arm", number, 1.0)
    assert desk.core.acquire(PILOT, "arm", 1.0, nested=False) == 0
    assert desk.effects() == []


def test_an_earlier_start_that_waits_for_its_record_is_denied_for_a_later_one(desk: Desk) -> None:
    assert desk.core.acquire(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.core.acquire(("pilot", 2), "arm", 0.1, nested=False) == 0
    assert desk.effects() == [
        PersistHolder("arm", 101, PILOT, is_lazy=False),
        DenyWaiter(PILOT, "arm", "arm is reserved by a later start of pilot"),
        PersistHolder("arm", 102, ("pilot", 2), is_lazy=False),
    ]
    desk.write(101)
    assert desk.effects() == []


def test_a_reservation_ends_with_its_holder(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.acquire(ROVER, "arm", 1.0, nested=False) == 0
    desk.core.on_start_ended(PILOT, "pilot has ended (died)", 2.0)
    assert desk.effects() == [
        PersistHolder("arm", number, None, is_lazy=True),
        PersistHolder("arm", number + 1, ROVER, is_lazy=False),
    ]
    desk.core.on_start_ended(ROVER, "rover has ended (done)", 2.0)
    assert desk.core.concerned == set()


def test_an_abandoned_wait_gets_no_reservation(desk: Desk) -> None:
    assert desk.core.acquire(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.core.acquire(ROVER, "arm", 0.0, nested=False) == 0
    assert desk.core.abandon_wait(PILOT, 1.0)
    desk.write(101)
    assert desk.effects()[1:] == [
        PersistHolder("arm", 101, None, is_lazy=True),
        PersistHolder("arm", 102, ROVER, is_lazy=False),
    ]
    assert desk.core.abandon_wait(ROVER, 1.0)
    assert not desk.core.abandon_wait(ROVER, 1.0)


def test_a_restored_reservation_lasts_for_one_lease(desk: Desk) -> None:
    desk.core.restore("arm", 41, PILOT, 0.0)
    desk.core.restore("leg", 7, None, 0.0)
    assert desk.core.may_serve(PILOT, "arm", 41, 1.0)
    assert desk.core.acquire(ROVER, "arm", 2.0, nested=False) == 0
    assert desk.effects() == []
    desk.core.tick(7.0)
    assert PersistHolder("arm", 42, ROVER, is_lazy=False) in desk.effects()
    assert desk.core.acquire(ROVER, "leg", 7.0, nested=False) == 0
    assert desk.effects() == [PersistHolder("leg", 8, ROVER, is_lazy=False)]


def test_a_holder_keeps_its_reservation_for_one_lease_after_a_pause(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    desk.core.postpone(100.0)
    desk.core.tick(100.0 + LEASE - 0.1)
    assert desk.core.may_serve(PILOT, "arm", number, 100.0 + LEASE - 0.1)
    desk.core.tick(100.0 + 3 * LEASE)
    assert desk.core.holder_of("arm") is None


def test_a_waiting_start_gets_its_full_wait_after_a_pause(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.acquire(ROVER, "arm", 1.0, nested=False) == 0
    desk.core.renew(PILOT, "arm", number, 5.0)
    desk.core.postpone(10.0)
    desk.core.renew(PILOT, "arm", number, 10.0)
    desk.core.tick(10.0)
    assert not [effect for effect in desk.effects() if isinstance(effect, DenyWaiter)]
