"""A termination in every answer of the quorum, and when it may come to the disk."""

from __future__ import annotations

import pytest
from quorum_one import INTERVAL, LEASE, One, proposed, shadow, told

from lfield.quorum.effects import Saved, TakeOver, Terminate
from lfield.quorum.members import DRIFT
from lfield.quorum.terminations import VALID
from lfield.wire.coordinators import Ended
from lfield.wire.quorum import Ack, Heartbeat, Held, Place, Promise, Propose, Seek, Sought

FENCE = 65538


def end(generation: int = 1, outcome: str = "done", host: str = "b") -> Ended:
    return Ended("Tour", generation, outcome, "", host)  # type: ignore[arg-type]


def ended(generation: int = 1, outcome: str = "done", *, host: str = "b", final: bool = True) -> Saved:
    place = Place(generation, 4, left=False)
    return Saved(place, alive=False, interval=0.0, ended=end(generation, outcome, host), final=final)


@pytest.mark.parametrize("outcome", ["done", "died", "lost"])
def test_who_knows_an_end_says_so_in_every_answer(outcome: str) -> None:
    one = One("c", ended(outcome=outcome))
    ((_, sought),) = told(one.hear("a", Seek("Tour")), Sought)
    assert (sought.place, sought.holder, sought.ended) == (None, "", end(outcome=outcome))
    ((_, ack),) = told(one.hear("a", Heartbeat(5, 1, 0, [])), Ack)
    assert ack.ended == [end(outcome=outcome)]
    (promise,) = one.hear("a", Propose("Tour", FENCE, 1))
    assert promise.message == Promise("Tour", FENCE, 0, None, end(outcome=outcome))
    assert one.core.fences.of("Tour") == 0


def test_an_end_is_not_repeated_to_who_knows_it() -> None:
    one, other = One("c", ended()), One("a", ended())
    beat = told(other.pass_time(0.6), Heartbeat)[-1][1]
    ((_, ack),) = told(one.hear("a", beat), Ack)
    assert (ack.fences, ack.ended) == ([], [])


def test_an_earlier_end_does_not_refuse_a_later_start() -> None:
    one = One("c", ended(1))
    ((_, promise),) = told(one.hear("a", Propose("Tour", FENCE, 2)), Promise)
    assert (promise.fence, promise.ended) == (FENCE, None)


@pytest.mark.parametrize(
    "answer",
    [
        Sought("Tour", None, ended=end()),
        Sought("Tour", None, "b", 1, 1e9, end(2)),
        Ack(77, 1, [], [end()]),
        Promise("Tour", 0, 0, None, end()),
    ],
)
def test_who_hears_of_an_end_goes_on_with_nothing(answer: object) -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    effects = one.hear("c", answer)
    assert [e.ended.agent for e in effects if isinstance(e, Terminate)] == ["Tour"]
    one.copy = ended()
    more = one.pass_time(60.0)
    assert not proposed(more)
    assert not [e for e in more if isinstance(e, TakeOver)]


@pytest.mark.parametrize("saved", [shadow(2), shadow(FENCE)])
def test_an_earlier_end_does_not_stop_who_has_a_later_start(saved: Saved) -> None:
    one = One(saved=saved)
    one.pass_time(INTERVAL + 0.3)
    assert not [e for e in one.hear("c", Sought("Tour", None, ended=end())) if isinstance(e, Terminate)]
    assert proposed(one.pass_time(4.0))


def test_an_attempt_ends_when_a_member_refuses_since_it_knows_of_the_end() -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    one.hear("b", Sought("Tour", None))
    generation = proposed(one.hear("c", Sought("Tour", None)) + one.pass_time(3.0))
    assert generation
    one.hear("c", Promise("Tour", generation, generation, None))
    effects = one.hear("b", Promise("Tour", generation, 0, None, end()))
    assert [e.ended for e in effects if isinstance(e, Terminate)] == [end()]
    # Whoever has promised hears that nothing begins by that.
    assert ("b", Sought("Tour", None, ended=end())) in told(effects, Sought)
    one.copy = ended()
    assert not [e for e in one.pass_time(60.0) if isinstance(e, TakeOver)]


def test_an_end_that_is_not_final_is_named_as_held_under_the_lease() -> None:
    one = One("b", ended(host="b", final=False))
    beats = [beat for _, beat in told(one.pass_time(0.6), Heartbeat)]
    assert [beat.held for beat in beats] == [[]] * len(beats)
    one.hear("a", Ack(77, beats[-1].number, []))
    assert told(one.pass_time(0.6), Heartbeat)[-1][1].held == [Held("Tour", 1, 4)]
    ((_, sought),) = told(one.hear("a", Seek("Tour")), Sought)
    assert (sought.holder, sought.generation, sought.ended) == ("b", 1, end())
    one.copy = ended(host="b")
    assert told(one.pass_time(0.6), Heartbeat)[-1][1].held == []


def promised() -> One:
    """c has promised a."""
    one = One("c")
    assert told(one.hear("a", Propose("Tour", FENCE, 1)), Promise)
    return one


def test_an_end_that_comes_after_a_promise_waits_and_the_proposer_is_told() -> None:
    one = promised()
    assert one.core.is_delayed(end(), one.now)
    assert ("a", Promise("Tour", FENCE, FENCE, None, end())) in told(one.pass_time(0.6), Promise)
    ((_, sought),) = told(one.hear("b", Seek("Tour")), Sought)
    assert sought.ended == end()
    ((_, refused),) = told(one.hear("b", Propose("Tour", 2 * FENCE, 1)), Promise)
    assert refused.ended == end()
    # Of another member's word nothing follows for what was promised to a.
    assert not [e for e in one.hear("b", Sought("Tour", None, ended=end())) if isinstance(e, Terminate)]
    assert [e for e in one.hear("a", Sought("Tour", None, ended=end())) if isinstance(e, Terminate)]


def test_an_end_waits_no_longer_than_a_recovery_may_begin() -> None:
    one = promised()
    assert one.core.is_delayed(end(), one.now)
    assert not [e for e in one.pass_time(VALID * LEASE) if isinstance(e, Terminate)]
    assert [e for e in one.pass_time((DRIFT - 1.0) * VALID * LEASE + 1.0) if isinstance(e, Terminate)]
    assert not one.core.is_delayed(end(), one.now)


def test_a_recovery_does_not_begin_later_than_ends_wait() -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    one.hear("b", Sought("Tour", None))
    generation = proposed(one.hear("c", Sought("Tour", None)) + one.pass_time(3.0))
    one.hear("b", Promise("Tour", generation, generation, None))
    one.now += VALID * LEASE
    assert not [e for e in one.core.tick(one.now) if isinstance(e, TakeOver)]


def test_the_end_of_the_recovered_start_itself_does_not_wait() -> None:
    assert not promised().core.is_delayed(end(FENCE), 100.0)


def test_a_promise_of_an_earlier_life_counts_as_one_of_now() -> None:
    one = One("c", fence=FENCE)
    assert one.core.is_delayed(end(), one.now)
    assert not one.core.is_delayed(end(FENCE), one.now)


def test_who_is_no_member_waits_for_nothing() -> None:
    one = One("c", fence=FENCE, members="ab")
    assert not one.core.is_delayed(end(), one.now)


@pytest.mark.parametrize("strange", [Ended("Nobody", 1, "done", "", "b"), end(1, "superseded")])
def test_what_is_no_end_of_it_changes_nothing(strange: Ended) -> None:
    one = One(saved=shadow())
    one.pass_time(INTERVAL + 0.3)
    for answer in (Sought("Tour", None, ended=strange), Ack(77, 1, [], [strange])):
        assert not [e for e in one.hear("c", answer) if isinstance(e, Terminate)]
