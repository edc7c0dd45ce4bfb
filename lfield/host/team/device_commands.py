"""Device instructions of one host's agents: the coordinator behind each, and its deadline. Sans-IO.

Telemetry queries are answered here; other instructions are passed to the device, and the answer comes back.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from lfield.bytecode.program import DeviceCallRecord
from lfield.errors import DeviceError
from lfield.host.context import HostContext, Part
from lfield.host.effects import CallDevice, CancelCall, MakeDeviceSafe
from lfield.host.events.portal_events import served_call_of
from lfield.host.team.orphaned_devices import DeadmanMonitor
from lfield.host.team.part_interfaces import LeaseRules
from lfield.manifest import DeviceValue
from lfield.replication.membership.membership import Membership
from lfield.replication.transfer.core import Mobility
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import PENDING, Pending
from lfield.vm.machine import Machine
from lfield.wire.coordinator_messages import CoordinatorState


class DeviceCommands(Part):
    """The device instructions under way, and the orphaned devices."""

    def __init__(
        self,
        context: HostContext,
        machine: Machine,
        leases: LeaseRules,
        membership: Membership,
        mobility: Mobility,
    ) -> None:
        self._machine, self._leases, self._membership, self._mobility = machine, leases, membership, mobility
        self._environment, self._clock, self._own_host = context.environment, context.clock, context.name
        self._effects, self._out, self._recorder = context.effects, context.effects.append, context.recorder
        self._devices = context.mission.devices_of(context.name)
        self._deadman = DeadmanMonitor(self._devices)
        #: The call that each thread waits for, and all calls without an answer, by number.
        self._running: dict[tuple[Agent, int], CallDevice] = {}
        self._unanswered: dict[int, CallDevice] = {}
        self._number = 0

    def on_states(self, host: str, records: Iterable[CoordinatorState]) -> None:
        """A host reports coordinators."""
        self._deadman.on_states(host, records, self._clock.monotonic())

    def on_tick(self, now: float) -> None:
        """Make orphaned devices safe."""
        self._deadman.on_running((call.agent for call in self._machine.person_portals.running), now)
        self._effects += self._deadman.check(
            self._own_host, self._mobility.known_states(), self._membership, now
        )
        self.due = self._deadman.due

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """See `HostInterface.call_device`."""
        value = self._environment.query(agent.id, call)
        if not isinstance(value, Pending):
            return value
        until = self._deadline(agent, thread, call) if call.effect != "query" else math.inf
        self._number += 1
        command = CallDevice(agent, thread, call, values, until, self._number)
        self._running[agent, thread] = self._unanswered[self._number] = command
        if self._recorder.detailed:
            device, portal = f"{agent.id}.{call.field}", served_call_of(agent, thread)
            self._recorder.on_device_call(agent.id, thread, portal, device, call.instruction)
        self._out(command)
        return PENDING

    def _deadline(self, agent: Agent, thread: int, call: DeviceCallRecord) -> float:
        """The deadline for starting the call, for the coordinator that has called the portal. Raises
        DeviceError.
        """
        number, caller = self._machine.served_calls.of_thread(agent, thread)
        if caller is None and number:
            raise DeviceError(call.field, "the call that would command it was taken from its caller")
        if caller is None:
            return math.inf
        device = f"{agent.id}.{call.field}"
        until = self._leases.actuation_deadline(caller, device)
        self._deadman.on_used(device, caller.id, self._clock.monotonic())
        self.due = self._deadman.due
        return until

    def cancel_device_call(self, agent: Agent, thread: int) -> bool:
        """See `HostInterface.cancel`."""
        command = self._running.get((agent, thread))
        if command is None or not self._environment.may_be_cancelled(agent.id, command.call):
            return False
        self._out(CancelCall(agent, thread))
        return True

    def on_device_answer(self, number: int, value: DeviceValue | DeviceError) -> None:
        """The result of the device call of that number; only the first result counts."""
        call = self._unanswered.pop(number, None)
        if call is None:
            return
        if self._running.get((call.agent, call.thread)) is call:
            del self._running[call.agent, call.thread]
        error = str(value) if isinstance(value, DeviceError) else ""
        self._recorder.on_device_answer(call.agent.id, call.thread, error)
        if isinstance(value, DeviceError):
            self._machine.throw_builtin(call.agent, call.thread, value.kind, str(value), value.device)
        else:
            self._machine.answer(call.agent, call.thread, value, call.call.result, call.call.field)

    def make_safe(self, agent: str, reason: str) -> None:
        """Bring the devices of an agent into their safe states."""
        self._effects += [
            MakeDeviceSafe(device.name, device.safe_state, reason)
            for device in self._devices
            if device.agent == agent and device.safe_state
        ]

    def wait_reason(self, agent: Agent, thread: int) -> str:
        """The instruction that a thread of an agent waits for, AGENT.FIELD.INSTRUCTION; '' for none."""
        command = self._running.get((agent, thread))
        return f"{agent.id}.{command.call.field}.{command.call.instruction}" if command is not None else ""

    def telemetry_reading(self, agent: Agent, call: DeviceCallRecord) -> Reading | None:
        """See `HostInterface.telemetry_reading`."""
        return self._environment.reading(agent.id, call)
