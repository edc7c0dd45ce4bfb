"""Records the portal calls of a machine as events, while its host has subscribers. Sans-IO."""

from __future__ import annotations

from lfield.host.events.event_recorder import EventRecorder
from lfield.vm.agent import Agent
from lfield.vm.hooks import PortalObserver
from lfield.vm.inspection import traceback
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import THREAD_CALL
from lfield.vm.memory.threads import place_of


class PortalEvents:
    """Records the start and end of portal calls, and forwards them to the observer that was there before."""

    def __init__(self, recorder: EventRecorder, machine: Machine) -> None:
        self._recorder, self._machine = recorder, machine
        self._previous_observer: PortalObserver | None = None

    def attach(self) -> None:
        """Start recording, device calls included. A new subscriber first receives the counts of dropped
        events."""
        self._recorder.report_dropped(at_once=True)
        if not self._recorder.detailed:
            self._recorder.set_detailed(on=True)
            self._previous_observer = self._machine.hooks.replace_observer(self)

    def detach(self) -> None:
        """Stop recording."""
        if self._recorder.detailed:
            self._recorder.set_detailed(on=False)
            self._recorder.discard_calls()
            self._machine.hooks.replace_observer(self._previous_observer)
            self._previous_observer = None

    def on_call_started(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        if self._previous_observer is not None:
            self._previous_observer.on_call_started(resource, thread, number, method, caller)
        portal = self._machine.program.core.methods[method].name
        self._recorder.on_call_started(number, caller, resource.id, portal)

    def on_call_returned(self, resource: Agent, number: int, result: int) -> None:
        if self._previous_observer is not None:
            self._previous_observer.on_call_returned(resource, number, result)
        self._recorder.on_call_ended(number, "done")

    def on_call_threw(self, resource: Agent, number: int, thrown: int) -> None:
        """A portal call has ended with an exception."""
        if self._previous_observer is not None:
            self._previous_observer.on_call_threw(resource, number, thrown)
        if self._recorder.is_recorded(number):
            name, message, _ = traceback.describe(resource.block, self._machine.program, thrown)
            self._recorder.on_call_ended(number, "thrown", f"{name}: {message}" if message else name)

    def on_resource_died(self, resource: Agent, reason: str) -> None:
        """A resource has died, and its portal calls with it."""
        if self._previous_observer is not None:
            self._previous_observer.on_resource_died(resource, reason)
        self._recorder.on_resource_died(resource.id, reason)


def served_call_of(agent: Agent, thread: int) -> int:
    """The number of the portal call that a thread executes, 0 for none."""
    place = place_of(agent.block, thread)
    return agent.block.w[place + THREAD_CALL] if place else 0
