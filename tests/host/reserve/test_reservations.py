"""Who has a resource of one host: grants, queues, leases, and what is on the disk before it is told."""

from __future__ import annotations

from functools import partial

import pytest

from lfield.host.team.reservations import (
    LOST,
    RESERVED,
    Effect,
    Let,
    Refuse,
    Refused,
    Reservations,
    Write,
)

PILOT, ROVER, SCOUT = ("pilot", 1), ("rover", 1), ("scout", 1)
LEASE, WAIT = 6.0, 5.0


class Desk:
    """A host whose disk is as fast as `write` is called."""

    def __init__(self, wait: float = WAIT) -> None:
        self.busy: set[str] = set()
        self.now = 0.0
        self.core = Reservations(100, LEASE, lambda _: wait, lambda _, agent: bool(self.busy - {agent}))

    def effects(self) -> list[Effect]:
        return self.core.take_effects()

    def write(self, number: int, resource: str = "arm") -> None:
        self.core.written(resource, number, self.now)

    def has(self, start: tuple[str, int], now: float) -> int:
        """Reserve what is free."""
        self.now = now
        assert self.core.take(start, "arm", now, nested=False) == 0
        number = next(e.number for e in self.effects() if isinstance(e, Write) and e.holder == start)
        self.write(number)
        self.effects()
        assert self.core.take(start, "arm", now, nested=False) == number
        return number


@pytest.fixture
def desk() -> Desk:
    return Desk()


def refused(desk: Desk, kind: str, words: str, *asked: object) -> None:
    with pytest.raises(Refused, match=words) as found:
        desk.core.serves(*asked)  # type: ignore[arg-type]
    assert found.value.kind == kind


def test_a_number_is_told_when_its_page_is_on_the_disk(desk: Desk) -> None:
    assert desk.core.take(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == [Write("arm", 101, PILOT, soon=False)]
    assert desk.core.take(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == []
    desk.write(101)
    assert desk.effects() == [Let(PILOT)]
    assert desk.core.take(PILOT, "arm", 0.1, nested=False) == 101


def test_only_its_holder_is_served_and_only_by_its_number(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.serves(PILOT, "arm", number, 1.0)
    refused(desk, LOST, "reserved for pilot no more", PILOT, "arm", number - 1, 1.0)
    assert not desk.core.serves(ROVER, "arm", 0, 1.0)
    refused(desk, LOST, "was reserved by pilot since, 1.0 s ago", ROVER, "arm", 7, 1.0)


def test_who_comes_after_another_has_had_it_hears_of_that(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(ROVER, 7.0) == number + 1
    desk.core.release("arm", number + 1, 9.0)
    refused(
        desk,
        LOST,
        "arm was reserved by rover since, and that has ended 2.5 s ago",
        PILOT,
        "arm",
        number,
        11.5,
    )
    refused(desk, LOST, "ended 2.5 s ago: it has left the block", ROVER, "arm", number + 1, 11.5)


def test_nobody_has_it_and_everybody_is_served(desk: Desk) -> None:
    assert desk.core.serves(ROVER, "arm", 0, 0.0)
    assert not desk.core.concerns("arm")


def test_others_wait_and_are_told_who_has_it(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.serves(ROVER, "arm", 0, 1.0)
    assert desk.core.take(SCOUT, "arm", 2.0, nested=False) == 0
    desk.core.renew(PILOT, "arm", number, 4.0)
    desk.core.tick(6.0)
    assert desk.effects() == [Let(ROVER)]
    refused(desk, RESERVED, "arm is reserved by pilot for 6.0 s", ROVER, "arm", 0, 6.0)
    desk.core.tick(7.0)
    assert desk.effects() == [Refuse(SCOUT, "arm", "arm is reserved by pilot for 7.0 s")]


def test_who_has_something_else_does_not_wait(desk: Desk) -> None:
    desk.has(PILOT, 0.0)
    for nested in (desk.core.take, partial(desk.core.serves, number=0)):
        with pytest.raises(Refused, match=r"arm is reserved by pilot for 1\.0 s"):
            nested(ROVER, "arm", now=1.0, nested=True)
    assert desk.core.waits_for(ROVER) == ""


def test_first_come_first_served(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.serves(ROVER, "arm", 0, 1.0)
    assert desk.core.take(SCOUT, "arm", 1.1, nested=False) == 0
    desk.core.release("arm", number, 2.0)
    assert desk.effects() == [Write("arm", number, None, soon=True), Let(ROVER)]
    desk.core.tick(2.0)
    assert desk.effects() == []
    assert desk.core.serves(ROVER, "arm", 0, 2.0)
    desk.busy = {"rover"}
    desk.core.tick(2.1)
    assert desk.effects() == []
    desk.busy = set()
    desk.core.tick(2.2)
    assert desk.effects() == [Write("arm", number + 1, SCOUT, soon=False)]


def test_who_may_call_and_does_not_keeps_nobody_waiting_for_long(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert not desk.core.serves(ROVER, "arm", 0, 1.0)
    assert desk.core.take(SCOUT, "arm", 1.0, nested=False) == 0
    desk.core.release("arm", number, 2.0)
    desk.effects()
    desk.core.tick(3.0)
    assert desk.effects() == [Write("arm", number + 1, SCOUT, soon=False)]


def test_a_call_waits_behind_who_waits_to_reserve(desk: Desk) -> None:
    desk.busy = {"rover"}
    assert desk.core.take(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.effects() == []
    assert not desk.core.serves(SCOUT, "arm", 0, 0.1)
    desk.core.tick(5.0)
    assert desk.effects() == [
        Refuse(PILOT, "arm", "arm is at work for others, and cannot be reserved before that is done"),
        Let(SCOUT),
    ]
    assert desk.core.serves(SCOUT, "arm", 0, 5.0)


def test_nested_never_waits(desk: Desk) -> None:
    desk.has(PILOT, 0.0)
    with pytest.raises(Refused, match=r"arm is reserved by pilot for 1\.0 s") as found:
        desk.core.take(ROVER, "arm", 1.0, nested=True)
    assert found.value.kind == RESERVED
    assert desk.core.waits_for(ROVER) == ""


def test_where_nobody_is_to_wait_nobody_does() -> None:
    desk = Desk(wait=0.0)
    desk.has(PILOT, 0.0)
    with pytest.raises(Refused, match="reserved by pilot"):
        desk.core.take(ROVER, "arm", 1.0, nested=False)
    refused(desk, RESERVED, "reserved by pilot", ROVER, "arm", 0, 1.0)


def test_it_ends_with_its_lease(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.due == LEASE
    desk.core.renew(PILOT, "arm", number, 2.0)
    assert desk.core.due == 2.0 + LEASE
    desk.core.tick(8.0)
    assert desk.effects() == [Write("arm", number, None, soon=True)]
    words = r"the reservation of arm has ended 3.0 s ago: its lease was over"
    refused(desk, LOST, words, PILOT, "arm", number, 11.0)
    assert desk.core.serves(ROVER, "arm", 0, 11.0)


def test_a_renewal_that_comes_too_late_or_of_another_renews_nothing(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    desk.core.renew(("pilot", 2), "arm", number, 5.0)
    desk.core.renew(PILOT, "arm", number + 1, 5.0)
    desk.core.renew(PILOT, "arm", number, 6.0)
    refused(desk, LOST, "its lease was over", PILOT, "arm", number, 6.0)


def test_a_call_is_a_sign_of_its_holder(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.serves(PILOT, "arm", number, 5.0)
    assert desk.core.serves(PILOT, "arm", number, 10.0)


def test_a_call_without_the_number_is_made_outside_of_the_block(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.serves(PILOT, "arm", 0, 1.0)
    assert desk.core.held == {}
    refused(desk, LOST, "it has left the block", PILOT, "arm", number, 1.0)


def test_who_asks_again_for_what_it_has_got_gets_a_number_that_no_old_word_ends(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(PILOT, 1.0) == number + 1
    desk.core.release("arm", number, 1.1)
    assert desk.core.serves(PILOT, "arm", number + 1, 1.2)


def test_a_later_start_takes_over_and_an_earlier_one_waits(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.has(("pilot", 2), 1.0) == number + 1
    refused(desk, LOST, "was reserved by pilot since", PILOT, "arm", number, 1.0)
    assert desk.core.take(PILOT, "arm", 1.0, nested=False) == 0
    assert desk.effects() == []


def test_an_earlier_start_that_waits_for_its_page_hears_of_the_later_one(desk: Desk) -> None:
    assert desk.core.take(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.core.take(("pilot", 2), "arm", 0.1, nested=False) == 0
    assert desk.effects() == [
        Write("arm", 101, PILOT, soon=False),
        Refuse(PILOT, "arm", "arm is reserved by a later start of pilot"),
        Write("arm", 102, ("pilot", 2), soon=False),
    ]
    desk.write(101)
    assert desk.effects() == []


def test_it_ends_with_its_holder(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.take(ROVER, "arm", 1.0, nested=False) == 0
    desk.core.over(PILOT, "pilot has ended (died)", 2.0)
    assert desk.effects() == [
        Write("arm", number, None, soon=True),
        Write("arm", number + 1, ROVER, soon=False),
    ]
    desk.core.over(ROVER, "rover has ended (done)", 2.0)
    assert desk.core.concerned == set()


def test_who_gives_up_has_not_got_it(desk: Desk) -> None:
    assert desk.core.take(PILOT, "arm", 0.0, nested=False) == 0
    assert desk.core.take(ROVER, "arm", 0.0, nested=False) == 0
    assert desk.core.give_up(PILOT, 1.0)
    desk.write(101)
    assert desk.effects()[1:] == [
        Write("arm", 101, None, soon=True),
        Write("arm", 102, ROVER, soon=False),
    ]
    assert desk.core.give_up(ROVER, 1.0)
    assert not desk.core.give_up(ROVER, 1.0)


def test_what_the_disk_has_goes_on_for_one_lease(desk: Desk) -> None:
    desk.core.restore("arm", 41, PILOT, 0.0)
    desk.core.restore("leg", 7, None, 0.0)
    assert desk.core.serves(PILOT, "arm", 41, 1.0)
    assert desk.core.take(ROVER, "arm", 2.0, nested=False) == 0
    assert desk.effects() == []
    desk.core.tick(7.0)
    assert Write("arm", 42, ROVER, soon=False) in desk.effects()
    assert desk.core.take(ROVER, "leg", 7.0, nested=False) == 0
    assert desk.effects() == [Write("leg", 8, ROVER, soon=False)]


def test_who_has_something_through_a_pause_keeps_it_for_one_more_lease(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    desk.core.postpone(100.0)
    desk.core.tick(100.0 + LEASE - 0.1)
    assert desk.core.serves(PILOT, "arm", number, 100.0 + LEASE - 0.1)
    desk.core.tick(100.0 + 3 * LEASE)
    assert desk.core.of("arm") is None


def test_who_waits_through_a_pause_has_all_its_time_again(desk: Desk) -> None:
    number = desk.has(PILOT, 0.0)
    assert desk.core.take(ROVER, "arm", 1.0, nested=False) == 0
    desk.core.renew(PILOT, "arm", number, 5.0)
    desk.core.postpone(10.0)
    desk.core.renew(PILOT, "arm", number, 10.0)
    desk.core.tick(10.0)
    assert not [effect for effect in desk.effects() if isinstance(effect, Refuse)]
