"""The dead-man's monitor of devices, in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from lfield.driver.binding import DeviceBinding, OrphanPolicy
from lfield.host.effects import MakeDeviceSafe
from lfield.host.team.orphaned_devices import MAX_PARALLEL_QUERIES, DeadmanMonitor
from lfield.replication.locate.outcomes import UnavailableHosts
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import CoordinatorState, Locate

AFTER = 20.0


def binding(name: str, without: OrphanPolicy | None) -> DeviceBinding:
    return DeviceBinding(
        agent="a", field=name, type="T", driver="d", endpoint="e", safe_state="stop", without_policy=without
    )


def at(
    host: str, sequence: int, state: str = "MOVED", agent: str = "pilot", outcome: str = ""
) -> CoordinatorState:
    return CoordinatorState(agent, 1, sequence, sequence, state, "" if state == "RUN" else host, outcome)


@dataclass
class Rig:
    """A host `here` with a copter and a winch that depend on their users, and a lamp that does not.

    `links` are the hosts that it can ask, `hearsay` those that only others can reach, `own` its own records.
    `has` are the hosts that answer, each with its records.
    """

    links: list[str] = field(default_factory=list)
    hearsay: list[str] = field(default_factory=list)
    own: list[CoordinatorState] = field(default_factory=list)
    has: dict[str, list[CoordinatorState]] = field(default_factory=dict)
    now: float = 100.0

    def __post_init__(self) -> None:
        land, brake = OrphanPolicy(AFTER, "land"), OrphanPolicy(2 * AFTER, "brake")
        self.core = DeadmanMonitor([binding("fc", land), binding("winch", brake), binding("lamp", None)])
        self.asked: list[tuple[float, str]] = []
        self.gone: list[tuple[float, MakeDeviceSafe]] = []

    def unavailable_hosts(
        self, answered: object, now: float, lost_after: float, unmet: float
    ) -> UnavailableHosts:
        return UnavailableHosts(reachable_by_others=[*self.links, *self.hearsay])

    def wait(self, seconds: float) -> None:
        """Let time pass; reachable hosts answer at once."""
        end = self.now + seconds
        while self.core.due is not None and self.core.due <= end:
            self.now = max(self.now, self.core.due)
            for effect in self.core.check("here", self.own, self, self.now):
                if isinstance(effect, Send):
                    assert isinstance(effect.message, Locate)
                    assert effect.message.agents
                    self.asked.append((self.now, effect.host))
                    if effect.host in self.has:
                        self.core.on_states(effect.host, self.has[effect.host], self.now)
                else:
                    self.gone.append((self.now, effect))
        self.now = end

    def use(self, device: str = "a.fc", coordinator: str = "pilot") -> None:
        self.core.on_used(device, coordinator, self.now)


def test_an_unused_device_or_one_without_a_policy_has_no_deadline():
    rig = Rig()
    rig.use("a.lamp")
    assert rig.core.due is None


def test_a_local_coordinator_counts_as_alive_without_using_the_device():
    rig = Rig(own=[at("", 0, "RUN")])
    rig.use()
    rig.wait(1000.0)
    assert (rig.asked, rig.gone) == ([], [])


def test_after_a_local_end_each_device_is_made_safe_at_its_own_time():
    rig = Rig(own=[at("", 0, "RUN")])
    rig.use("a.fc")
    rig.use("a.winch")
    rig.wait(50.0)
    rig.own = [at("here", 0, "EXITED", outcome="done")]
    rig.wait(100.0)
    (first, fc), (second, winch) = rig.gone
    reason = "no coordinator that used it (pilot, done) has been confirmed alive for 20 s"
    assert fc == MakeDeviceSafe("a.fc", "land", reason, ("pilot",))
    assert (winch.device, winch.state) == ("a.winch", "brake")
    assert (first, second) == (pytest.approx(170.0, abs=1.01), pytest.approx(190.0, abs=1.01))
    assert rig.core.due is None


def test_the_host_that_the_coordinator_left_for_is_asked_then_the_next():
    rig = Rig(["b", "c", "d"], own=[at("b", 1)], has={"b": [at("", 1, "RUN")], "c": []})
    rig.use()
    rig.wait(60.0)
    assert {host for _, host in rig.asked} == {"b"}
    assert len(rig.asked) <= 60.0 / (AFTER / 4.0) + 1
    rig.has = {"b": [at("c", 2)], "c": [at("", 2, "RUN")]}
    rig.asked.clear()
    rig.wait(60.0)
    assert rig.gone == []
    assert [host for _, host in rig.asked[-3:]] == ["c"] * 3


def test_a_device_is_made_safe_when_the_host_of_its_user_restarts_without_it():
    rig = Rig(["b"], own=[at("b", 1)], has={"b": [at("", 1, "RUN")]})
    rig.use()
    rig.wait(60.0)
    rig.has = {"b": []}
    rig.wait(AFTER + AFTER / 4.0 + 1.0)
    ((_, reason),) = rig.gone
    assert "(pilot, last known at b) has been confirmed alive for 20 s" in reason.reason


def test_a_cut_link_has_no_effect_while_other_hosts_reach_the_peer():
    rig = Rig(["c"], hearsay=["b"], own=[at("b", 1)], has={"c": []})
    rig.use()
    rig.wait(500.0)
    assert rig.gone == []
    rig.hearsay = []
    rig.wait(AFTER + 1.0)
    assert len(rig.gone) == 1


def test_a_coordinator_behind_a_cut_link_is_found_through_others():
    rig = Rig(["c", "d"], own=[at("b", 1)], has={"d": [at("", 2, "RUN")], "c": []})
    rig.use()
    rig.wait(500.0)
    assert rig.gone == []
    assert {host for _, host in rig.asked[-20:]} == {"d"}


def test_an_end_behind_a_cut_link_is_learned_from_others():
    rig = Rig(["c"], hearsay=["b"], own=[at("b", 5)], has={"c": []})
    rig.use()
    rig.wait(500.0)
    assert rig.gone == []
    rig.has = {"c": [at("b", 0, "EXITED", outcome="died")]}
    rig.wait(AFTER + 2.0)
    assert "(pilot, died)" in rig.gone[0][1].reason


def test_many_hosts_are_asked_in_turn_a_few_at_a_time():
    hosts = [f"h{n:02d}" for n in range(50)]
    rig = Rig(hosts, own=[at("lost", 1)])
    rig.use()
    rig.wait(AFTER)
    moments = [when for when, _ in rig.asked]
    assert max(map(moments.count, moments)) <= MAX_PARALLEL_QUERIES
    assert {host for _, host in rig.asked} == set(hosts)


def test_one_live_user_is_enough_and_only_users_count():
    rig = Rig(own=[at("", 0, "RUN", "second"), at("", 0, "RUN", "stranger")])
    rig.use(coordinator="pilot")
    rig.use(coordinator="second")
    rig.wait(100.0)
    assert rig.gone == []
    rig.own = rig.own[1:]
    rig.wait(100.0)
    assert len(rig.gone) == 1


def test_a_device_is_made_safe_once_until_it_is_used_again():
    rig = Rig()
    rig.use()
    rig.wait(500.0)
    assert len(rig.gone) == 1
    rig.use()
    rig.wait(500.0)
    assert len(rig.gone) == 2
