"""A termination in every answer of the quorum, and when it may be stored."""

from __future__ import annotations

import pytest
from quorum_one import INTERVAL, LEASE, One, messages_of, proposed, shadow

from lfield.replication.lease.effects import Checkpoint, PromoteCheckpoint, RecordTermination
from lfield.replication.lease.quorum_members import CLOCK_DRIFT
from lfield.replication.lease.termination_log import PROMISE_LIFETIME
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate, Terminated
from lfield.wire.quorum_messages import Heartbeat, HeartbeatAck, HeldRecord, Promise, Propose

FENCE = 65538


def end(generation: int = 1, outcome: str = "done", host: str = "b") -> Terminated:
    return Terminated("Tour", generation, outcome, "", host)  # type: ignore[arg-type]


def ended(generation: int = 1, outcome: str = "done", *, host: str = "b", final: bool = True) -> Checkpoint:
    place = CheckpointId(generation, 4, was_sent=False)
    return Checkpoint(
        place, is_alive=False, interval=0.0, ended=end(generation, outcome, host), is_final=final
    )


@pytest.mark.parametrize("outcome", ["done", "died", "lost"])
def test_a_known_end_is_in_every_answer(outcome: str) -> None:
    one = One("c", ended(outcome=outcome))
    ((_, sought),) = messages_of(one.on_message("a", Locate(["Tour"], leases=True)), LeaseRecord)
    assert (sought.checkpoint, sought.holder, sought.ended) == (None, "", end(outcome=outcome))
    ((_, ack),) = messages_of(one.on_message("a", Heartbeat(5, 1, 0, [])), HeartbeatAck)
    assert ack.ended == [end(outcome=outcome)]
    (promise,) = one.on_message("a", Propose("Tour", FENCE, 1))
    assert promise.message == Promise("Tour", FENCE, 0, None, end(outcome=outcome))
    assert one.core.fences.token_of("Tour") == 0


def test_an_end_is_not_repeated_to_a_host_that_knows_it() -> None:
    one, other = One("c", ended()), One("a", ended())
    heartbeat = messages_of(other.pass_time(0.6), Heartbeat)[-1][1]
    ((_, ack),) = messages_of(one.on_message("a", heartbeat), HeartbeatAck)
    assert (ack.fences, ack.ended) == ([], [])


def test_an_earlier_end_does_not_refuse_a_later_start() -> None:
    one = One("c", ended(1))
    ((_, promise),) = messages_of(one.on_message("a", Propose("Tour", FENCE, 2)), Promise)
    assert (promise.fence, promise.ended) == (FENCE, None)


@pytest.mark.parametrize(
    "answer",
    [
        LeaseRecord("Tour", None, ended=end()),
        LeaseRecord("Tour", None, "b", 1, 1e9, end(2)),
        HeartbeatAck(77, 1, [], [end()]),
        Promise("Tour", 0, 0, None, end()),
    ],
)
def test_a_received_end_stops_the_recovery(answer: object) -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    effects = one.on_message("c", answer)
    assert [e.ended.agent for e in effects if isinstance(e, RecordTermination)] == ["Tour"]
    one.copy = ended()
    more = one.pass_time(60.0)
    assert not proposed(more)
    assert not [e for e in more if isinstance(e, PromoteCheckpoint)]


@pytest.mark.parametrize("saved", [shadow(2), shadow(FENCE)])
def test_an_earlier_end_does_not_stop_the_recovery_of_a_later_start(saved: Checkpoint) -> None:
    one = One(saved=saved)
    one.pass_time(INTERVAL + 0.3)
    assert not [
        e
        for e in one.on_message("c", LeaseRecord("Tour", None, ended=end()))
        if isinstance(e, RecordTermination)
    ]
    assert proposed(one.pass_time(4.0))


def test_a_refusal_with_an_end_stops_the_attempt() -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    one.on_message("b", LeaseRecord("Tour", None))
    generation = proposed(one.on_message("c", LeaseRecord("Tour", None)) + one.pass_time(3.0))
    assert generation
    one.on_message("c", Promise("Tour", generation, generation, None))
    effects = one.on_message("b", Promise("Tour", generation, 0, None, end()))
    assert [e.ended for e in effects if isinstance(e, RecordTermination)] == [end()]
    # The members that have promised are informed that no recovery follows.
    assert ("b", LeaseRecord("Tour", None, ended=end())) in messages_of(effects, LeaseRecord)
    one.copy = ended()
    assert not [e for e in one.pass_time(60.0) if isinstance(e, PromoteCheckpoint)]


def test_an_end_that_is_not_final_is_held_under_the_lease() -> None:
    one = One("b", ended(host="b", final=False))
    beats = [heartbeat for _, heartbeat in messages_of(one.pass_time(0.6), Heartbeat)]
    assert [heartbeat.held for heartbeat in beats] == [[]] * len(beats)
    one.on_message("a", HeartbeatAck(77, beats[-1].number, []))
    assert messages_of(one.pass_time(0.6), Heartbeat)[-1][1].held == [HeldRecord("Tour", 1, 4)]
    ((_, sought),) = messages_of(one.on_message("a", Locate(["Tour"], leases=True)), LeaseRecord)
    assert (sought.holder, sought.generation, sought.ended) == ("b", 1, end())
    one.copy = ended(host="b")
    assert messages_of(one.pass_time(0.6), Heartbeat)[-1][1].held == []


def promised() -> One:
    """A host c that has promised a."""
    one = One("c")
    assert messages_of(one.on_message("a", Propose("Tour", FENCE, 1)), Promise)
    return one


def test_an_end_received_after_a_promise_is_delayed_and_sent_to_the_proposer() -> None:
    one = promised()
    assert one.core.is_delayed(end(), one.now)
    assert ("a", Promise("Tour", FENCE, FENCE, None, end())) in messages_of(one.pass_time(0.6), Promise)
    ((_, sought),) = messages_of(one.on_message("b", Locate(["Tour"], leases=True)), LeaseRecord)
    assert sought.ended == end()
    ((_, refused),) = messages_of(one.on_message("b", Propose("Tour", 2 * FENCE, 1)), Promise)
    assert refused.ended == end()
    # A message of another member does not release the end that was delayed for a.
    assert not [
        e
        for e in one.on_message("b", LeaseRecord("Tour", None, ended=end()))
        if isinstance(e, RecordTermination)
    ]
    assert [
        e
        for e in one.on_message("a", LeaseRecord("Tour", None, ended=end()))
        if isinstance(e, RecordTermination)
    ]


def test_an_end_is_not_delayed_longer_than_a_recovery_may_begin() -> None:
    one = promised()
    assert one.core.is_delayed(end(), one.now)
    assert not [e for e in one.pass_time(PROMISE_LIFETIME * LEASE) if isinstance(e, RecordTermination)]
    assert [
        e
        for e in one.pass_time((CLOCK_DRIFT - 1.0) * PROMISE_LIFETIME * LEASE + 1.0)
        if isinstance(e, RecordTermination)
    ]
    assert not one.core.is_delayed(end(), one.now)


def test_a_recovery_does_not_begin_later_than_ends_are_delayed() -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    one.on_message("b", LeaseRecord("Tour", None))
    generation = proposed(one.on_message("c", LeaseRecord("Tour", None)) + one.pass_time(3.0))
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.now += PROMISE_LIFETIME * LEASE
    assert not [e for e in one.core.tick(one.now) if isinstance(e, PromoteCheckpoint)]


def test_the_end_of_the_recovered_start_is_not_delayed() -> None:
    assert not promised().core.is_delayed(end(FENCE), 100.0)


def test_a_promise_of_an_earlier_life_counts_as_present() -> None:
    one = One("c", fence=FENCE)
    assert one.core.is_delayed(end(), one.now)
    assert not one.core.is_delayed(end(FENCE), one.now)


def test_a_host_that_is_no_member_delays_no_end() -> None:
    one = One("c", fence=FENCE, members="ab")
    assert not one.core.is_delayed(end(), one.now)


@pytest.mark.parametrize("strange", [Terminated("Nobody", 1, "done", "", "b"), end(1, "superseded")])
def test_an_unrelated_end_has_no_effect(strange: Terminated) -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    for answer in (LeaseRecord("Tour", None, ended=strange), HeartbeatAck(77, 1, [], [strange])):
        assert not [e for e in one.on_message("c", answer) if isinstance(e, RecordTermination)]
