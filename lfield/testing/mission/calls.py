"""The record of portal calls: who has called what, when, with which arguments, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from lfield.testing.mission.values import thrown_of, values_of
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import FRAME_SLOTS, THREAD_FRAME
from lfield.vm.memory.threads import place_of


@dataclass(slots=True)
class PortalCall:
    """One call of a portal that has begun, by a `pcall` or in a `together`; filled in when it ends.

    `at` and `ended` are seconds of true time, `caller` and `resource` ids. `ended` is None while the portal
    runs, and stays so when its host goes down before. `thrown` is '' or "Kind: message". A portal goes on
    when its caller waits no more, and what it gives or throws then is told all the same.

    A call that never begins, since its resource cannot be reached or its time is over, is none.
    """

    at: float
    ended: float | None
    caller: str
    resource: str
    portal: str
    arguments: tuple[object, ...]
    result: object = None
    thrown: str = ""


class Calls:
    """Every portal call of all machines that are watched, in the order of their beginning.

    `now` tells true time, in seconds.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.record: list[PortalCall] = []

    def watch(self, machine: Machine) -> None:
        """Note the portal calls of a machine, which is the one of one life of a host, from now on."""
        machine.attached.watch = _Noting(machine, self._now, self.record)


def arguments_of(machine: Machine, resource: Agent, thread: int, method: int) -> list[object]:
    """The arguments of a portal that has begun and not run yet, as Python values of their own."""
    w, portal = resource.block.w, machine.program.core.methods[method]
    first = w[place_of(resource.block, thread) + THREAD_FRAME] + FRAME_SLOTS + 1
    kinds = portal.slots[1 : 1 + portal.parameters]
    words = w[first : first + portal.parameters].tolist()
    return values_of(resource.block, machine.program, kinds, words)


@dataclass(slots=True)
class _Noting:
    """What one machine tells (`attached.Watch`); `_open` has the calls under way and their result's types."""

    _machine: Machine
    _now: Callable[[], float]
    _record: list[PortalCall]
    _open: dict[int, tuple[PortalCall, int]] = field(default_factory=dict)

    def began(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """A portal has begun."""
        portal = self._machine.program.core.methods[method]
        arguments = tuple(arguments_of(self._machine, resource, thread, method))
        call = PortalCall(self._now(), None, caller, resource.id, portal.name, arguments)
        self._open[number] = call, portal.result
        self._record.append(call)

    def gave(self, resource: Agent, number: int, word: int) -> None:
        """A portal has come to its end."""
        call, kind = self._open.pop(number)
        machine = self._machine
        (call.result,) = values_of(resource.block, machine.program, [kind], [word])
        call.ended = self._now()

    def threw(self, resource: Agent, number: int, thrown: int) -> None:
        """A portal has ended by an exception."""
        call, _ = self._open.pop(number)
        call.thrown = thrown_of(resource.block, self._machine.program, thrown)
        call.ended = self._now()

    def died(self, resource: Agent, reason: str) -> None:
        """A resource has died, and its portals with it."""
        ends = [number for number, (call, _) in self._open.items() if call.resource == resource.id]
        for number in ends:
            call, _ = self._open.pop(number)
            call.thrown = f"UnreachableResourceException: {resource.id} has died: {reason}"
            call.ended = self._now()
