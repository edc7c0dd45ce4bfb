"""Carries out orders to stop, to pause and to end either, whichever way they come: devices first."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from lfield.devices.guards import Guards
from lfield.host.core import HostCore
from lfield.host.orders.executed import hold_of
from lfield.loop import spawn
from lfield.text.visible import in_one_line
from lfield.wire.fields import clip
from lfield.wire.observing import EmergencyStop, EmergencyStopped, OrderChallenge, Pause

#: Why devices are held while the mission is paused.
PAUSED = "the mission is paused"
#: Why an order to end a stop or a pause is refused, by what it would end.
HOLDS_OF = {"stop": "emergency stop", "pause": "pause"}
NEWER = "a newer {} arrived before this order to end the {}: check the state, then repeat the order"
#: What a desk is told whose order was executed, and ended by a later order.
ENDED = "this {} was carried out, and a later order has ended it"
IN_USE = "in use again"
#: For so many seconds an emergency stop, which holds already, waits for the disk before it is answered.
KEPT_WITHIN = 2.0
#: Who has stopped or paused what is still so when a host starts.
EARLIER = "an earlier life of this host"

Answered = EmergencyStopped | OrderChallenge
#: Takes the answer to an order.
Answering = Callable[[Answered], None]


class Stops:
    """Stops and pauses of one host.

    `enter` hands an event to the core; `all_kept` returns when all is on the disk, or after so many seconds
    with whether it is.
    """

    def __init__(
        self,
        core: HostCore,
        guards: Guards,
        enter: Callable[[Callable[[], None]], None],
        note: Callable[[str], None],
        all_kept: Callable[[float | None], Awaitable[bool]],
    ) -> None:
        self._core, self._guards = core, guards
        self._enter, self._note, self._all_kept = enter, note, all_kept
        self._teller = core.teller
        guards.on_lock_out = self._locked_out

    # --- what still holds at the start ----------------------------------------------------------------

    def stay_stopped(self) -> None:
        """What was stopped in an earlier life of this host, and not lifted, opens its devices barred."""
        if reason := self._core.coordinators.stopped:
            self._teller.stopped(EARLIER, reason, lifted=False)
            self._guards.bar(reason)
            self._note(f"EMERGENCY STOP still holds: {reason}; 'lfield estop --lift' ends it")

    async def stay_paused(self) -> None:
        """What was paused in an earlier life of this host keeps its devices in their safe states."""
        if self._core.coordinators.paused:
            self._teller.paused(EARLIER, PAUSED, lifted=False)
            await self._guards.rest(PAUSED)

    def _locked_out(self, device: str, reason: str) -> None:
        """It is kept as an emergency stop is, so that the next life of this host opens its devices barred."""
        self._core.orders.locked_out()
        if not self._core.coordinators.stopped:
            self._enter(lambda: self._core.stop(clip(in_one_line(f"{device} is locked out: {reason}"))))

    # --- orders ---------------------------------------------------------------------------------------

    def order(self, message: EmergencyStop | Pause, who: str, answer: Answering) -> None:
        """An order of somebody who may give it. It is executed, or `answer` says at once why it is not."""
        orders, kind = self._core.orders, message.kind
        match orders.standing(kind, message.id, message.epoch):
            case "new":
                orders.execute(kind, message.id)
                spawn(self._execute(message, who, answer))
            case "holds":
                spawn(self._confirm(message, answer))
            case "ended":
                self._answer(message, answer, self._in_use(), ENDED.format(HOLDS_OF[hold_of(kind)]))
            case "done":
                stopped = self._core.coordinators.stopped
                self._answer(
                    message, answer, self._all_devices(stopped), self._newer(message) if stopped else ""
                )
            case "old" if message.lift:
                why = self._newer(message)
                self._note(f"an order of {who} is not carried out: {why}")
                self._answer(message, answer, self._all_devices(why), why)
            case _:
                answer(OrderChallenge(message.id, orders.epochs))

    async def _execute(self, message: EmergencyStop | Pause, who: str, answer: Answering) -> None:
        if isinstance(message, EmergencyStop):
            await self._emergency_stop(message, who, answer)
        else:
            await self._pause(message, who, answer)

    async def _emergency_stop(self, message: EmergencyStop, who: str, answer: Answering) -> None:
        # Programs hear it too, and what they print of it has no line of somebody else's.
        reason = clip(in_one_line(message.reason))
        self._teller.stopped(who, reason, lifted=message.lift)
        if message.lift:
            self._note(f"the emergency stop is lifted by {who}; programs may release their devices")
            devices = self._guards.lift_stop()
            self._enter(lambda: self._core.stop("", message.id))
        else:
            self._note(f"EMERGENCY STOP by {who}: {reason}")
            # The devices first: they wait neither for the core nor for the disk.
            self._guards.bar(reason)
            self._enter(lambda: self._core.stop(reason, message.id))
            devices = await self._guards.confirmed()
        trouble = "" if await self._all_kept(KEPT_WITHIN) else self._not_kept(lift=message.lift)
        self._answer(message, answer, devices, trouble)

    async def _pause(self, message: Pause, who: str, answer: Answering) -> None:
        self._teller.paused(who, PAUSED, lifted=message.lift)
        if message.lift:
            # Whoever goes on must find them in use.
            devices = await self._guards.let_go(PAUSED) if self._core.coordinators.paused else {}
            self._enter(lambda: self._core.pause(on=False, order=message.id))
        else:
            self._enter(lambda: self._core.pause(on=True, order=message.id))
            devices = await self._guards.rest(PAUSED)
        if await self._all_kept(None):
            self._answer(message, answer, devices)

    async def _confirm(self, message: EmergencyStop | Pause, answer: Answering) -> None:
        """An order that was executed and holds is confirmed again, with the devices as they are now."""
        devices = await self._guards.confirmed()
        trouble = "" if await self._all_kept(KEPT_WITHIN) else self._not_kept(lift=False)
        self._answer(message, answer, devices, trouble)

    def _not_kept(self, *, lift: bool) -> str:
        """What the next life of this host may take for true, since its disk takes nothing now; noted too."""
        what, then = ("its end", "still hold its devices") if lift else ("the stop", "know nothing of it")
        why = self._core.coordinators.trouble or f"it takes over {KEPT_WITHIN:g} s"
        told = clip(f"{what} is not on the disk ({why}): started again, this host may {then}")
        self._note(told)
        return told

    def _newer(self, message: EmergencyStop | Pause) -> str:
        hold = HOLDS_OF[hold_of(message.kind)]
        return NEWER.format(hold, hold)

    def _all_devices(self, why: str) -> dict[str, str]:
        devices = self._core.mission.devices_of(self._core.name)
        return {device.name: why for device in devices if not device.is_sensor}

    def _in_use(self) -> dict[str, str]:
        """'' for each device that is in its safe state all the same."""
        latched, moving = self._guards.latched, self._guards.moving
        return {
            name: "" if name in latched and not moving.get(name) else IN_USE for name in self._all_devices("")
        }

    def _answer(
        self, message: EmergencyStop | Pause, answer: Answering, devices: dict[str, str], trouble: str = ""
    ) -> None:
        answer(EmergencyStopped(devices, trouble, message.id, self._core.orders.epochs))
