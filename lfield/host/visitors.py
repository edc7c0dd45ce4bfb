"""What a host answers to its observers, and does at a person's word: `lfield ps`, `estop`, `forget`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.errors import AddressError
from lfield.host.core import HostCore
from lfield.host.stopping.stops import Stops
from lfield.host.watching.watchers import Watchers
from lfield.loop import spawn
from lfield.net.peers import Peers
from lfield.net.transport import Link
from lfield.wire.messages import Control
from lfield.wire.observing import (
    EmergencyStop,
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

#: For so many seconds the answer to a start waits for what other hosts say of their vehicles.
STARTED_WITHIN = 3.0
#: The status of a host is told at most every so many seconds: whoever asks more often gets one for all.
STATUS_EVERY = 0.05
#: Whoever has asked within so many seconds is looking at the devices, and gets one more answer in so many.
LOOKING, LAST_LOOK = 3.0, 1.5


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
        self._core, self._clock = core, clock
        self._enter, self._status, self._note, self._all_kept = enter, status, note, all_kept
        self.watchers = Watchers(core, guards, clock, status, peers.watch.latest)
        self.stops = Stops(core, guards, enter, note, all_kept)
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
            case EmergencyStop() | Pause():
                self.stops.order(message, str(link.who), lambda answer: self._answer(link, answer))
            case Forget():
                spawn(self._keep(link, lambda: Forgotten(self._core.forget(message.agent))))
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

    async def be_seen(self) -> None:
        """After an emergency stop somebody may be looking at the devices: let them see how that has ended."""
        if self._core.coordinators.stopped and self._clock.monotonic() - self._looked < LOOKING:
            await asyncio.sleep(LAST_LOOK)

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
