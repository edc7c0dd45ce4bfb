"""Mobility on disks, under a bad network, with hosts that die before or after what they know is kept.

The same test is run on machines that keep too little, to show that it can fail.
"""

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule
from kept_world import KeptWorld
from test_mobility_property import Wandering, explored, hosts, picks

from lfield.mobility.core import Mobility


class Surviving(Wandering):
    """Everything that can happen, and disks that are late."""

    world_type = KeptWorld

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


def test_no_copy_runs_twice_and_some_disk_has_each():
    explored(Surviving, Mobility, examples=60)


class Forgetful(Mobility):
    """Keeps nothing of what it sends or takes in."""

    forgets = ("PREPARED",)

    def __init__(self, *args, **options) -> None:
        super().__init__(*args, **options)
        keep = self._copies.keep

        def forget(copy):
            return [] if copy.state in self.forgets else keep(copy)

        self._copies.keep = forget


class Unprepared(Forgetful):
    """The page of what was sent is not on the disk."""


class Unaware(Forgetful):
    """The verdict on what came is not on the disk."""

    forgets = ("RUN",)


@pytest.mark.parametrize("machine", [Unprepared, Unaware])
def test_a_machine_that_keeps_too_little_is_found_out(machine):
    with pytest.raises(AssertionError):
        explored(Surviving, machine, examples=400, shrink=False)
