"""A lease holds while a majority has acknowledged a heartbeat that was sent less than its length ago."""

from __future__ import annotations

import pytest

from lfield.replication.lease.lease import Lease
from lfield.replication.lease.quorum_members import QuorumMembers


def lease(names: str, here: str) -> Lease:
    return Lease(QuorumMembers(names, here, 2.0))


def test_a_new_life_has_no_lease() -> None:
    assert not lease("abc", "a").holds(0.0)


def test_a_lease_counts_from_the_sending_of_the_heartbeat() -> None:
    own_lease = lease("abc", "a")
    number = own_lease.next_heartbeat(10.0)
    own_lease.on_ack("b", number)
    assert own_lease.holds(11.99)
    assert not own_lease.holds(12.0)


@pytest.mark.parametrize(
    ("names", "here", "needed"),
    [("abc", "a", 1), ("abcd", "a", 2), ("abcde", "a", 2), ("abc", "x", 2), ("a", "x", 1)],
)
def test_a_lease_needs_a_majority_and_a_member_counts_itself(names: str, here: str, needed: int) -> None:
    own_lease = lease(names, here)
    number = own_lease.next_heartbeat(0.0)
    others = [name for name in names if name != here]
    for count, host in enumerate(others, start=1):
        own_lease.on_ack(host, number)
        assert own_lease.holds(1.0) == (count >= needed)


def test_a_single_member_always_has_the_lease() -> None:
    assert lease("a", "a").holds(1e9)
    assert not lease("a", "b").holds(0.0)


def test_a_lease_ends_with_the_oldest_answer_that_the_majority_needs() -> None:
    own_lease = lease("abcde", "a")
    first, second = own_lease.next_heartbeat(0.0), own_lease.next_heartbeat(0.5)
    own_lease.on_ack("b", first)
    own_lease.on_ack("c", second)
    assert own_lease.valid_until == 2.0
    own_lease.on_ack("d", second)
    assert own_lease.valid_until == 2.5
    own_lease.on_ack("b", first)
    assert own_lease.valid_until == 2.5


def test_unknown_hosts_numbers_and_old_answers_do_not_count() -> None:
    own_lease = lease("abc", "a")
    number = own_lease.next_heartbeat(0.0)
    for host, answered in [("x", number), ("a", number), ("b", number + 1), ("b", 0), ("b", 2**63 - 1)]:
        own_lease.on_ack(host, answered)
        assert not own_lease.holds(0.1)
    own_lease.next_heartbeat(2.0)
    own_lease.on_ack("b", number)
    assert not own_lease.holds(0.1)


def test_the_number_of_remembered_heartbeats_is_bounded() -> None:
    own_lease = lease("abc", "a")
    for number in range(10_000):
        own_lease.next_heartbeat(number * 0.5)
    assert len(own_lease._sent) <= 5
