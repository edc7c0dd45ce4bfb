"""Signs of life that go round: who is heard, through whom, and why no rumour feeds itself."""

from __future__ import annotations

import pytest

from lfield.mobility.hearsay import LEAST, MOST_LIVES, Hearsay
from lfield.wire.messages import Heard, SignOfLife

HOSTS = ("a", "b", "c", "d")


def ears(host: str, incarnation: int = 1, now: float = 0.0) -> Hearsay:
    return Hearsay(HOSTS, HOSTS.index(host), incarnation, now)


def missing(hearsay: Hearsay, now: float, lost_after: float = 10.0) -> tuple[set[str], set[str]]:
    """Who is unheard, and who is elsewhere, when nobody answers."""
    absent = hearsay.absent((), now, lost_after, unmet=30.0)
    return set(absent.unheard), set(absent.elsewhere)


def test_a_host_is_heard_through_a_chain_of_others():
    a, b, c, d = (ears(host) for host in HOSTS)
    for now in range(1, 100):
        for teller, listener in ((d, c), (c, b), (b, a)):
            listener.told(teller.tell(now), now)
    assert missing(a, 99.0) == (set(), {"b", "c", "d"})


def test_a_dead_host_does_not_live_on_in_what_others_say_of_it():
    a, b, c, d = (ears(host) for host in HOSTS)
    c.told(d.tell(0.0), 1.0)
    now = 1.0
    while now < 15.0:
        for teller, listener in ((c, b), (b, c), (b, a), (a, b), (c, a), (a, c)):
            now += 0.1
            listener.told(teller.tell(now), now)
    for listener in (a, b, c):
        assert missing(listener, now)[0] == {"d"}


def test_a_host_that_is_linked_is_heard_and_silence_begins_with_the_end_of_the_link():
    a = ears("a")
    a.linked("b", 1)
    assert "b" in missing(a, 1000.0)[1]
    a.unlinked("b", 1000.0)
    assert "b" in missing(a, 1009.9)[1]
    assert a.absent((), 1010.0, 10.0, 30.0).unheard["b"] == 10.0


def test_one_that_never_gave_a_sign_has_longer():
    a = ears("a", now=100.0)
    assert missing(a, 129.9) == (set(), {"b", "c", "d"})
    assert missing(a, 130.0) == ({"b", "c", "d"}, set())


def test_no_silence_is_shorter_than_a_sign_takes():
    a = ears("a")
    a.linked("b", 1)
    a.unlinked("b", 50.0)
    assert "b" in missing(a, 50.0 + LEAST - 0.1, lost_after=0.5)[1]
    assert "b" in missing(a, 50.0 + LEAST, lost_after=0.5)[0]


def test_who_answers_and_who_is_gone_is_not_missing():
    a = ears("a")
    a.linked("b", 7)
    a.gone.add("c")
    absent = a.absent({"b"}, 100.0, 10.0, 30.0)
    assert (set(absent.gone), set(absent.unheard), list(absent.elsewhere)) == ({"c"}, {"d"}, [])
    assert absent.lives == {"b": 7}


def test_a_new_life_counts_from_the_beginning_and_an_old_one_is_no_news():
    a = ears("a")
    a.told(Heard([SignOfLife(1, 11, 500)]), 1.0)
    a.told(Heard([SignOfLife(1, 22, 1)]), 20.0)
    assert "b" in missing(a, 29.0)[1]
    a.told(Heard([SignOfLife(1, 11, 500)]), 29.0)
    assert "b" in missing(a, 30.0)[0]
    assert SignOfLife(1, 22, 1) in a.tell(30.0).signs


def test_what_makes_no_sense_is_left_out_and_memory_is_bounded():
    a = ears("a")
    a.told(Heard([SignOfLife(0, 9, 9), SignOfLife(77, 1, 1)]), 1.0)
    assert a.tell(2.0).signs == [SignOfLife(0, 1, 1)]
    for life in range(10 * MOST_LIVES):
        a.told(Heard([SignOfLife(1, life, 1)]), 3.0)
    assert len(a._counts[1]) == MOST_LIVES


def test_a_restart_is_seen_by_whoever_was_linked_before():
    a = ears("a")
    assert not a.linked("b", 1)
    a.unlinked("b", 1.0)
    assert not a.linked("b", 1)
    assert a.linked("b", 2)
    assert a.restarted == {"b"}


@pytest.mark.parametrize(("hosts", "due"), [(("a",), None), (("a", "b"), None), (("a", "b", "c"), 5.0)])
def test_two_hosts_have_nobody_to_tell_of(hosts, due):
    assert Hearsay(hosts, 0, 1, 5.0).due == due
