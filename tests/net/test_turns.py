"""Whose message is next, of persons and their links."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.net.waiting.turns import Turns


def taken(turns: Turns[str]) -> list[str]:
    return list(iter(turns.next, None))


def test_nobody_waits():
    turns = Turns[str](3, 1.0)
    assert turns.next() is None
    assert not turns.used
    turns.leave("nobody")


def test_one_that_is_alone_has_all_turns_of_a_round_and_no_more():
    turns = Turns[str](3, 1.0)
    turns.enter("link", "anna")
    assert taken(turns) == ["link"] * 3
    assert turns.used
    turns.again()
    assert not turns.used
    assert taken(turns) == ["link"] * 3


def test_a_round_is_over_when_its_turns_have_taken_long():
    turns = Turns[str](9, 1.0)
    turns.enter("link", "anna")
    for seconds in (0.5, 0.4, 7.0):
        assert turns.next() == "link"
        turns.took(seconds)
    assert turns.next() is None
    turns.again()
    assert turns.next() == "link"


def test_persons_take_turns_and_then_their_links():
    turns = Turns[str](8, 1.0)
    for link in ("anna 1", "anna 2", "anna 3", "ben"):
        turns.enter(link, link[:4])
    assert taken(turns) == ["anna 1", "ben", "anna 2", "ben", "anna 3", "ben", "anna 1", "ben"]


def test_who_comes_to_a_crowd_waits_for_one_turn():
    turns = Turns[str](1, 1.0)
    for number in range(60):
        turns.enter(f"anna {number}", "anna")
    assert taken(turns) == ["anna 0"]
    turns.enter("ben", "ben")
    turns.again()
    turns.leave("anna 1")
    assert taken(turns) == ["anna 2"]
    turns.again()
    assert taken(turns) == ["ben"]


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 9), st.sampled_from(["anna", "ben", "carl"]))),
    st.lists(st.integers(0, 9)),
    st.integers(1, 40),
)
def test_each_round_is_shared_as_evenly_as_it_can_be(come, go, most):
    turns, waiting = Turns[int](most, 1.0), {}
    for link, person in come:
        if link not in waiting:
            waiting[link] = person
            turns.enter(link, person)
    for link in go:
        waiting.pop(link, None)
        turns.leave(link)
    had = Counter(iter(turns.next, None))
    assert had.total() == (most if waiting else 0)
    persons = Counter(dict.fromkeys(waiting.values(), 0))
    for link, count in had.items():
        persons[waiting[link]] += count
    shares = [persons, *(Counter({n: had[n] for n, p in waiting.items() if p == who}) for who in persons)]
    assert all(max(share.values()) - min(share.values()) <= 1 for share in shares if share)
