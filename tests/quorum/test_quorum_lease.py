"""A lease holds while a majority has acknowledged what was sent less than its length ago."""

from __future__ import annotations

import pytest

from lfield.quorum.lease import Lease
from lfield.quorum.members import Members


def lease(names: str, here: str) -> Lease:
    return Lease(Members(names, here, 2.0))


def test_a_new_life_holds_none() -> None:
    assert not lease("abc", "a").holds(0.0)


def test_it_counts_from_when_a_heartbeat_was_sent_however_late_the_answer_is() -> None:
    mine = lease("abc", "a")
    number = mine.beat(10.0)
    mine.acknowledged("b", number)
    assert mine.holds(11.99)
    assert not mine.holds(12.0)


@pytest.mark.parametrize(
    ("names", "here", "needed"),
    [("abc", "a", 1), ("abcd", "a", 2), ("abcde", "a", 2), ("abc", "x", 2), ("a", "x", 1)],
)
def test_a_majority_of_the_members_is_needed_and_a_member_counts_itself(
    names: str, here: str, needed: int
) -> None:
    mine = lease(names, here)
    number = mine.beat(0.0)
    others = [name for name in names if name != here]
    for count, host in enumerate(others, start=1):
        mine.acknowledged(host, number)
        assert mine.holds(1.0) == (count >= needed)


def test_an_only_member_holds_it_always() -> None:
    assert lease("a", "a").holds(1e9)
    assert not lease("a", "b").holds(0.0)


def test_it_lasts_as_long_as_the_oldest_answer_that_the_majority_needs() -> None:
    mine = lease("abcde", "a")
    first, second = mine.beat(0.0), mine.beat(0.5)
    mine.acknowledged("b", first)
    mine.acknowledged("c", second)
    assert mine.until == 2.0
    mine.acknowledged("d", second)
    assert mine.until == 2.5
    mine.acknowledged("b", first)
    assert mine.until == 2.5


def test_answers_of_strangers_of_nothing_that_was_sent_and_from_long_ago_do_not_count() -> None:
    mine = lease("abc", "a")
    number = mine.beat(0.0)
    for host, answered in [("x", number), ("a", number), ("b", number + 1), ("b", 0), ("b", 2**63 - 1)]:
        mine.acknowledged(host, answered)
        assert not mine.holds(0.1)
    mine.beat(2.0)
    mine.acknowledged("b", number)
    assert not mine.holds(0.1)


def test_what_is_remembered_is_bounded() -> None:
    mine = lease("abc", "a")
    for beat in range(10_000):
        mine.beat(beat * 0.5)
    assert len(mine._sent) <= 5
