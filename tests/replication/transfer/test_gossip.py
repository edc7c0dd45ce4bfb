"""Gossip about live hosts: indirect contacts, their delay, and the absence of echoes."""

from __future__ import annotations

import heapq
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.replication.membership.membership import (
    GOSSIP_EVERY,
    HEARTBEAT_CREDIT,
    HEARTBEAT_EVERY,
    MAX_COUNTERS,
    MAX_INCARNATIONS,
    SUSPICION_TIMEOUT,
    Membership,
)
from lfield.replication.membership.overlay import Overlay
from lfield.wire.messages import GossipUpdate, LivenessCounter

HOSTS = ("a", "b", "c", "d")
#: Delay of a message in seconds.
LATENCY = 0.02


class Contacts:
    """Links without measurements, or with those of a test."""

    def __init__(self, down=(), heard=()) -> None:
        self.down_since, self._heard = dict(down), dict(heard)

    def last_contact_at(self, host: str) -> float | None:
        return self._heard.get(host)


def membership_of(host: str, incarnation: int = 1, now: float = 0.0, hosts=HOSTS) -> Membership:
    here = hosts.index(host)
    numbers = {host: number for number, host in enumerate(hosts)}
    return Membership(hosts, numbers, here, incarnation, now, Overlay(hosts, here), Contacts())


def missing(hearsay: Membership, now: float, lost_after: float = 10.0) -> tuple[set[str], set[str]]:
    """The silent hosts, and those reachable by others, when no host answers."""
    unreachable = hearsay.unavailable_hosts((), now, lost_after, unmet=30.0)
    return set(unreachable.silent_for), set(unreachable.reachable_by_others)


class GossipTeam:
    """Hosts that exchange gossip over the present links; `sent` counts the messages."""

    def __init__(self, hosts: int, links=None) -> None:
        names = tuple(f"h{number}" for number in range(hosts))
        self.now, self.sent, self.signs = 0.0, 0, 0
        self.membership_of = {name: membership_of(name, 7, hosts=names) for name in names}
        self._posted: list[tuple[float, int, str, str, GossipUpdate]] = []
        self._dead: set[str] = set()
        all_links = [
            (a, b) for a in names for b in self.membership_of[a].neighbours if names.index(a) < names.index(b)
        ]
        self.links = {frozenset(link) for link in (all_links if links is None else links)}
        for a, b in map(sorted, self.links):
            self.membership_of[a].on_linked(b, 7)
            self.membership_of[b].on_linked(a, 7)

    def cut(self, a: str, b: str) -> None:
        self.links.discard(frozenset((a, b)))
        for one, other in ((a, b), (b, a)):
            if one not in self._dead and self.membership_of[one].is_linked(other):
                self.membership_of[one].on_unlinked(other, self.now)

    def kill(self, host: str) -> None:
        self._dead.add(host)
        for link in [sorted(link) for link in self.links if host in link]:
            self.cut(*link)

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.01
            while self._posted and self._posted[0][0] <= self.now:
                _, _, sender, receiver, gossip = heapq.heappop(self._posted)
                if frozenset((sender, receiver)) in self.links:
                    self.membership_of[receiver].on_gossip(sender, gossip, self.now)
            for name, one in self.membership_of.items():
                one.overlay_links(self.now)
                if name not in self._dead and one.due is not None and one.due <= self.now:
                    self._post(name, one.next_gossip(self.now))

    def _post(self, sender: str, sent: list[tuple[str, GossipUpdate]]) -> None:
        for receiver, gossip in sent:
            self.sent += 1
            self.signs = max(self.signs, len(gossip.counters), len(gossip.probes))
            heapq.heappush(self._posted, (self.now + LATENCY, self.sent, sender, receiver, gossip))

    def steps(self, host: str) -> dict[str, int]:
        """The number of links between a host and each that can be reached from it."""
        found, edge = {host: 0}, [host]
        while edge:
            near = {b for a in edge for link in self.links if a in link for b in link} - found.keys()
            found |= dict.fromkeys(near, found[edge[0]] + 1)
            edge = sorted(near)
        return found


def test_no_gossip_is_sent_while_no_host_is_missed():
    team = GossipTeam(30)
    team.run(10.0)
    assert team.sent == 0
    assert all(one.is_fully_connected(team.now) for one in team.membership_of.values())


def bound(steps: int) -> float:
    """Seconds in which a query and its answer pass a number of links each way."""
    return 2 * steps * (GOSSIP_EVERY + LATENCY + 0.02) + 2 * HEARTBEAT_EVERY


@pytest.mark.few(0)
@settings(deadline=None, max_examples=25)
@given(st.integers(3, 14), st.randoms(use_true_random=False))
def test_under_any_cuts_a_reachable_host_is_heard_within_the_bound(number, dice):
    team = GossipTeam(number)
    team.run(SUSPICION_TIMEOUT + 1.0)
    for link in dice.sample(sorted(map(sorted, team.links)), len(team.links)):
        full_count = len(team.steps("h0"))
        team.links.discard(frozenset(link))
        if len(team.steps("h0")) < full_count:
            team.links.add(frozenset(link))
        else:
            team.cut(*link)
            team.run(dice.choice([0.0, 0.3]))
    for name, one in team.membership_of.items():
        one.unavailable_hosts((), team.now, 10.0, 30.0)
        assert set(team.steps(name)) == set(team.membership_of)
    team.run(bound(max(max(team.steps(name).values()) for name in team.membership_of)))
    for _ in range(30):
        team.run(0.37)
        for name, one in team.membership_of.items():
            silent = bound(max(team.steps(name).values()))
            found = one.unavailable_hosts((), team.now, silent, silent)
            assert not found.silent_for, (name, found.silent_for)


@settings(deadline=None, max_examples=25)
@given(st.integers(3, 14), st.randoms(use_true_random=False))
def test_a_dead_host_is_given_up_by_all_in_time_and_gossip_ends(number, dice):
    team = GossipTeam(number)
    team.run(SUSPICION_TIMEOUT + dice.random())
    team.kill("h1")
    team.run(2.0)
    sent = team.sent
    team.run(SUSPICION_TIMEOUT + 1.0)
    assert team.sent == sent
    for name, one in team.membership_of.items():
        if name != "h1":
            assert not one.is_fully_connected(team.now)
            found = one.unavailable_hosts(set(team.membership_of) - {"h1"}, team.now, SUSPICION_TIMEOUT, 30.0)
            assert list(found.silent_for) == ["h1"], name


def test_a_host_is_heard_through_a_chain_of_others():
    team = GossipTeam(4, [("h0", "h1"), ("h1", "h2"), ("h2", "h3")])
    for _ in range(30):
        team.run(1.0)
        if team.now > 2 * SUSPICION_TIMEOUT:
            assert missing(team.membership_of["h0"], team.now, SUSPICION_TIMEOUT) == (
                set(),
                {"h1", "h2", "h3"},
            )


def test_gossip_does_not_keep_a_dead_host_alive():
    team = GossipTeam(4)
    team.run(5.0)
    team.kill("h3")
    team.run(10.5)
    for name in ("h0", "h1", "h2"):
        assert missing(team.membership_of[name], team.now)[0] == {"h3"}


def test_all_hosts_learn_that_a_host_was_restarted():
    team = GossipTeam(20)
    team.run(5.0)
    team.kill("h9")
    team.run(1.0)
    team._dead.clear()
    team.membership_of["h9"] = membership_of("h9", 8, team.now, hosts=tuple(team.membership_of))
    for other in team.membership_of["h9"].neighbours:
        team.links.add(frozenset(("h9", other)))
        team.membership_of["h9"].on_linked(other, 7)
        team.membership_of[other].on_linked("h9", 8)
    team.run(3.0)
    assert all(one.restarted == {"h9"} for name, one in team.membership_of.items() if name != "h9")


@pytest.mark.few(0)
def test_messages_stay_small_when_all_of_a_large_team_is_missed():
    team = GossipTeam(100)
    team.run(SUSPICION_TIMEOUT + 1.0)
    one = team.membership_of["h0"]
    one.unavailable_hosts({"h1"}, team.now, 10.0, 30.0)
    team.run(6.0)
    assert team.signs <= MAX_COUNTERS
    assert missing(one, team.now, SUSPICION_TIMEOUT)[0] == set()


def test_a_linked_host_is_alive_and_silence_begins_with_the_end_of_the_link():
    a = membership_of("a")
    a.on_linked("b", 1)
    assert "b" in missing(a, 1000.0)[1]
    a.on_unlinked("b", 1000.0)
    assert "b" in missing(a, 1009.9)[1]
    assert a.unavailable_hosts((), 1010.0, 10.0, 30.0).silent_for["b"] == 10.0


def test_a_host_without_any_sign_of_life_has_more_time():
    a = membership_of("a", now=100.0)
    assert missing(a, 129.9) == (set(), {"b", "c", "d"})
    assert missing(a, 130.0) == ({"b", "c", "d"}, set())


def test_in_a_large_team_silence_begins_when_a_host_is_missed():
    hosts = tuple(f"h{number}" for number in range(20))
    one = membership_of("h0", hosts=hosts)
    assert "h10" not in one.neighbours
    one.on_gossip("h1", GossipUpdate([], [LivenessCounter(10, 5, HEARTBEAT_CREDIT)]), 1000.0)
    assert "h10" in missing(one, 1009.0)[1]
    assert one.unavailable_hosts((), 1010.0, 10.0, 30.0).silent_for["h10"] == 10.0


def test_silence_is_never_shorter_than_the_suspicion_time_out():
    a = membership_of("a")
    a.on_linked("b", 1)
    a.on_unlinked("b", 50.0)
    assert "b" in missing(a, 50.0 + SUSPICION_TIMEOUT - 0.1, lost_after=0.5)[1]
    assert "b" in missing(a, 50.0 + SUSPICION_TIMEOUT, lost_after=0.5)[0]


def test_hosts_that_answer_or_have_ended_are_not_missing():
    a = membership_of("a")
    a.on_linked("b", 7)
    a.ended.add("c")
    unreachable = a.unavailable_hosts({"b"}, 100.0, 10.0, 30.0)
    assert (set(unreachable.ended), set(unreachable.silent_for), list(unreachable.reachable_by_others)) == (
        {"c"},
        {"d"},
        [],
    )
    assert unreachable.state_ids == {"b": 7}


def test_a_new_life_counts_from_the_beginning_and_an_old_one_is_ignored():
    a = membership_of("a")
    a.on_linked("c", 1)
    a.on_gossip("c", GossipUpdate([LivenessCounter(1, 11, 500)], []), 1.0)
    a.on_gossip("c", GossipUpdate([LivenessCounter(1, 22, 1)], []), 20.0)
    assert "b" in missing(a, 29.0)[1]
    a.on_gossip("c", GossipUpdate([LivenessCounter(1, 11, 500)], []), 29.0)
    assert "b" in missing(a, 30.0)[0]
    ((to, gossip),) = a.next_gossip(30.0)
    assert (to, gossip.counters) == ("c", [LivenessCounter(1, 22, 1)])


def test_queries_about_the_same_host_are_all_forwarded():
    a = membership_of("a")
    a.on_linked("b", 1)
    questions = [LivenessCounter(2, 7, HEARTBEAT_CREDIT), LivenessCounter(2, 0, HEARTBEAT_CREDIT)]
    a.on_gossip("b", GossipUpdate([], questions), 1.0)
    ((_, gossip),) = a.next_gossip(1.0)
    assert gossip.probes == questions


def test_a_queried_host_gives_no_more_signs_than_requested():
    a = membership_of("a", 9)
    a.on_linked("b", 1)
    a.on_gossip("b", GossipUpdate([], [LivenessCounter(0, 9, 1 << 60)]), 0.0)
    counts = [
        sign.count
        for second in range(100)
        for _, gossip in a.next_gossip(float(second))
        for sign in gossip.counters
        if sign.host == 0
    ]
    assert counts == list(range(1, HEARTBEAT_CREDIT + 1))


def test_invalid_gossip_is_ignored_and_memory_is_bounded():
    a = membership_of("a")
    a.on_linked("b", 1)
    a.on_gossip(
        "b",
        GossipUpdate([LivenessCounter(0, 9, 9), LivenessCounter(77, 1, 1)], [LivenessCounter(88, 1, 1)]),
        1.0,
    )
    assert a.next_gossip(2.0) == []
    for life in range(10 * MAX_INCARNATIONS):
        a.on_gossip("b", GossipUpdate([LivenessCounter(1, life, 1)], []), 3.0)
    assert len(a._counters._counts[1]) == MAX_INCARNATIONS


def test_a_restart_is_noticed_by_a_host_that_was_linked_before():
    a = membership_of("a")
    assert not a.on_linked("b", 1)
    a.on_unlinked("b", 1.0)
    assert not a.on_linked("b", 1)
    assert a.on_linked("b", 2)
    assert a.restarted == {"b"}


@pytest.mark.parametrize(("hosts", "due"), [(("a",), None), (("a", "b"), None), (("a", "b", "c"), 5.0)])
def test_teams_of_two_hosts_send_no_gossip(hosts, due):
    assert membership_of("a", now=5.0, hosts=hosts).due == due


# Neighbours


@pytest.mark.parametrize("number", [*range(2, 64), 100, 300, 1000])
def test_neighbours_are_few_mutual_and_near_to_all_hosts(number):
    hosts = [f"h{n}" for n in range(number)]
    near = {host: Overlay(hosts, here).neighbours for here, host in enumerate(hosts)}
    assert all(len(others) == min(8, number - 1) for others in near.values())
    assert all(host in near[other] for host, others in near.items() for other in others)
    found, edge, steps = {"h0"}, {"h0"}, 0
    while edge:
        edge = {other for host in edge for other in near[host]} - found
        found |= edge
        steps += bool(edge)
    assert len(found) == number
    assert steps <= 1 + 2 * round(number**0.25)


def test_neighbours_that_do_not_answer_are_replaced():
    hosts = [f"h{n}" for n in range(20)]
    one = Overlay(hosts, 0)
    assert one.links(0.0) == one.neighbours == {f"h{n}" for n in (1, 2, 3, 6, 14, 17, 18, 19)}
    for host in one.neighbours - {"h6"}:
        one.on_linked(host)
    assert one.links(2.9) == one.neighbours
    assert one.links(3.1) == one.neighbours | {"h7"}
    one.on_linked("h7")
    assert one.links(60.0) == one.neighbours | {"h7"}
    one.on_linked("h6")
    assert one.links(61.0) == one.neighbours


def test_a_host_without_answers_dials_all_others_in_time():
    hosts = [f"h{n}" for n in range(20)]
    one = Overlay(hosts, 4)
    rng = random.Random(1)
    now = 0.0
    while now < 100.0:
        now += rng.random()
        one.links(now)
    assert one.chosen == set(hosts) - {"h4"}


def test_the_liveness_of_a_host_is_its_own_last_contact_and_its_missing_link() -> None:
    contacts = Contacts(down={"b": 12.0, "c": 15.0}, heard={"b": 11.0})
    numbers = {host: number for number, host in enumerate(HOSTS)}
    one = Membership(HOSTS, numbers, 0, 1, 10.0, Overlay(HOSTS, 0), contacts)
    assert [one.last_contact(host) for host in "bcd"] == [11.0, None, None]
    assert [one.missing_for(host, 20.0) for host in "bcd"] == [8.0, 5.0, 0.0]
    one.on_linked("b", 7)
    assert one.missing_for("b", 20.0) == 0.0
    one.on_unlinked("b", 30.0)
    one.on_gossip("c", GossipUpdate([LivenessCounter(1, 7, 3)], []), 40.0)
    assert one.last_contact("b") == 11.0, "only another host has contact"
