"""From a suspicion to a recovery: the queried hosts, the duration, and an abandoned recovery."""

from __future__ import annotations

import pytest
from quorum_one import INTERVAL, LEASE, One, alive, messages_of, proposed, shadow, unknown

from lfield.replication.lease.effects import LogExplanation, PromoteCheckpoint, RaiseFence
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate
from lfield.wire.quorum_messages import Heartbeat, HeldRecord, Promise, Propose


def suspecting(**given) -> One:
    """A host that has started its queries."""
    one = One(saved=shadow(), **given)
    one.pass_time(INTERVAL - 0.1)
    assert {host for host, _ in messages_of(one.pass_time(0.4), Locate)} == {"b", "c"}
    return one


def proposing() -> tuple[One, int]:
    """A host that has finished its queries and proposes a generation."""
    one = suspecting()
    one.on_message("b", unknown())
    generation = proposed(one.pass_time(0.5))
    assert generation
    return one, generation


def test_a_held_coordinator_is_not_suspected() -> None:
    one = One(saved=shadow())
    for number in range(30):
        assert not messages_of(one.pass_time(1.0), Locate)
        one.on_message("c", Heartbeat(5, number, 0, [HeldRecord("Tour", 1, 4)]))


@pytest.mark.parametrize(
    "saved", [None, shadow(interval=0.0), alive()], ids=["nothing", "switched off", "alive"]
)
def test_without_a_leased_shadow_there_is_no_suspicion(saved) -> None:
    assert not messages_of(One(saved=saved).pass_time(100.0), Locate)


def test_a_fenced_copy_is_a_shadow_although_it_claims_to_be_alive() -> None:
    assert messages_of(One(saved=alive(), fence=65537).pass_time(INTERVAL + 1.0), Locate)


def test_a_recovery_takes_the_interval_a_query_a_promise_and_a_lease() -> None:
    one, generation = proposing()
    proposed_at = one.now
    one.on_message("b", Promise("Tour", generation, generation, None))
    assert not [e for e in one.pass_time(LEASE * 1.02) if isinstance(e, PromoteCheckpoint)]
    promoted = [e for e in one.pass_time(0.1) if isinstance(e, PromoteCheckpoint)]
    assert [(e.agent, e.generation) for e in promoted] == [("Tour", generation)]
    assert proposed_at - 100.0 < INTERVAL + 0.81


def test_a_member_that_may_have_lost_its_promises_does_not_count_its_own() -> None:
    one = suspecting(new=True)
    one.on_message("b", unknown())
    generation = proposed(one.pass_time(0.5))
    one.on_message("b", Promise("Tour", generation, generation, None))
    assert not [e for e in one.pass_time(LEASE * 1.05) if isinstance(e, PromoteCheckpoint)]
    one.on_message("c", Promise("Tour", generation, generation, None))
    assert [e.generation for e in one.pass_time(LEASE * 1.05) if isinstance(e, PromoteCheckpoint)] == [
        generation
    ]


def test_the_fence_is_raised_before_the_proposals_are_sent() -> None:
    """The proposals are sent as soon as all hosts have answered."""
    one = suspecting()
    one.on_message("b", unknown())
    effects = one.on_message("c", unknown())
    assert isinstance(effects[0], RaiseFence)
    assert all(isinstance(message, Propose) for _, message in messages_of(effects[1:], Propose))
    assert one.core.fences.token_of("Tour") == proposed(effects) == effects[0].generation > 0


def test_a_host_that_is_cut_off_fences_no_other() -> None:
    one = suspecting()
    effects = one.pass_time(600.0)
    assert not [e for e in effects if isinstance(e, RaiseFence | PromoteCheckpoint)]
    assert len(messages_of(effects, Locate)) < 600 * 2 * 4
    assert [e.text for e in effects if isinstance(e, LogExplanation)] == [
        "failover of Tour waiting: no majority of the members responds; retrying"
    ]
    one.pass_time(3.0)
    while not messages_of(one.pass_time(0.1), Locate):
        pass
    one.on_message("b", unknown())
    assert proposed(one.pass_time(1.0)), "it continues soon after the links are restored"


@pytest.mark.parametrize(
    "answer",
    [
        LeaseRecord("Tour", None, "c", 1, 0.0),
        LeaseRecord("Tour", None, "c", 1, INTERVAL - 1.0),
        LeaseRecord("Tour", CheckpointId(1, 4, True)),
        LeaseRecord("Tour", CheckpointId(1, 3, False)),
        LeaseRecord("Tour", CheckpointId(65537, 0, True)),
    ],
    ids=["alive", "recent contact", "newer", "arrived", "recovered"],
)
def test_a_newer_or_live_record_ends_a_recovery(answer: LeaseRecord) -> None:
    one = suspecting()
    assert not proposed(one.on_message("b", answer))
    assert not proposed(one.on_message("c", unknown()))
    assert not proposed(one.pass_time(0.9))


@pytest.mark.parametrize(
    "answer",
    [
        LeaseRecord("Tour", CheckpointId(1, 2, True)),
        LeaseRecord("Tour", CheckpointId(1, 3, True)),
        LeaseRecord("Tour", None, "c", 1, 60.0),
        LeaseRecord("Tour", None, "c", 1, 1e9),
    ],
    ids=["older", "as old", "old contact", "contact before the start"],
)
def test_an_older_record_does_not_end_a_recovery(answer: LeaseRecord) -> None:
    one = suspecting()
    one.on_message("b", answer)
    assert proposed(one.on_message("c", unknown()))


def test_a_host_that_answered_is_not_asked_again() -> None:
    one = suspecting()
    assert not messages_of(one.on_message("b", unknown()), Locate)
    assert {host for host, _ in messages_of(one.pass_time(0.4), Locate)} <= {"c"}


def test_an_interval_is_never_shorter_than_a_lease() -> None:
    one = One(saved=shadow(interval=0.01))
    for number in range(100):
        assert not messages_of(one.pass_time(0.5), Locate)
        one.on_message("c", Heartbeat(5, number, 0, [HeldRecord("Tour", 1, 4)]))
    assert messages_of(one.pass_time(LEASE * 1.03 + 0.3), Locate)


def test_a_promise_with_a_later_fence_ends_a_recovery() -> None:
    one, generation = proposing()
    effects = one.on_message("b", Promise("Tour", generation, generation + 1, None))
    assert [(e.agent, e.generation) for e in effects if isinstance(e, RaiseFence)] == [
        ("Tour", generation + 1)
    ]
    assert not [e for e in one.pass_time(4.0) if isinstance(e, PromoteCheckpoint)]


def test_a_promise_with_a_newer_checkpoint_ends_a_recovery() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, CheckpointId(1, 9, True)))
    assert not [e for e in one.pass_time(4.0) if isinstance(e, PromoteCheckpoint)]


def test_promises_of_other_hosts_numbers_and_agents_do_not_count() -> None:
    one, generation = proposing()
    for host, promise in [
        ("x", Promise("Tour", generation, generation, None)),
        ("b", Promise("Tour", generation - 1, generation - 1, None)),
        ("b", Promise("Nobody", generation, generation, None)),
        ("a", Promise("Tour", generation, generation, None)),
    ]:
        one.on_message(host, promise)
    assert not [e for e in one.pass_time(3.5) if isinstance(e, PromoteCheckpoint)]


def test_a_higher_fence_ends_a_recovery() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.on_message("c", Propose("Tour", generation + 65536))
    assert not [e for e in one.pass_time(LEASE * 1.5) if isinstance(e, PromoteCheckpoint)]


def test_a_newer_block_ends_a_recovery() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.copy = shadow(sequence=5)
    assert not [e for e in one.pass_time(LEASE * 1.5) if isinstance(e, PromoteCheckpoint)]


def test_a_host_that_was_stopped_waits_for_a_full_interval() -> None:
    one = One(saved=shadow())
    one.pass_time(1.0)
    one.now += 60.0
    assert not messages_of(one.core.tick(one.now), Locate)
    assert not messages_of(one.pass_time(INTERVAL - 0.1), Locate)


def test_answers_received_after_a_stop_are_old() -> None:
    one = suspecting()
    one.now += 60.0
    effects = one.on_message("b", unknown()) + one.on_message("c", unknown()) + one.core.tick(one.now)
    assert not proposed(effects)


def test_a_wait_that_ended_during_a_stop_is_long_enough() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.now += 60.0
    assert [e for e in one.core.tick(one.now) if isinstance(e, PromoteCheckpoint)]


def test_two_shadows_do_not_compete_for_the_recovery() -> None:
    one, generation = proposing()
    answers = one.on_message("c", Locate(["Tour"], leases=True))
    assert [message.holder for _, message in messages_of(answers, LeaseRecord)] == ["a"]
    other = One("b", saved=shadow(interval=LEASE))
    other.pass_time(LEASE)
    other.on_message("a", Propose("Tour", generation))
    assert not proposed(other.pass_time(LEASE)), "a host that has promised waits as after a contact"
    (_, answer), *_ = messages_of(other.on_message("c", Locate(["Tour"], leases=True)), LeaseRecord)
    assert (answer.holder, answer.generation) == ("a", generation)


def test_a_repeated_query_is_logged_once() -> None:
    one = suspecting()
    # b has a slightly newer contact: the query ends, and is repeated at once.
    one.on_message("b", LeaseRecord("Tour", None, "c", 1, INTERVAL - 0.2))
    again = one.pass_time(0.6)
    assert messages_of(again, Locate)
    assert not [
        effect
        for effect in again
        if isinstance(effect, LogExplanation) and "asking every host" in effect.text
    ]
