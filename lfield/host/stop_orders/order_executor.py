"""Executes stop, pause and lift orders of all transports: devices first."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

from lfield.devices.device_guards import DeviceGuards
from lfield.event_loop import spawn
from lfield.host.core import HostCore
from lfield.host.inputs import BallotHeld, HostInput, OrderExecuted, PauseOrdered, StopOrdered
from lfield.host.order_history.executed_orders import effect_of
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import truncate
from lfield.wire.observer_messages import (
    BallotHold,
    EmergencyStop,
    EmergencyStopResult,
    OrderChallenge,
    Pause,
)

#: The reason why devices are held while the mission is paused.
PAUSED = "the mission is paused"
#: The reason why an order to end a stop or a pause is refused, by the stop or pause that it would end.
HOLD_NAMES = {"stop": "emergency stop", "pause": "pause"}
NEWER_ORDER = "a newer {} arrived before this order to end the {}: check the state, then repeat the order"
#: The answer to an order that was executed and then ended by a later order.
ALREADY_ENDED = "this {} was carried out, and a later order has ended it"
IN_USE = "in use again"
#: The safe state of a device that is not open when the host is stopped.
NOT_OPEN = "its host has not opened it yet, and opens it in its safe state: repeat the order"
#: The answer to a resume on a host that has voted about an activation.
STILL_HELD = (
    "the pause has ended, but the host is held until the result of a vote about an activation is known: "
    "'lfield status' shows it"
)
#: The hold of a host that has voted.
VOTE = "the vote about an activation"
#: Seconds for which the answer to an emergency stop, which is in force already, waits for the disk.
DURABLE_TIMEOUT = 2.0
#: The sender of a stop or pause that is still in force when a host starts.
EARLIER_INCARNATION = "before the restart of this host"

OrderResponse = EmergencyStopResult | OrderChallenge
#: Receives the answer to an order.
OrderCallback = Callable[[OrderResponse], None]


class Dispatch(Protocol):
    """Passes an input to the core, see `Host.dispatch`."""

    def __call__(self, entry: HostInput, on_result: Callable[[object], None] | None = None) -> None: ...


class OrderExecutor:
    """Executes stop, pause and lift orders on one host.

    `dispatch` passes an event to the core; `flush` waits until all records are on disk, at most the given
    seconds, and returns whether they are.
    """

    def __init__(
        self,
        core: HostCore,
        guards: DeviceGuards,
        dispatch: Dispatch,
        note: Callable[[LogLine], None],
        flush: Callable[[float | None], Awaitable[bool]],
    ) -> None:
        self._core, self._guards = core, guards
        self._dispatch, self._note, self._flush = dispatch, note, flush
        self._recorder = core.recorder

    # --- orders still in force at the start -----------------------------------------------------------

    def restore_emergency_stop(self) -> None:
        """A stop that was not lifted before the restart: the devices are locked when they are opened."""
        if reason := self._core.coordinators.stopped:
            self._recorder.on_emergency_stop(EARLIER_INCARNATION, reason, lifted=False)
            self._guards.inhibit(reason)
            self._note(log_messages.EMERGENCY_STOP_ACTIVE.line(reason=reason))

    async def restore_pause(self) -> None:
        """A pause from before the restart keeps the devices in their safe states."""
        if self._core.coordinators.paused:
            self._recorder.on_pause(EARLIER_INCARNATION, PAUSED, lifted=False)
            await self._guards.enter_safe_state(PAUSED)

    def on_lock_out(self, device: str, reason: str) -> None:
        """A lock-out is stored like an emergency stop, so that the next start opens the devices locked."""
        self._dispatch(OrderExecuted(""))
        if not self._core.coordinators.stopped:
            self._dispatch(StopOrdered(truncate(escape_line(f"{device} is locked out: {reason}"))))

    # --- orders ---------------------------------------------------------------------------------------

    def on_order(self, message: EmergencyStop | Pause, sender: str, answer: OrderCallback) -> None:
        """Execute an authorised order, or call `answer` at once with the reason for the refusal."""
        orders, kind = self._core.orders, message.kind
        match orders.standing_of(kind, message.id, message.epoch):
            case "new":
                self._dispatch(OrderExecuted(kind, message.id))
                spawn(self._execute(message, sender, answer))
            case "holds":
                spawn(self._confirm(message, answer))
            case "ended":
                self._answer(
                    message, answer, self._devices_in_use(), ALREADY_ENDED.format(HOLD_NAMES[effect_of(kind)])
                )
            case "done":
                stopped = self._core.coordinators.stopped
                self._answer(
                    message,
                    answer,
                    self._all_devices(stopped),
                    self._newer_order_text(message) if stopped else "",
                )
            case "old" if message.lift:
                reason = self._newer_order_text(message)
                self._note(log_messages.ORDER_DENIED.line(operator=sender, reason=reason))
                self._answer(message, answer, self._all_devices(reason), reason)
            case _:
                answer(OrderChallenge(message.id, orders.epochs))

    async def _execute(self, message: EmergencyStop | Pause, operator: str, answer: OrderCallback) -> None:
        if isinstance(message, EmergencyStop):
            await self._emergency_stop(message, operator, answer)
        else:
            await self._pause(message, operator, answer)

    async def _emergency_stop(self, message: EmergencyStop, operator: str, answer: OrderCallback) -> None:
        # Programs receive the reason as well, so it must not contain line breaks or control characters.
        reason = truncate(escape_line(message.reason))
        self._recorder.on_emergency_stop(operator, reason, lifted=message.lift)
        if message.lift:
            self._note(log_messages.EMERGENCY_STOP_LIFTED.line(operator=operator))
            devices = self._guards.clear_emergency_stop()
            self._dispatch(StopOrdered("", message.id))
        else:
            self._note(log_messages.EMERGENCY_STOP.line(operator=operator, reason=reason))
            # The devices first: they wait neither for the core nor for the disk.
            self._guards.inhibit(reason)
            self._dispatch(StopOrdered(reason, message.id))
            devices = await self._safe_states()
        problem = "" if await self._flush(DURABLE_TIMEOUT) else self._durability_warning(lift=message.lift)
        self._answer(message, answer, devices, problem)

    async def _pause(self, message: Pause, operator: str, answer: OrderCallback) -> None:
        self._recorder.on_pause(operator, PAUSED, lifted=message.lift)
        team = self._core.coordinators
        if message.lift:
            is_held = team.is_pause_ordered and bool(team.ballot)
            devices = await self._end_pause(PauseOrdered(False, message.id), is_last=not team.ballot)
        else:
            is_held = False
            self._dispatch(PauseOrdered(True, message.id))
            devices = await self._guards.enter_safe_state(PAUSED)
        if await self._flush(None):
            self._answer(message, answer, devices, STILL_HELD if is_held else "")

    async def _end_pause(self, end: HostInput, *, is_last: bool) -> dict[str, str]:
        """Release the devices unless there is another reason for a pause of the mission, then resume the
        agents.
        """
        team = self._core.coordinators
        # A resumed agent must find its devices in use.
        devices = await self._guards.release_held(PAUSED) if is_last and team.paused else {}
        self._dispatch(end)
        if is_last and team.paused:
            # Another pause came while the devices were released.
            devices = await self._guards.enter_safe_state(PAUSED)
        return devices

    # --- votes ----------------------------------------------------------------------------------------

    def on_ballot_hold(self, message: BallotHold, answer: OrderCallback) -> None:
        """The service of this robot votes: no vehicle arms until the result is known. A person cannot end
        this hold.
        """
        spawn(self._hold(message, answer))

    async def _hold(self, message: BallotHold, answer: OrderCallback) -> None:
        team, devices = self._core.coordinators, dict[str, str]()
        if not message.lift:
            self._recorder.on_pause(VOTE, PAUSED, lifted=False, is_vote=True)
            self._dispatch(BallotHeld(message.id))
            devices = await self._guards.enter_safe_state(PAUSED)
        elif team.ballot == message.id:
            self._recorder.on_pause(VOTE, PAUSED, lifted=True, is_vote=True)
            devices = await self._end_pause(BallotHeld(b""), is_last=not team.is_pause_ordered)
        answer(EmergencyStopResult(devices, "", message.id, self._core.orders.epochs))

    async def _confirm(self, message: EmergencyStop | Pause, answer: OrderCallback) -> None:
        """Confirm an executed order that is in force again, with the present states of the devices."""
        devices = await self._safe_states()
        problem = "" if await self._flush(DURABLE_TIMEOUT) else self._durability_warning(lift=False)
        self._answer(message, answer, devices, problem)

    async def _safe_states(self) -> dict[str, str]:
        """The confirmed safe states. A starting host accepts orders before it opens its devices."""
        return self._all_devices(NOT_OPEN) | await self._guards.await_safe_states()

    def _durability_warning(self, *, lift: bool) -> str:
        """Log that the order is not on disk, and the consequence after a restart; returns the line."""
        reason = self._core.coordinators.write_problem or f"writing takes more than {DURABLE_TIMEOUT:g} s"
        line = (log_messages.STOP_END_NOT_STORED if lift else log_messages.STOP_NOT_STORED).line(
            reason=reason
        )
        self._note(line)
        return truncate(str(line))

    def _newer_order_text(self, message: EmergencyStop | Pause) -> str:
        hold = HOLD_NAMES[effect_of(message.kind)]
        return NEWER_ORDER.format(hold, hold)

    def _all_devices(self, reason: str) -> dict[str, str]:
        devices = self._core.mission.devices_of(self._core.name)
        return {device.name: reason for device in devices if not device.is_sensor}

    def _devices_in_use(self) -> dict[str, str]:
        """For each device '' if it is at rest in its safe state, otherwise IN_USE."""
        latched, moving = self._guards.latched, self._guards.moving
        return {
            name: "" if name in latched and not moving.get(name) else IN_USE for name in self._all_devices("")
        }

    def _answer(
        self,
        message: EmergencyStop | Pause,
        answer: OrderCallback,
        devices: dict[str, str],
        problem: str = "",
    ) -> None:
        answer(EmergencyStopResult(devices, problem, message.id, self._core.orders.epochs))
