"""Mobility with disks, under a faulty network, with hosts that crash before or after their records are
durable.

The same test is run on machines that store too little, to show that it can fail.
"""

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule
from journaled_world import JournaledWorld
from test_mobility_property import AGENTS, HOSTS, MobilityMachine, explored, hosts, picks, rarely

from lfield.replication.transfer.core import Mobility


class DurableMobilityMachine(MobilityMachine):
    """All events, with disks that are late."""

    world_type = JournaledWorld

    @rule(name=hosts)
    def sync(self, name) -> None:
        if name in self.world.hosts:
            self.world.sync(name)

    @precondition(lambda self: any(host.running for host in self.world.hosts.values()))
    @rule(pick=picks)
    def save(self, pick) -> None:
        self.world.save(*self._running(pick))

    @rule(name=hosts, sync=st.booleans())
    def crash(self, name, sync) -> None:
        if name in self.world.hosts:
            if sync:
                self.world.sync(name)
            self.world.kill(name)
            self.world.boot(name)


class Declared(DurableMobilityMachine):
    """Also hosts that an operator correctly declares lost; some return later, and are informed first."""

    @precondition(lambda self: any(host.running for host in self.world.hosts.values()))
    @rule(pick=picks, goal=hosts)
    def travel(self, pick, goal) -> None:
        """A hop without faults if possible: recoveries start from shadows."""
        host, start = self._running(pick)
        if goal != host.name:
            self.world.wander(host, start, goal)
        for _ in range(3):
            for name in self.world.hosts:
                self.world.sync(name)
            self.deliver_in_order(len(self.world.packets))

    @precondition(lambda self: self._left())
    @rule(pick=picks, sync=st.booleans(), chance=rarely)
    def recover(self, pick, sync, chance) -> None:
        found = self._left()
        host, agent = found[pick % len(found)]
        if chance < 2 and self.world.declare_newer_lost(host, agent):
            self.world.recover(host, agent)
            if sync:
                self.world.sync(host.name)

    def _left(self):
        everyone = [(host, agent) for host in self.world.hosts.values() for agent in AGENTS]
        return [found for found in everyone if self.world.recoverable(*found)]

    @precondition(lambda self: self.world.gone)
    @rule(chance=rarely)
    def come_back(self, chance) -> None:
        # All other hosts must be up: a stopped one may have the only record.
        if chance == 0 and len(self.world.hosts) + len(self.world.gone) == len(HOSTS):
            self.world.come_back(sorted(self.world.gone)[0])

    @precondition(lambda self: len(self.world.hosts) + len(self.world.gone) < len(HOSTS))
    @rule()
    def boot(self) -> None:
        up = self.world.hosts.keys() | self.world.gone
        self.world.boot(next(name for name in HOSTS if name not in up))

    def kill(self, name, back, chance) -> None:
        """Do nothing: `crash` ends lives."""


def test_no_copy_runs_twice_and_each_is_on_some_disk():
    explored(DurableMobilityMachine, Mobility, examples=60)


@pytest.mark.few(0)
def test_a_truly_declared_recovery_makes_no_second_copy():
    explored(Declared, Mobility, examples=60)


class ForgetsItsAnswer(Mobility):
    """Stores nothing about transfers that it sends or accepts."""

    forgets = ("PREPARED",)

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        keep = self._copies.persist

        def forget(copy, **options):
            return [] if copy.state in self.forgets else keep(copy, **options)

        self._copies.persist = forget


class SentTransferNotOnDisk(ForgetsItsAnswer):
    """The record of the sent transfer is not on the disk."""


class AdmissionNotOnDisk(ForgetsItsAnswer):
    """The verdict on the received transfer is not on the disk."""

    forgets = ("RUN",)


class IgnoresRecoveries(Mobility):
    """Continues the copy on its disk before it receives a recovery."""

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        self._termination.fence = lambda *_: []
        self._termination.compare_starts = lambda *_: []
        self._termination.stop_for_other_start = lambda *_: []


def test_a_restarted_host_that_ignores_a_failover_is_found():
    """A restarted host resumes the copy on its disk and ignores messages about a failover."""
    with pytest.raises(AssertionError, match="side by side"):
        explored(Declared, IgnoresRecoveries, examples=400, shrink=False)


@pytest.mark.few(1)
@pytest.mark.parametrize("machine", [SentTransferNotOnDisk, AdmissionNotOnDisk])
def test_a_host_that_stores_too_little_is_found(machine):
    with pytest.raises(AssertionError):
        explored(DurableMobilityMachine, machine, examples=400, shrink=False)
