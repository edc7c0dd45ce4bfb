"""Hooks of a machine: access rules of portal calls, an observer, stubs of resources, a meter.

On a robot only the access rules of its mission are attached, if it has any. An observer is notified and
changes no state; a stub answers the portals of one resource in place of its program, for tests of missions; a
meter gets the number of executed instructions, for simulated computing time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from msgspec import Struct, field

from lfield.vm.agent import Agent, TeamMember
from lfield.vm.memory.block import Block
from lfield.vm.turns.run_limit import RunLimit

#: The reason why a call must not start, '' when it may. The arguments are the ids of coordinator and
#: resource, and the portal's index.
CallRules = Callable[[str, str, int], str]


class PortalObserver(Protocol):
    """Observer of the portal calls of a machine, by `pcall` or in a `together`; `number` identifies a call in
    one incarnation of the host. A place is a position in the resource's block, valid during the call of the
    method.

    The end of a call is also reported if its coordinator does not wait for it any more.
    """

    def on_call_started(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """A portal (by index) has started: its arguments are in the frame of its thread."""

    def on_call_returned(self, resource: Agent, number: int, word: int) -> None:
        """A portal has returned; `word` is the result as in a slot."""

    def on_call_threw(self, resource: Agent, number: int, thrown: int) -> None:
        """A portal has ended by an exception, the object at the place `thrown`."""

    def on_resource_died(self, resource: Agent, reason: str) -> None:
        """A resource has died, and all its portals have ended."""


class StubCall(Protocol):
    """A portal call for a stub, which answers by `return_result` or `throw`, now or later, once.

    The answer to a call that was cancelled and has ended is dropped.
    """

    @property
    def resource(self) -> Agent:
        """The resource of the portal."""

    @property
    def thread(self) -> int:
        """The thread with the arguments in its frame; the thread runs no instruction."""

    @property
    def method(self) -> int:
        """The portal, by index."""

    def return_result(self, make: Callable[[Block], int]) -> None:
        """End the call with the result that `make` creates in the resource's block; `make` may raise
        HeapFull.
        """

    def throw(self, kind: str, message: str) -> None:
        """End the call by a built-in exception."""


class HostLiveness(Protocol):
    """Heartbeats of the hosts of the team's agents."""

    def contact_age(self, member: TeamMember) -> float:
        """Seconds since the last message from the host of an agent; infinite without a link."""

    def is_silent(self, member: TeamMember) -> bool:
        """Whether the host of an agent has a link and is silent."""

    def request_heartbeat(self, member: TeamMember, within: float) -> None:
        """Ask the host of an agent for a heartbeat; no coordinator is sent to this host before the heartbeat
        arrives.

        Without effect if the host sent a message in the last `within` seconds.
        """

    def is_heartbeat_pending(self, member: TeamMember) -> bool:
        """Whether that heartbeat is still awaited."""

    def transit_time(self, member: TeamMember) -> float:
        """The measured transit time of a coordinator to that host, in seconds."""


class VmHooks(Struct):
    """Hooks of one machine. `rules` is called before each portal call. `stubs` are by the ids of resources,
    which must not have started yet: their `init` does not run, and they are open at once. `meter` gets the
    number of instructions of each turn. `liveness` is for linked hosts that may be silent. `on_arrival` is
    called with each coordinator that has arrived from another host. `run_limit` limits a run's duration.
    `fresh_time` is the real time at a departure, for hosts whose machine has a constant clock during a turn.
    """

    rules: CallRules | None = None
    observer: PortalObserver | None = None
    meter: Callable[[int], None] | None = None
    liveness: HostLiveness | None = None
    on_arrival: Callable[[Agent], None] | None = None
    run_limit: RunLimit | None = None
    fresh_time: Callable[[], float] | None = None
    stubs: dict[str, Callable[[StubCall], None]] = field(default_factory=dict)

    def replace_observer(self, observer: PortalObserver | None) -> PortalObserver | None:
        """Attach an observer, or none; returns the previous one."""
        self.observer, before = observer, self.observer
        return before

    def watch_arrivals(self, on_arrival: Callable[[Agent], None]) -> None:
        """Set the function that is called with each coordinator that has arrived from another host."""
        self.on_arrival = on_arrival

    def attach_meter(self, meter: Callable[[int], None]) -> None:
        """Attach the meter of a simulated computer."""
        self.meter = meter
