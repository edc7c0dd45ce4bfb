"""Mobility under a network that loses, repeats, reorders and delays, and hosts that crash at any moment.

The same test is run on machines broken on purpose, to show that it can fail.
"""

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from mobility_world import TIMEOUT, World

from lfield.replication.transfer.core import Mobility

HOSTS = "abc"
AGENTS = {"Tour:one": "a", "Tour:two": "b"}

hosts = st.sampled_from(HOSTS)
picks = st.integers(0, 1 << 16)
rarely = st.integers(0, 4)  # the end of a coordinator must be rarer than its hops


class MobilityMachine(RuleBasedStateMachine):
    """All events, in any order."""

    machine = Mobility
    world_type = World

    def __init__(self) -> None:
        super().__init__()
        self.world = self.world_type(HOSTS, AGENTS, self.machine)
        for pair in self.world.unlinked_pairs():
            self.world.connect(*pair)
        while self.world.packets:
            self.world.deliver(self.world.packets.pop(0))

    def _running(self, pick: int):
        running = [(host, start) for host in self.world.hosts.values() for start in host.running]
        return running[pick % len(running)]

    def _any_running(self) -> bool:
        return any(host.running for host in self.world.hosts.values())

    def _take(self, pick: int):
        return self.world.packets.pop(pick % len(self.world.packets))

    @precondition(_any_running)
    @rule(pick=picks, goal=hosts)
    def wander(self, pick, goal) -> None:
        host, start = self._running(pick)
        self.world.work(host, start)
        if goal != host.name:
            self.world.wander(host, start, goal)

    @precondition(lambda self: self.world.packets)
    @rule(pick=picks)
    def deliver(self, pick) -> None:
        self.world.deliver(self._take(pick))

    @precondition(lambda self: self.world.packets)
    @rule(times=st.integers(1, 8))
    def deliver_in_order(self, times) -> None:
        for _ in range(times):
            if self.world.packets:
                self.world.deliver(self.world.packets.pop(0))

    @precondition(lambda self: self.world.packets)
    @rule(pick=picks)
    def lose(self, pick) -> None:
        self._take(pick)

    @precondition(lambda self: self.world.packets)
    @rule(pick=picks)
    def repeat(self, pick) -> None:
        self.world.packets.append(self.world.packets[pick % len(self.world.packets)])

    @precondition(lambda self: self.world.unlinked_pairs())
    @rule(pick=picks)
    def connect(self, pick) -> None:
        pairs = self.world.unlinked_pairs()
        self.world.connect(*pairs[pick % len(pairs)])

    @precondition(lambda self: self.world.open)
    @rule(pick=picks, noticed=st.booleans())
    def cut(self, pick, noticed) -> None:
        pairs = sorted(sorted(pair) for pair in self.world.open)
        one, other = pairs[pick % len(pairs)]
        self.world.cut(one, other)
        self.world.notice(one, other)
        if noticed:
            self.world.notice(other, one)

    @precondition(lambda self: self.world.open)
    @rule(pick=picks)
    def flap(self, pick) -> None:
        pairs = sorted(sorted(pair) for pair in self.world.open)
        one, other = pairs[pick % len(pairs)]
        self.world.cut(one, other)
        self.world.notice(one, other)
        self.world.notice(other, one)
        self.world.connect(one, other)

    @rule(one=hosts)
    def notice(self, one) -> None:
        for other in HOSTS:
            self.world.notice(one, other)

    @rule(name=hosts, back=st.booleans(), chance=rarely)
    def kill(self, name, back, chance) -> None:
        if chance == 0:
            if name in self.world.hosts:
                self.world.kill(name)
            if back:
                self.world.boot(name)

    @precondition(lambda self: len(self.world.hosts) < len(HOSTS))
    @rule()
    def boot(self) -> None:
        self.world.boot(next(name for name in HOSTS if name not in self.world.hosts))

    @rule(name=hosts, full=st.booleans())
    def fill(self, name, full) -> None:
        if name in self.world.hosts:
            self.world.hosts[name].full = full

    @precondition(_any_running)
    @rule(pick=picks, outcome=st.sampled_from(["done", "died"]), chance=rarely)
    def finish(self, pick, outcome, chance) -> None:
        if chance == 0:
            self.world.finish(*self._running(pick), outcome)

    @rule(seconds=st.sampled_from([1.0, TIMEOUT / 2, TIMEOUT + 1]))
    def wait(self, seconds) -> None:
        self.world.advance(seconds)

    @invariant()
    def promises(self) -> None:
        self.world.check()

    def teardown(self) -> None:
        self.world.heal()
        self.world.check_healed()


def explore(machine: type[Mobility], examples: int, shrink: bool = True) -> None:
    explored(MobilityMachine, machine, examples, shrink=shrink)


def explored(
    events: type[MobilityMachine],
    machine: type[Mobility],
    examples: int,
    steps: int = 60,
    shrink: bool = True,
) -> None:
    broken = type(f"{events.__name__}{machine.__name__}", (events,), {"machine": machine})
    run_state_machine_as_test(
        broken,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            derandomize=True,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate, Phase.shrink] if shrink else [Phase.generate],
        ),
    )


def test_no_coordinator_has_two_live_copies_or_vanishes():
    explore(Mobility, examples=120)


class ResumesAfterSending(Mobility):
    """Appendix I as printed: without an answer the call throws, and the coordinator continues."""

    def tick(self, now):
        effects = []
        for copy in self._copies:
            if copy.state == "PREPARED" and now >= copy.deadline:
                effects += self._sender._resume(copy, "UnreachableResourceException", "no answer")
        return effects + super().tick(now)


class AdmitsRepeatedTransfers(Mobility):
    """Admits every transfer, also a repeated one."""

    def on_transfer(self, host, header, block, inject):
        copy = self._copies.find(header.agent, header.generation)
        if copy is not None and copy.state in ("MOVED", "RUN"):
            copy.sequence, copy.state = header.sequence - 1, "MOVED"
        return super().on_transfer(host, header, block, inject)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("machine", "words"),
    [(ResumesAfterSending, "2 live copies"), (AdmitsRepeatedTransfers, "injected 2 times")],
)
def test_a_broken_transfer_protocol_is_found(machine, words):
    with pytest.raises(AssertionError, match=words):
        explore(machine, examples=1000, shrink=False)
