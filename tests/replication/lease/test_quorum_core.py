"""The answers of one host, and the permission of its coordinators to act, after any messages."""

from __future__ import annotations

import msgspec
import pytest
from quorum_one import LEASE, One, alive, messages_of, shadow

from lfield.replication.lease.effects import RaiseFence
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate
from lfield.wire.quorum_messages import (
    MAX_RECORDS,
    FencedRecord,
    Heartbeat,
    HeartbeatAck,
    HeldRecord,
    Promise,
    Propose,
    QuorumMessage,
)


def test_before_start_the_core_sends_nothing_and_answers_every_message() -> None:
    one = One()
    one.core._next_heartbeat = None
    assert one.core.due is None
    assert one.core.tick(200.0) == []
    assert messages_of(one.on_message("b", Heartbeat(1, 1, 0, [])), HeartbeatAck)
    assert messages_of(one.on_message("b", Locate(["Tour"], leases=True)), LeaseRecord)
    assert messages_of(one.on_message("b", Propose("Tour", 65537)), Promise)


def test_a_coordinator_acts_only_under_a_lease_and_above_the_fence() -> None:
    one = One(saved=alive())
    assert not one.core.may_act("Tour", 1, one.now)
    one.lease()
    assert one.core.may_act("Tour", 1, one.now)
    one.on_message("b", HeartbeatAck(77, 1, [FencedRecord("Tour", 2)]))
    assert not one.core.may_act("Tour", 1, one.now)
    assert one.core.may_act("Tour", 2, one.now)
    assert not one.core.may_act("Tour", 2, one.now + LEASE)


def test_a_member_that_may_have_lost_its_promises_gets_no_lease_from_itself() -> None:
    one = One(saved=alive(), new=True)
    one.lease()
    assert not one.core.may_act("Tour", 1, one.now)
    (*_, heartbeat) = [
        heartbeat for host, heartbeat in messages_of(one.pass_time(0.6), Heartbeat) if host == "c"
    ]
    one.on_message("c", HeartbeatAck(77, heartbeat.number, []))
    assert one.core.knows_promises
    assert one.core.may_act("Tour", 1, one.now)


def test_an_acknowledgement_of_another_life_has_no_effect() -> None:
    one = One(saved=alive())
    one.pass_time(1.0)
    assert one.on_message("b", HeartbeatAck(76, 1, [FencedRecord("Tour", 9)])) == []
    assert not one.core.lease.holds(one.now)
    assert not one.core.is_fenced("Tour", 1)


def test_fences_are_sent_with_each_acknowledgement_until_they_are_known() -> None:
    one = One(fence=65537)
    heartbeat = Heartbeat(5, 1, 0, [])
    for _ in range(3):
        assert one.on_message("b", heartbeat) == one.on_message("b", heartbeat)
        ((_, ack),) = messages_of(one.on_message("b", heartbeat), HeartbeatAck)
        assert ack.fences == [FencedRecord("Tour", 65537)], "without fences of unknown agents"
    ((_, ack),) = messages_of(one.on_message("b", Heartbeat(5, 2, one.core.fences.digest, [])), HeartbeatAck)
    assert ack.fences == []


def test_a_promise_is_above_the_known_fence_or_reports_it() -> None:
    one = One(saved=shadow())
    bar, promise = one.on_message("b", Propose("Tour", 65538))
    assert isinstance(bar, RaiseFence)
    assert promise.message == Promise("Tour", 65538, 65538, CheckpointId(1, 3, True))
    (promise,) = one.on_message("b", Propose("Tour", 65538))
    assert promise.message.fence == 65538, "repeated"
    (promise,) = one.on_message("c", Propose("Tour", 65537))
    assert promise.message.fence == 65538, "refused"


def test_a_coordinator_acting_under_a_lease_is_not_fenced_by_an_older_query() -> None:
    one = One(saved=alive())
    one.lease()
    ((_, answer),) = messages_of(one.on_message("c", Propose("Tour", 65539)), LeaseRecord)
    assert (answer.holder, answer.generation) == ("a", 1)
    one.now += 2 * LEASE
    assert messages_of(one.on_message("c", Propose("Tour", 65539)), Promise)


def test_held_coordinators_are_sent_only_under_a_lease() -> None:
    one = One(saved=alive())
    assert {tuple(heartbeat.held) for _, heartbeat in messages_of(one.pass_time(1.0), Heartbeat)} == {()}
    one.lease()
    held = [heartbeat.held for _, heartbeat in messages_of(one.pass_time(1.0), Heartbeat)]
    assert held[-1] == [HeldRecord("Tour", 1, 3)]
    one.on_message("b", HeartbeatAck(77, 1, [FencedRecord("Tour", 2)]))
    assert {tuple(heartbeat.held) for _, heartbeat in messages_of(one.pass_time(1.0), Heartbeat)} == {()}


def test_a_host_that_is_no_member_requests_a_lease_at_a_limited_rate() -> None:
    one = One(members="bc")
    assert not messages_of(one.pass_time(10.0), Heartbeat)
    one.copy = alive()
    beats = 0
    for _ in range(100):
        one.core.request_lease(one.now)
        beats += len(messages_of(one.pass_time(0.001), Heartbeat))
    assert beats == 2


def test_a_host_that_is_no_member_repeats_its_first_request_until_it_has_a_lease() -> None:
    one = One(here="c", members="ab")
    assert messages_of(one.pass_time(2.0), Heartbeat) == []
    one.core.request_lease(one.now)
    assert [host for host, _ in messages_of(one.pass_time(1.1), Heartbeat)] == ["a", "b"] * 3
    beats = [heartbeat for _, heartbeat in messages_of(one.pass_time(0.6), Heartbeat)]
    for member in "ab":
        one.on_message(member, HeartbeatAck(77, beats[-1].number, []))
    assert messages_of(one.pass_time(1.0), Heartbeat) == []


def test_a_record_has_the_age_of_the_last_heartbeat_of_the_holder() -> None:
    one = One()
    one.on_message("b", Heartbeat(5, 1, 0, [HeldRecord("Tour", 3, 4)]))
    one.pass_time(1.5)
    ((_, answer),) = messages_of(one.on_message("c", Locate(["Tour"], leases=True)), LeaseRecord)
    assert (answer.holder, answer.generation, answer.age) == ("b", 3, pytest.approx(1.5))


HUGE = 2**63 - 1
STRANGE: list[QuorumMessage] = [
    Heartbeat(HUGE, HUGE, HUGE, [HeldRecord("Nobody", HUGE, HUGE), HeldRecord("Tour", HUGE, HUGE)]),
    Heartbeat(0, 0, 0, [HeldRecord("Tour", 0, 0)] * MAX_RECORDS),
    HeartbeatAck(77, HUGE, [FencedRecord("Nobody", HUGE), FencedRecord("Tour", 0)]),
    HeartbeatAck(0, 0, []),
    Locate(["Nobody"], leases=True),
    LeaseRecord("Nobody", CheckpointId(HUGE, HUGE, False), "x", HUGE, 0.0),
    LeaseRecord("Tour", None, "Tour", 0, 1e9),
    Propose("Nobody", HUGE),
    Propose("Tour", 0),
    Promise("Nobody", HUGE, HUGE, None),
    Promise("Tour", HUGE, 0, None),
]


@pytest.mark.parametrize("message", STRANGE, ids=lambda message: type(message).__name__)
@pytest.mark.parametrize("host", ["b", "stranger"])
def test_an_old_or_unknown_message_has_no_effect(host: str, message: QuorumMessage) -> None:
    one = One(saved=shadow(), fence=65537)
    effects = one.on_message(host, message)
    assert not [e for e in effects if isinstance(e, RaiseFence)]
    for _, answer in messages_of(effects, QuorumMessage):
        packed = msgspec.msgpack.encode(answer)
        assert msgspec.msgpack.decode(packed, type=QuorumMessage) == answer
    assert one.core.fences.token_of("Tour") == 65537
    assert not one.core.lease.holds(one.now)


def test_unknown_agents_are_not_stored() -> None:
    one = One(saved=shadow())
    for number in range(200):
        name = f"Nobody:{number}"
        one.on_message("b", Heartbeat(5, number, 0, [HeldRecord(name, 1, 1)]))
        one.on_message("b", LeaseRecord(name, None, "b", 1, 0.0))
        one.on_message("b", Propose(name, 9))
        one.on_message("b", Promise(name, 9, 9, None))
        one.on_message("b", Locate([name], leases=True))
    parts = [vars(one.core), vars(one.core._failover), vars(one.core.fences)]
    assert (
        max(len(collection) for part in parts for collection in part.values() if isinstance(collection, dict))
        <= 1
    )
