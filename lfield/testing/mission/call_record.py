"""Records portal calls: caller, time, arguments and result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import FRAME_SLOTS, THREAD_FRAME
from lfield.vm.memory.threads import place_of
from lfield.vm.person_calls.value_conversion import thrown_of, values_of


@dataclass(slots=True)
class RecordedCall:
    """A portal call that has started, by a `pcall` or in a `together`; completed when it ends.

    `at` and `ended` are seconds of true time, `caller` and `resource` ids. `ended` is None while the portal
    runs, and remains so if its host fails. `thrown` is '' or "Kind: message". A portal whose caller no longer
    waits continues, and its result is recorded. A call that never starts (unreachable resource, expired time
    limit) is not recorded.
    """

    at: float
    ended: float | None
    caller: str
    resource: str
    portal: str
    arguments: tuple[object, ...]
    result: object = None
    thrown: str = ""


class CallRecorder:
    """Every portal call of all observed machines, in the order of their start.

    `now` returns true time in seconds.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.record: list[RecordedCall] = []

    def observe(self, machine: Machine) -> None:
        """Records the portal calls of a machine (one incarnation of a host) from now on."""
        machine.hooks.replace_observer(_CallObserver(machine, self._now, self.record))


def arguments_of(machine: Machine, resource: Agent, thread: int, method: int) -> list[object]:
    """The arguments of a portal that has started but not run yet, as new Python values."""
    w, portal = resource.block.w, machine.program.core.methods[method]
    first = w[place_of(resource.block, thread) + THREAD_FRAME] + FRAME_SLOTS + 1
    kinds = portal.slots[1 : 1 + portal.parameters]
    words = w[first : first + portal.parameters].tolist()
    return values_of(resource.block, machine.program, kinds, words)


@dataclass(slots=True)
class _CallObserver:
    """Callbacks of one machine (`hooks.PortalObserver`); `_open` has the running calls and their result
    types."""

    _machine: Machine
    _now: Callable[[], float]
    _record: list[RecordedCall]
    _open: dict[int, tuple[RecordedCall, int]] = field(default_factory=dict)

    def on_call_started(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """Records that a portal has started."""
        portal = self._machine.program.core.methods[method]
        arguments = tuple(arguments_of(self._machine, resource, thread, method))
        call = RecordedCall(self._now(), None, caller, resource.id, portal.name, arguments)
        self._open[number] = call, portal.result
        self._record.append(call)

    def on_call_returned(self, resource: Agent, number: int, value: int) -> None:
        """Records that a portal has returned."""
        call, kind = self._open.pop(number)
        machine = self._machine
        (call.result,) = values_of(resource.block, machine.program, [kind], [value])
        call.ended = self._now()

    def on_call_threw(self, resource: Agent, number: int, thrown: int) -> None:
        """Records that a portal has thrown an exception."""
        call, _ = self._open.pop(number)
        call.thrown = thrown_of(resource.block, self._machine.program, thrown)
        call.ended = self._now()

    def on_resource_died(self, resource: Agent, reason: str) -> None:
        """Records that a resource has died with its portals."""
        ends = [number for number, (call, _) in self._open.items() if call.resource == resource.id]
        for number in ends:
            call, _ = self._open.pop(number)
            call.thrown = f"UnreachableResourceException: {resource.id} has died: {reason}"
            call.ended = self._now()
