"""What a host answers to its observers, and does at a person's word: `lfield ps`, `estop`, `forget`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.errors import AddressError
from lfield.host.core import HostCore
from lfield.host.watching.watchers import Watchers
from lfield.loop import spawn
from lfield.net.peers import Peers
from lfield.net.transport import Link
from lfield.text.visible import in_one_line
from lfield.wire.fields import clip
from lfield.wire.messages import Control
from lfield.wire.observing import (
    EmergencyStop,
    EmergencyStopped,
    Forget,
    Forgotten,
    Pause,
    Recover,
    StartRequest,
    StartResponse,
    Status,
    StatusRequest,
)
from lfield.wire.watching import Seen, Watch

#: Why devices are held while the mission is paused.
PAUSED = "the mission is paused"
#: What holds until somebody ends it, and why that order is refused.
STOP, PAUSE = "emergency stop", "pause"
NEWER = "a newer {} arrived before this order to end the {}: check the state, then repeat the order"
#: For so many seconds an emergency stop, which holds already, waits for the disk before it is answered.
KEPT_WITHIN = 2.0
#: For so many seconds the answer to a start waits for what other hosts say of their vehicles.
STARTED_WITHIN = 3.0
#: The status of a host is told at most every so many seconds: whoever asks more often gets one for all.
STATUS_EVERY = 0.05
#: Whoever has asked within so many seconds is looking at the devices, and gets one more answer in so many.
LOOKING, LAST_LOOK = 3.0, 1.5
#: Who has stopped or paused what is still so when a host starts.
EARLIER = "an earlier life of this host"


class Visitors:
    """The observers of one host.

    `enter` hands an event to the core, which `status` describes; `all_kept` returns when all is on the disk,
    or after so many seconds with whether it is.
    """

    def __init__(
        self,
        core: HostCore,
        guards: Guards,
        peers: Peers,
        clock: Clock,
        enter: Callable[[Callable[[], None]], None],
        status: Callable[[], Status],
        note: Callable[[str], None],
        all_kept: Callable[[float | None], Awaitable[bool]],
    ) -> None:
        self._core, self._guards, self._clock = core, guards, clock
        self._enter, self._status, self._note, self._all_kept = enter, status, note, all_kept
        self._teller = core.teller
        self.watchers = Watchers(core, guards, clock, status, peers.watch.latest)
        guards.on_lock_out = self._locked_out
        self._peers = peers
        #: Those that another observer had when the latest stop or pause came: an order to end it that comes
        #: by one of these may have been given before.
        self._older: dict[str, Collection[Link]] = {}
        #: When somebody last asked how the devices are.
        self._looked = -LOOKING
        #: Who waits for the status, and when it was last told.
        self._asking: dict[Link, None] = {}
        self._told = -STATUS_EVERY

    def received(self, message: Control, link: Link) -> None:
        """An observer asks for something. What only hosts say to one another is not answered."""
        match message:
            case StatusRequest():
                self._show(link)
            case Watch():
                self.watchers.watch(message, link)
            case Seen():
                self.watchers.seen(message, link)
            case EmergencyStop():
                spawn(self._emergency_stop(message, link))
            case Forget():
                spawn(self._keep(link, lambda: Forgotten(self._core.forget(message.agent))))
            case Pause():
                spawn(self._pause(message, link))
            case Recover():
                spawn(self._keep(link, lambda: self._core.recover(message)))
            case StartRequest():
                spawn(self._start(message, link))

    def _show(self, link: Link) -> None:
        """Tell the status now, or soon; nobody can keep a host busy by asking."""
        self._looked = self._clock.monotonic()
        waits, self._asking[link] = bool(self._asking), None
        left = self._told + STATUS_EVERY - self._looked
        if left <= 0:
            self._show_all()
        elif not waits:
            asyncio.get_running_loop().call_later(left, self._show_all)

    def _show_all(self) -> None:
        self._told = self._clock.monotonic()
        asking, self._asking = self._asking, {}
        if asking:
            status = self._status()
            for link in asking:
                self._answer(link, status)

    def stay_stopped(self) -> None:
        """What was stopped in an earlier life of this host, and not lifted, opens its devices barred."""
        if reason := self._core.coordinators.stopped:
            self._teller.stopped(EARLIER, reason, lifted=False)
            self._guards.bar(reason)
            self._note(f"EMERGENCY STOP still holds: {reason}; 'lfield estop --lift' ends it")

    def _locked_out(self, device: str, reason: str) -> None:
        """It is kept as an emergency stop is, so that the next life of this host opens its devices barred."""
        self._older[STOP] = self._peers.visiting
        if not self._core.coordinators.stopped:
            self._enter(lambda: self._core.stop(clip(in_one_line(f"{device} is locked out: {reason}"))))

    async def stay_paused(self) -> None:
        """What was paused in an earlier life of this host keeps its devices in their safe states."""
        if self._core.coordinators.paused:
            self._teller.paused(EARLIER, PAUSED, lifted=False)
            await self._guards.rest(PAUSED)

    async def be_seen(self) -> None:
        """After an emergency stop somebody may be looking at the devices: let them see how that has ended."""
        if self._core.coordinators.stopped and self._clock.monotonic() - self._looked < LOOKING:
            await asyncio.sleep(LAST_LOOK)

    async def _emergency_stop(self, message: EmergencyStop, link: Link) -> None:
        if self._is_late(STOP, message.lift, link):
            return
        # Programs hear it too, and what they print of it has no line of somebody else's.
        reason = clip(in_one_line(message.reason))
        self._teller.stopped(str(link.who), reason, lifted=message.lift)
        if message.lift:
            self._note(f"the emergency stop is lifted by {link.who}; programs may release their devices")
            devices = self._guards.lift_stop()
            self._enter(lambda: self._core.stop(""))
        else:
            self._note(f"EMERGENCY STOP by {link.who}: {reason}")
            # The devices first: they wait neither for the core nor for the disk.
            self._guards.bar(reason)
            self._enter(lambda: self._core.stop(reason))
            devices = await self._guards.confirmed()
        trouble = "" if await self._all_kept(KEPT_WITHIN) else self._not_kept(lift=message.lift)
        self._answer(link, EmergencyStopped(devices, trouble))

    def _is_late(self, hold: str, lift: bool, link: Link) -> bool:
        """Whether an order to end a stop or a pause is refused: that one may be newer than the order."""
        if not lift:
            self._older[hold] = {other for other in self._peers.visiting if other is not link}
            return False
        if link not in self._older.get(hold, ()):
            return False
        why = NEWER.format(hold, hold)
        self._note(f"an order of {link.who} is not carried out: {why}")
        devices = self._core.mission.devices_of(self._core.name)
        held = {device.name: why for device in devices if not device.is_sensor}
        self._answer(link, EmergencyStopped(held, why))
        return True

    def _not_kept(self, *, lift: bool) -> str:
        """What the next life of this host may take for true, since its disk takes nothing now; noted too."""
        what, then = ("its end", "still hold its devices") if lift else ("the stop", "know nothing of it")
        why = self._core.coordinators.trouble or f"it takes over {KEPT_WITHIN:g} s"
        told = clip(f"{what} is not on the disk ({why}): started again, this host may {then}")
        self._note(told)
        return told

    async def _pause(self, message: Pause, link: Link) -> None:
        if self._is_late(PAUSE, message.lift, link):
            return
        self._teller.paused(str(link.who), PAUSED, lifted=message.lift)
        if message.lift:
            # Whoever goes on must find them in use.
            devices = await self._guards.let_go(PAUSED) if self._core.coordinators.paused else {}
            self._enter(lambda: self._core.pause(on=False))
        else:
            self._enter(lambda: self._core.pause(on=True))
            devices = await self._guards.rest(PAUSED)
        if await self._all_kept(None):
            self._answer(link, EmergencyStopped(devices))

    async def _start(self, message: StartRequest, link: Link) -> None:
        """Start what waits, and answer when it is started, or when it is known what it still waits for."""
        startup = self._core.startup
        answers: list[StartResponse] = []
        self._note(f"'lfield start' by {link.who}")
        self._enter(lambda: answers.append(startup.start(message.without)))
        until = self._clock.monotonic() + STARTED_WITHIN
        while startup.is_settling and self._clock.monotonic() < until:
            await asyncio.sleep(STATUS_EVERY)
        if await self._all_kept(None) and answers:
            waiting = startup.status
            started = [] if waiting is not None or answers[0].trouble else answers[0].started
            self._answer(link, StartResponse(started, waiting, answers[0].trouble))

    async def _keep(self, link: Link, do: Callable[[], Control]) -> None:
        """Answer when what a person's word has changed is on the disk, not before."""
        answers: list[Control] = []
        self._enter(lambda: answers.append(do()))
        if await self._all_kept(None) and answers:
            self._answer(link, answers[0])

    def _answer(self, link: Link, message: Control) -> None:
        # Whoever asked may be gone by now: an impatient finger, a radio that is out of reach.
        with suppress(AddressError):
            link.send(message)
