"""The device instructions of the agents of one host: for whom they are, and until when they may begin. Pure.

Telemetry is known here; whatever a device itself must do is handed on, and its answer comes back.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield.bytecode.program import DeviceCall
from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.host.effects import Call, CancelCall, Effect, Nearby
from lfield.host.sight.portals import served_call
from lfield.host.sight.teller import Teller
from lfield.host.team.leases import Leases
from lfield.host.team.policy import Policies
from lfield.manifest import DeviceValue
from lfield.vm.agent import Agent
from lfield.vm.contract import Reading
from lfield.vm.machine import Machine
from lfield.vm.world import PENDING, Pending


class Commands:
    """The device instructions under way. What is to be done outside is added to `effects`."""

    def __init__(
        self,
        machine: Machine,
        nearby: Nearby,
        leases: Leases,
        policies: Policies,
        clock: Clock,
        effects: Callable[[Effect], None],
        teller: Teller,
    ) -> None:
        self._machine, self._nearby, self._leases, self._policies = machine, nearby, leases, policies
        self._clock, self._out, self._teller = clock, effects, teller
        #: What each thread waits for.
        self._under_way: dict[tuple[Agent, int], DeviceCall] = {}

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """See `World.device`."""
        value = self._nearby.query(agent.id, call)
        if not isinstance(value, Pending):
            return value
        until = self._until(agent, thread, call) if call.effect != "query" else math.inf
        self._under_way[agent, thread] = call
        if self._teller.detailed:
            device, portal = f"{agent.id}.{call.field}", served_call(agent, thread)
            self._teller.asked(agent.id, thread, portal, device, call.instruction)
        self._out(Call(agent, thread, call, values, until))
        return PENDING

    def _until(self, agent: Agent, thread: int, call: DeviceCall) -> float:
        """Until when it may begin, for whoever has called the portal. Raises DeviceError."""
        if self._machine.is_left(agent, thread):
            raise DeviceError(call.field, "the call that would command it was taken from its caller")
        caller = self._machine.caller(agent, thread)
        if caller is None:
            return math.inf
        device = f"{agent.id}.{call.field}"
        until = self._leases.until(caller, device)
        self._policies.used(device, caller.id, self._clock.monotonic())
        return until

    def cancel(self, agent: Agent, thread: int) -> bool:
        """See `World.cancel`."""
        call = self._under_way.get((agent, thread))
        if call is None or not self._nearby.may_be_cancelled(agent.id, call):
            return False
        self._out(CancelCall(agent, thread))
        return True

    def answered(self, asked: Call, value: DeviceValue | DeviceError) -> None:
        """What became of a call of a device."""
        self._under_way.pop((asked.agent, asked.thread), None)
        error = str(value) if isinstance(value, DeviceError) else ""
        self._teller.answered(asked.agent.id, asked.thread, error)
        if isinstance(value, DeviceError):
            self._machine.refuse(asked.agent, asked.thread, value.kind, str(value), value.device)
        else:
            self._machine.answer(asked.agent, asked.thread, value, asked.call.result, asked.call.field)

    def waits(self, agent: Agent, thread: int) -> str:
        """The instruction that a thread of an agent waits for, AGENT.FIELD.INSTRUCTION; '' for none."""
        call = self._under_way.get((agent, thread))
        return f"{agent.id}.{call.field}.{call.instruction}" if call is not None else ""

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """See `World.reading`."""
        return self._nearby.reading(agent.id, call)
