"""From a suspicion to going on: who is asked, what ends it, and how long it takes."""

from __future__ import annotations

import pytest
from quorum_one import INTERVAL, LEASE, One, alive, messages_of, proposed, shadow, unknown

from lfield.replication.lease.effects import LogExplanation, PromoteCheckpoint, RaiseFence
from lfield.wire.coordinator_messages import CheckpointId, LeaseRecord, Locate
from lfield.wire.quorum_messages import Heartbeat, HeldRecord, Promise, Propose


def suspecting(**given) -> One:
    """A host that has begun to ask."""
    one = One(saved=shadow(), **given)
    one.pass_time(INTERVAL - 0.1)
    assert {host for host, _ in messages_of(one.pass_time(0.4), Locate)} == {"b", "c"}
    return one


def proposing() -> tuple[One, int]:
    """A host that has asked, and proposes a generation."""
    one = suspecting()
    one.on_message("b", unknown())
    generation = proposed(one.pass_time(0.5))
    assert generation
    return one, generation


def test_who_is_heard_to_be_held_is_not_suspected() -> None:
    one = One(saved=shadow())
    for number in range(30):
        assert not messages_of(one.pass_time(1.0), Locate)
        one.on_message("c", Heartbeat(5, number, 0, [HeldRecord("Tour", 1, 4)]))


@pytest.mark.parametrize(
    "saved", [None, shadow(interval=0.0), alive()], ids=["nothing", "switched off", "alive"]
)
def test_there_may_be_nothing_to_suspect(saved) -> None:
    assert not messages_of(One(saved=saved).pass_time(100.0), Locate)


def test_what_is_barred_here_is_a_shadow_whatever_its_host_says_of_it() -> None:
    assert messages_of(One(saved=alive(), fence=65537).pass_time(INTERVAL + 1.0), Locate)


def test_it_takes_the_interval_a_question_a_promise_and_a_lease() -> None:
    one, generation = proposing()
    begun = one.now
    one.on_message("b", Promise("Tour", generation, generation, None))
    assert not [e for e in one.pass_time(LEASE * 1.02) if isinstance(e, PromoteCheckpoint)]
    gone_on = [e for e in one.pass_time(0.1) if isinstance(e, PromoteCheckpoint)]
    assert [(e.agent, e.generation) for e in gone_on] == [("Tour", generation)]
    assert begun - 100.0 < INTERVAL + 0.81


def test_who_may_have_promised_what_it_has_forgotten_does_not_count_its_own_promise() -> None:
    one = suspecting(new=True)
    one.on_message("b", unknown())
    generation = proposed(one.pass_time(0.5))
    one.on_message("b", Promise("Tour", generation, generation, None))
    assert not [e for e in one.pass_time(LEASE * 1.05) if isinstance(e, PromoteCheckpoint)]
    one.on_message("c", Promise("Tour", generation, generation, None))
    assert [e.generation for e in one.pass_time(LEASE * 1.05) if isinstance(e, PromoteCheckpoint)] == [
        generation
    ]


def test_all_who_answer_are_enough_at_once() -> None:
    one = suspecting()
    one.on_message("b", unknown())
    assert proposed(one.on_message("c", unknown()))


def test_the_fence_is_raised_before_anybody_is_told() -> None:
    one = suspecting()
    one.on_message("b", unknown())
    effects = one.on_message("c", unknown())
    assert isinstance(effects[0], RaiseFence)
    assert all(isinstance(message, Propose) for _, message in messages_of(effects[1:], Propose))
    assert one.core.fences.token_of("Tour") == proposed(effects) == effects[0].generation


def test_a_host_that_is_cut_off_bars_nobody_however_long_it_is() -> None:
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
    assert proposed(one.pass_time(1.0)), "it goes on soon after the links are back"


@pytest.mark.parametrize(
    "answer",
    [
        LeaseRecord("Tour", None, "c", 1, 0.0),
        LeaseRecord("Tour", None, "c", 1, INTERVAL - 1.0),
        LeaseRecord("Tour", CheckpointId(1, 4, True)),
        LeaseRecord("Tour", CheckpointId(1, 3, False)),
        LeaseRecord("Tour", CheckpointId(65537, 0, True)),
    ],
    ids=["alive", "heard within the interval", "newer", "arrived", "recovered"],
)
def test_an_answer_ends_it(answer: LeaseRecord) -> None:
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
    ids=["older", "as old", "heard long ago", "heard before time began"],
)
def test_an_answer_does_not_end_it(answer: LeaseRecord) -> None:
    one = suspecting()
    one.on_message("b", answer)
    assert proposed(one.on_message("c", unknown()))


def test_whoever_answers_is_not_asked_again_and_the_others_are_not_asked_for_each_answer() -> None:
    one = suspecting()
    assert not messages_of(one.on_message("b", unknown()), Locate)
    assert {host for host, _ in messages_of(one.pass_time(0.4), Locate)} <= {"c"}


def test_an_interval_is_never_shorter_than_a_lease_may_last() -> None:
    one = One(saved=shadow(interval=0.01))
    for number in range(100):
        assert not messages_of(one.pass_time(0.5), Locate)
        one.on_message("c", Heartbeat(5, number, 0, [HeldRecord("Tour", 1, 4)]))
    assert messages_of(one.pass_time(LEASE * 1.03 + 0.3), Locate)


def test_a_promise_of_a_later_fence_ends_it() -> None:
    one, generation = proposing()
    effects = one.on_message("b", Promise("Tour", generation, generation + 1, None))
    assert [(e.agent, e.generation) for e in effects if isinstance(e, RaiseFence)] == [
        ("Tour", generation + 1)
    ]
    assert not [e for e in one.pass_time(4.0) if isinstance(e, PromoteCheckpoint)]


def test_a_promise_that_shows_something_newer_ends_it() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, CheckpointId(1, 9, True)))
    assert not [e for e in one.pass_time(4.0) if isinstance(e, PromoteCheckpoint)]


def test_promises_of_strangers_of_other_numbers_and_of_other_agents_do_not_count() -> None:
    one, generation = proposing()
    for host, promise in [
        ("x", Promise("Tour", generation, generation, None)),
        ("b", Promise("Tour", generation - 1, generation - 1, None)),
        ("b", Promise("Nobody", generation, generation, None)),
        ("a", Promise("Tour", generation, generation, None)),
    ]:
        one.on_message(host, promise)
    assert not [e for e in one.pass_time(3.5) if isinstance(e, PromoteCheckpoint)]


def test_a_fence_that_rises_meanwhile_ends_it() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.on_message("c", Propose("Tour", generation + 65536))
    assert not [e for e in one.pass_time(LEASE * 1.5) if isinstance(e, PromoteCheckpoint)]


def test_a_block_that_comes_meanwhile_ends_it() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.copy = shadow(sequence=5)
    assert not [e for e in one.pass_time(LEASE * 1.5) if isinstance(e, PromoteCheckpoint)]


def test_a_host_that_was_stopped_doubts_itself_first() -> None:
    one = One(saved=shadow())
    one.pass_time(1.0)
    one.now += 60.0
    assert not messages_of(one.core.tick(one.now), Locate)
    assert not messages_of(one.pass_time(INTERVAL - 0.1), Locate)


def test_answers_that_waited_while_it_was_stopped_are_old() -> None:
    one = suspecting()
    one.now += 60.0
    effects = one.on_message("b", unknown()) + one.on_message("c", unknown()) + one.core.tick(one.now)
    assert not proposed(effects)


def test_a_wait_that_is_over_after_a_stop_is_long_enough() -> None:
    one, generation = proposing()
    one.on_message("b", Promise("Tour", generation, generation, None))
    one.now += 60.0
    assert [e for e in one.core.tick(one.now) if isinstance(e, PromoteCheckpoint)]


def test_two_shadows_do_not_outbid_each_other() -> None:
    one, generation = proposing()
    asked = one.on_message("c", Locate(["Tour"], leases=True))
    assert [message.holder for _, message in messages_of(asked, LeaseRecord)] == ["a"]
    other = One("b", saved=shadow(interval=LEASE))
    other.pass_time(LEASE)
    other.on_message("a", Propose("Tour", generation))
    assert not proposed(other.pass_time(LEASE)), "whoever has promised waits as if it had been heard"
    (_, answer), *_ = messages_of(other.on_message("c", Locate(["Tour"], leases=True)), LeaseRecord)
    assert (answer.holder, answer.generation) == ("a", generation)


def test_a_question_that_ends_and_begins_again_is_told_of_once() -> None:
    one = suspecting()
    # b has heard of it a moment after this host: the question ends, and is asked again in that moment.
    one.on_message("b", LeaseRecord("Tour", None, "c", 1, INTERVAL - 0.2))
    again = one.pass_time(0.6)
    assert messages_of(again, Locate)
    assert not [
        effect
        for effect in again
        if isinstance(effect, LogExplanation) and "asking every host" in effect.text
    ]
