"""Signs of life that go round: who is heard, through whom, how soon, and why no rumour feeds itself."""

from __future__ import annotations

import heapq
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.mobility.hearsay import AHEAD, LEAST, MOST_LIVES, MOST_SIGNS, SIGN_EVERY, TELL_EVERY, Hearsay
from lfield.mobility.neighbours import Neighbourhood
from lfield.wire.messages import Heard, SignOfLife

HOSTS = ("a", "b", "c", "d")
#: Seconds that a message takes.
LATENCY = 0.02


def ears(host: str, incarnation: int = 1, now: float = 0.0, hosts=HOSTS) -> Hearsay:
    here = hosts.index(host)
    return Hearsay(hosts, here, incarnation, now, Neighbourhood(hosts, here))


def missing(hearsay: Hearsay, now: float, lost_after: float = 10.0) -> tuple[set[str], set[str]]:
    """Who is unheard, and who is elsewhere, when nobody answers."""
    absent = hearsay.absent((), now, lost_after, unmet=30.0)
    return set(absent.unheard), set(absent.elsewhere)


class Town:
    """Hosts that hear one another over the links that there are; `told` counts the messages."""

    def __init__(self, hosts: int, links=None) -> None:
        names = tuple(f"h{number}" for number in range(hosts))
        self.now, self.told, self.signs = 0.0, 0, 0
        self.ears = {name: ears(name, 7, hosts=names) for name in names}
        self._posted: list[tuple[float, int, str, str, Heard]] = []
        self._dead: set[str] = set()
        all_links = [(a, b) for a in names for b in self.ears[a].near if names.index(a) < names.index(b)]
        self.links = {frozenset(link) for link in (all_links if links is None else links)}
        for a, b in map(sorted, self.links):
            self.ears[a].linked(b, 7)
            self.ears[b].linked(a, 7)

    def cut(self, a: str, b: str) -> None:
        self.links.discard(frozenset((a, b)))
        for one, other in ((a, b), (b, a)):
            if one not in self._dead and self.ears[one].is_linked(other):
                self.ears[one].unlinked(other, self.now)

    def kill(self, host: str) -> None:
        self._dead.add(host)
        for link in [sorted(link) for link in self.links if host in link]:
            self.cut(*link)

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.01
            while self._posted and self._posted[0][0] <= self.now:
                _, _, sender, receiver, heard = heapq.heappop(self._posted)
                if frozenset((sender, receiver)) in self.links:
                    self.ears[receiver].told(sender, heard, self.now)
            for name, one in self.ears.items():
                one.wanted(self.now)
                if name not in self._dead and one.due is not None and one.due <= self.now:
                    self._post(name, one.tell(self.now))

    def _post(self, sender: str, told: list[tuple[str, Heard]]) -> None:
        for receiver, heard in told:
            self.told += 1
            self.signs = max(self.signs, len(heard.signs), len(heard.asked))
            heapq.heappush(self._posted, (self.now + LATENCY, self.told, sender, receiver, heard))

    def steps(self, host: str) -> dict[str, int]:
        """How many links are between a host and each that can be reached from it."""
        found, edge = {host: 0}, [host]
        while edge:
            near = {b for a in edge for link in self.links if a in link for b in link} - found.keys()
            found |= dict.fromkeys(near, found[edge[0]] + 1)
            edge = sorted(near)
        return found


def test_while_nobody_is_missed_nothing_is_told():
    town = Town(30)
    town.run(10.0)
    assert town.told == 0
    assert all(one.whole(town.now) for one in town.ears.values())


def bound(steps: int) -> float:
    """Seconds in which a question and its answer go over so many links each way."""
    return 2 * steps * (TELL_EVERY + LATENCY + 0.02) + 2 * SIGN_EVERY


@settings(deadline=None, max_examples=25)
@given(st.integers(3, 14), st.randoms(use_true_random=False))
def test_whatever_links_are_cut_a_live_host_is_heard_within_the_bound_as_long_as_the_rest_connects(
    number, dice
):
    town = Town(number)
    town.run(LEAST + 1.0)
    for link in dice.sample(sorted(map(sorted, town.links)), len(town.links)):
        whole = len(town.steps("h0"))
        town.links.discard(frozenset(link))
        if len(town.steps("h0")) < whole:
            town.links.add(frozenset(link))
        else:
            town.cut(*link)
            town.run(dice.choice([0.0, 0.3]))
    for name, one in town.ears.items():
        one.absent((), town.now, 10.0, 30.0)
        assert set(town.steps(name)) == set(town.ears)
    town.run(bound(max(max(town.steps(name).values()) for name in town.ears)))
    for _ in range(30):
        town.run(0.37)
        for name, one in town.ears.items():
            silent = bound(max(town.steps(name).values()))
            found = one.absent((), town.now, silent, silent)
            assert not found.unheard, (name, found.unheard)


@settings(deadline=None, max_examples=25)
@given(st.integers(3, 14), st.randoms(use_true_random=False))
def test_a_dead_host_is_given_up_in_time_by_all_and_then_nothing_more_is_told(number, dice):
    town = Town(number)
    town.run(LEAST + dice.random())
    town.kill("h1")
    town.run(2.0)
    told = town.told
    town.run(LEAST + 1.0)
    assert town.told == told
    for name, one in town.ears.items():
        if name != "h1":
            assert not one.whole(town.now)
            found = one.absent(set(town.ears) - {"h1"}, town.now, LEAST, 30.0)
            assert list(found.unheard) == ["h1"], name


def test_a_host_is_heard_through_a_chain_of_others():
    town = Town(4, [("h0", "h1"), ("h1", "h2"), ("h2", "h3")])
    for _ in range(30):
        town.run(1.0)
        if town.now > 2 * LEAST:
            assert missing(town.ears["h0"], town.now, LEAST) == (set(), {"h1", "h2", "h3"})


def test_a_dead_host_does_not_live_on_in_what_others_say_of_it():
    town = Town(4)
    town.run(5.0)
    town.kill("h3")
    town.run(10.5)
    for name in ("h0", "h1", "h2"):
        assert missing(town.ears[name], town.now)[0] == {"h3"}


def test_a_host_that_was_restarted_is_known_to_all_for_that():
    town = Town(20)
    town.run(5.0)
    town.kill("h9")
    town.run(1.0)
    town._dead.clear()
    town.ears["h9"] = ears("h9", 8, town.now, hosts=tuple(town.ears))
    for other in town.ears["h9"].near:
        town.links.add(frozenset(("h9", other)))
        town.ears["h9"].linked(other, 7)
        town.ears[other].linked("h9", 8)
    town.run(3.0)
    assert all(one.restarted == {"h9"} for name, one in town.ears.items() if name != "h9")


def test_messages_stay_small_when_all_of_a_large_team_is_missed():
    town = Town(100)
    town.run(LEAST + 1.0)
    one = town.ears["h0"]
    one.absent({"h1"}, town.now, 10.0, 30.0)
    town.run(6.0)
    assert town.signs <= MOST_SIGNS
    assert missing(one, town.now, LEAST)[0] == set()


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


def test_in_a_large_team_silence_begins_when_somebody_misses_it():
    hosts = tuple(f"h{number}" for number in range(20))
    one = ears("h0", hosts=hosts)
    assert "h10" not in one.near
    one.told("h1", Heard([], [SignOfLife(10, 5, AHEAD)]), 1000.0)
    assert "h10" in missing(one, 1009.0)[1]
    assert one.absent((), 1010.0, 10.0, 30.0).unheard["h10"] == 10.0


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
    a.linked("c", 1)
    a.told("c", Heard([SignOfLife(1, 11, 500)], []), 1.0)
    a.told("c", Heard([SignOfLife(1, 22, 1)], []), 20.0)
    assert "b" in missing(a, 29.0)[1]
    a.told("c", Heard([SignOfLife(1, 11, 500)], []), 29.0)
    assert "b" in missing(a, 30.0)[0]
    ((to, heard),) = a.tell(30.0)
    assert (to, heard.signs) == ("c", [SignOfLife(1, 22, 1)])


def test_no_question_hides_another_one_about_the_same_host():
    a = ears("a")
    a.linked("b", 1)
    questions = [SignOfLife(2, 7, AHEAD), SignOfLife(2, 0, AHEAD)]
    a.told("b", Heard([], questions), 1.0)
    ((_, heard),) = a.tell(1.0)
    assert heard.asked == questions


def test_whoever_is_asked_for_gives_no_more_signs_than_it_was_asked_for():
    a = ears("a", 9)
    a.linked("b", 1)
    a.told("b", Heard([], [SignOfLife(0, 9, 1 << 60)]), 0.0)
    counts = [
        sign.count
        for second in range(100)
        for _, heard in a.tell(float(second))
        for sign in heard.signs
        if sign.host == 0
    ]
    assert counts == list(range(1, AHEAD + 1))


def test_what_makes_no_sense_is_left_out_and_memory_is_bounded():
    a = ears("a")
    a.linked("b", 1)
    a.told("b", Heard([SignOfLife(0, 9, 9), SignOfLife(77, 1, 1)], [SignOfLife(88, 1, 1)]), 1.0)
    assert a.tell(2.0) == []
    for life in range(10 * MOST_LIVES):
        a.told("b", Heard([SignOfLife(1, life, 1)], []), 3.0)
    assert len(a._signs._counts[1]) == MOST_LIVES


def test_a_restart_is_seen_by_whoever_was_linked_before():
    a = ears("a")
    assert not a.linked("b", 1)
    a.unlinked("b", 1.0)
    assert not a.linked("b", 1)
    assert a.linked("b", 2)
    assert a.restarted == {"b"}


@pytest.mark.parametrize(("hosts", "due"), [(("a",), None), (("a", "b"), None), (("a", "b", "c"), 5.0)])
def test_two_hosts_have_nobody_to_tell_of(hosts, due):
    assert ears("a", now=5.0, hosts=hosts).due == due


# Neighbours


@pytest.mark.parametrize("number", [*range(2, 64), 100, 300, 1000])
def test_neighbours_are_few_mutual_and_near_to_everybody(number):
    hosts = [f"h{n}" for n in range(number)]
    near = {host: Neighbourhood(hosts, here).near for here, host in enumerate(hosts)}
    assert all(len(others) == min(8, number - 1) for others in near.values())
    assert all(host in near[other] for host, others in near.items() for other in others)
    found, edge, steps = {"h0"}, {"h0"}, 0
    while edge:
        edge = {other for host in edge for other in near[host]} - found
        found |= edge
        steps += bool(edge)
    assert len(found) == number
    assert steps <= 1 + 2 * round(number**0.25)


def test_in_the_place_of_neighbours_that_do_not_answer_the_next_are_called():
    hosts = [f"h{n}" for n in range(20)]
    one = Neighbourhood(hosts, 0)
    assert one.wanted(0.0) == one.near == {f"h{n}" for n in (1, 2, 3, 6, 14, 17, 18, 19)}
    for host in one.near - {"h6"}:
        one.linked(host)
    assert one.wanted(2.9) == one.near
    assert one.wanted(3.1) == one.near | {"h7"}
    one.linked("h7")
    assert one.wanted(60.0) == one.near | {"h7"}
    one.linked("h6")
    assert one.wanted(61.0) == one.near


def test_a_host_that_nobody_answers_comes_round_to_everybody():
    hosts = [f"h{n}" for n in range(20)]
    one = Neighbourhood(hosts, 4)
    dice = random.Random(1)
    now = 0.0
    while now < 100.0:
        now += dice.random()
        one.wanted(now)
    assert one.chosen == set(hosts) - {"h4"}
