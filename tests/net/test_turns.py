"""The fair order of messages among persons and their links."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.net.scheduling.fair_queue import FairQueue


def served_links(turns: FairQueue[str]) -> list[str]:
    return list(iter(turns.next, None))


def test_an_empty_queue_has_no_next_link():
    turns = FairQueue[str](3, 1.0)
    assert turns.next() is None
    assert not turns.is_used
    turns.remove("nobody")


def test_a_single_link_gets_all_turns_of_a_round():
    turns = FairQueue[str](3, 1.0)
    turns.add("link", "anna")
    assert served_links(turns) == ["link"] * 3
    assert turns.is_used
    turns.start_round()
    assert not turns.is_used
    assert served_links(turns) == ["link"] * 3


def test_a_round_ends_when_its_turns_took_too_long():
    turns = FairQueue[str](9, 1.0)
    turns.add("link", "anna")
    for seconds in (0.5, 0.4, 7.0):
        assert turns.next() == "link"
        turns.charge(seconds)
    assert turns.next() is None
    turns.start_round()
    assert turns.next() == "link"


def test_persons_take_turns_and_then_their_links():
    turns = FairQueue[str](8, 1.0)
    for link in ("anna 1", "anna 2", "anna 3", "ben"):
        turns.add(link, link[:4])
    assert served_links(turns) == ["anna 1", "ben", "anna 2", "ben", "anna 3", "ben", "anna 1", "ben"]


def test_a_new_person_waits_at_most_one_turn_behind_a_full_queue():
    turns = FairQueue[str](1, 1.0)
    for number in range(60):
        turns.add(f"anna {number}", "anna")
    assert served_links(turns) == ["anna 0"]
    turns.add("ben", "ben")
    turns.start_round()
    turns.remove("anna 1")
    assert served_links(turns) == ["anna 2"]
    turns.start_round()
    assert served_links(turns) == ["ben"]


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 9), st.sampled_from(["anna", "ben", "carl"]))),
    st.lists(st.integers(0, 9)),
    st.integers(1, 40),
)
def test_each_round_is_shared_as_evenly_as_possible(added_links, removed_links, most):
    turns, waiting = FairQueue[int](most, 1.0), {}
    for link, person in added_links:
        if link not in waiting:
            waiting[link] = person
            turns.add(link, person)
    for link in removed_links:
        waiting.pop(link, None)
        turns.remove(link)
    had = Counter(iter(turns.next, None))
    assert had.total() == (most if waiting else 0)
    persons = Counter(dict.fromkeys(waiting.values(), 0))
    for link, count in had.items():
        persons[waiting[link]] += count
    shares = [persons, *(Counter({n: had[n] for n, p in waiting.items() if p == who}) for who in persons)]
    assert all(max(share.values()) - min(share.values()) <= 1 for share in shares if share)
