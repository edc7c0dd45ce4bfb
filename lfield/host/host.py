"""The shell of one host: sockets, guards, timers and the log around a core that decides.

Every event goes one way: `_enter` hands it to the core, lets it run, and carries out what comes of it. What
fails there is a bug of ours: the host stops feeding its guards and ends, its devices safe, and says why.
"""

from __future__ import annotations

import asyncio
import errno
import os
import traceback
from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from functools import partial
from mmap import mmap
from typing import Any

from lfield.devices.guards import Guards
from lfield.devices.keeper import STOPPING
from lfield.devices.measuring import insist
from lfield.errors import AddressError, DeviceError, HostFailure
from lfield.host.core import HostCore
from lfield.host.dumping import dump_agent
from lfield.host.effects import Call, CancelCall, Complain, Died, Effect, Keep, MakeSafe, Reach, Say, Write
from lfield.host.engines import engines_for
from lfield.host.logbook import Logbook
from lfield.host.scribe import Scribe
from lfield.host.sight.teller import Teller
from lfield.host.status import status_of
from lfield.host.stopping.shell import DatagramShell, order_datagrams
from lfield.host.surroundings import Options, Surroundings
from lfield.host.visitors import Visitors
from lfield.manifest import DeviceValue
from lfield.mission.mission import Mission
from lfield.mobility.core import Mobility
from lfield.mobility.effects import Send, SendTransfer
from lfield.mobility.fates import Fate
from lfield.mobility.neighbours import Neighbourhood
from lfield.net.peers import Peers
from lfield.net.transport import Link, Transport
from lfield.vm.machine import Machine
from lfield.wire.coordinators import Transfer
from lfield.wire.messages import Control, Hello
from lfield.wire.observing import Status, StatusRequest
from lfield.wire.orders import RelayedAnswer, RelayedOrder

#: How long a starting host waits for the others' first answers before it starts its coordinators: one that
#: is alive elsewhere must not be started twice. Longer than a host waits before it calls again.
CENSUS = 1.5
#: Bytes for the end of a host for which there is no more memory; until then it is address space only.
RESERVE = 4 << 20
#: What a computer is out of when it refuses a socket.
SCARCE = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class Host:
    """A host; `name` is its name in the deployment."""

    def __init__(
        self, mission: Mission, name: str, transport: Transport, logbook: Logbook, options: Options
    ) -> None:
        self.mission, self.name, self.options = mission, name, options
        self.team, self.logbook, self.clock = mission.team, logbook, options.clock
        self.started = self.clock.monotonic()
        self.teller = Teller(self.clock)
        here = self.team.number(name)
        team, clock, dice = self.team, self.clock, options.dice
        neighbours = Neighbourhood(team.hosts, here, everybody=mission.registry is not None)
        self.peers = Peers(
            self, transport, clock, dice, team.hosts, team.addresses, here, neighbours.near, options.admission
        )
        self.peers.refusals.on_refused = lambda *refusal: self._enter(partial(self.core.refused, *refusal))
        self.guards = Guards(
            mission.drivers, self.clock, self.note, silence=mission.bindings.silence, turned=self.turn
        )
        self.guards.tell = self.teller.device
        self.scribe = Scribe(
            options.journal,
            lambda number: self._enter(partial(self.core.kept, number)),
            lambda why: self._enter(partial(self.core.not_kept, why)),
            lambda trouble: self._enter(partial(self.core.room, trouble)),
        )
        self.core = HostCore(
            mission,
            name,
            dice.getrandbits(62) + 1,
            clock,
            Surroundings(self.peers, self.guards),
            options.dice,
            options.unreachable_after,
            neighbours,
            self.scribe.memory,
            self.scribe.pages,
            self.scribe.times,
            engines_for(options.engine, self.note),
            self.teller,
            options.draw,
        )
        core, guards, peers, kept = self.core, self.guards, self.peers, self.scribe.all_kept
        self._visitors = Visitors(core, guards, peers, clock, self._enter, self.status, self.note, kept)
        self._datagrams = self._order_datagrams(transport)
        self.broken: dict[str, bool] = {}  # by agent that has died here: whether of a bug of lfield
        #: Set when the host has failed: `failure` says by what.
        self.failed, self.changed = asyncio.Event(), asyncio.Event()
        self.failure: HostFailure | None = None
        #: Called first when it fails: whatever is wrong must not keep it from ending.
        self.on_failure: Callable[[], None] = lambda: None
        #: What other hosts have last said of themselves, for whoever asks them.
        self.statuses: dict[str, Status] = {}
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | asyncio.Handle | None = None
        self.address, self._due = "", 0.0
        self._events: deque[Callable[[], None]] = deque()
        self._reserve = mmap(-1, RESERVE)
        self._entered = self._stopped = False
        options.admission.serve(self.flies, mission.access.barred, self.note)

    def _order_datagrams(self, transport: Transport) -> DatagramShell | None:
        keys, admission = self.options.orders, self.options.admission
        stops = self._visitors.stops
        return order_datagrams(keys, transport, admission, self.core, stops, self.peers, self.fail)

    @property
    def machine(self) -> Machine:
        """The agents that are here."""
        return self.core.machine

    @property
    def mobility(self) -> Mobility:
        """What is known of the coordinators."""
        return self.core.mobility

    # --- life -----------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Listen, open the devices, start the resources, ask what the others know, start the coordinators.

        Raises AddressError and DevicesError: then nothing has moved.
        """
        self.address = await self.peers.open(self.options.listen)
        await self._open_door(self.options.door)
        devices = self.mission.devices_of(self.name)
        self._visitors.stops.stay_stopped()
        await insist(self.guards.lateness.limit, devices, self.clock)
        await self.guards.open(devices)
        await self._visitors.stops.stay_paused()
        where = f"on {self.address}" if self.address else "for this computer alone"
        self.note(f"{self.name} is up {where}{'' if self.scribe.memory else ', and keeps nothing'}")
        if line := self.options.admission.line():
            self.note(line)
        self.scribe.forget(self.core.coordinators.recovery.outdated)
        self.scribe.look()
        self._enter(partial(self.core.start_resources, first=self.options.first_start))
        if not self.core.has_coordinators:
            return
        await self.peers.first_round(CENSUS)
        self._enter(partial(self.core.start_coordinators, first=self.options.first_start))
        await self.scribe.all_kept()

    async def _open_door(self, door: str) -> None:
        """A host that cannot be asked on this computer runs all the same."""
        try:
            if door:
                await self.peers.open_door(door)
        except AddressError as error:
            self.note(f"commands find this host over the network only, with a person's keys: {error}")

    async def stop(self) -> dict[str, str]:
        """Make the devices safe, stay until they are at rest, then close everything.

        Meanwhile no agent runs, and who asks gets an answer. Coordinators that are here end with the host.
        Returns the devices that have not been seen at rest in their safe states, by name, each with what was
        last known of it. `guards.hurry` cuts the waiting short.
        """
        if self._stopped:
            return {}
        if self.failure is None:
            self.teller.ending("", STOPPING)
        self._enter(self.core.halt)
        unsafe = await self.guards.close()
        for name, why in unsafe.items():
            self.note(f"{name}: NOT SAFE: {why}")
        await self._visitors.be_seen()
        self._visitors.watchers.last_words()
        await self.scribe.close()
        self._stopped = True
        if self._timer:
            self._timer.cancel()
        self.peers.close()
        if self._datagrams is not None:
            self._datagrams.close()
        self.logbook.flush()
        return unsafe

    # --- one way in, one way out ----------------------------------------------------------------------

    def turn(self) -> bool:
        """Let the core do what is due; whether it could. A beat for a guard is given only after a turn."""
        self._enter(lambda: None)
        return self.failure is None

    def _enter(self, event: Callable[[], None]) -> None:
        """Hand an event to the core. One that comes of another's effects waits until those are done."""
        if self._stopped or self.failure:
            return
        self._events.append(event)
        if self._entered:
            return
        self._entered = True
        try:
            while self._events:
                self._events.popleft()()
                pause = self.core.run()
                for effect in self.core.take():
                    self._carry_out(effect)
            self.logbook.flush()
            self._come_back(pause)
        except Exception as error:
            self.fail(error)
        finally:
            self._entered = False

    def _come_back(self, pause: float | None) -> None:
        """Turn again after so many seconds, or sooner: a timer that is early enough stays as it is."""
        if pause is None:
            return
        due = self._loop.time() + pause
        if self._timer is not None:
            if self._due <= due:
                return
            self._timer.cancel()
        self._due = due
        self._timer = self._loop.call_at(due, self._wake) if pause else self._loop.call_soon(self._wake)

    def _wake(self) -> None:
        self._timer = None
        self.turn()

    def fail(self, error: BaseException) -> None:
        """A bug in the host itself: nothing more is done, no guard is fed, and whoever runs it ends it."""
        if self.failure is not None:
            return
        self._reserve.close()
        self.on_failure()
        self.failure = HostFailure(self.name, error)
        self.failed.set()
        # The bug may be in the log itself: it must not keep the host from ending.
        with suppress(Exception):
            self.teller.ending(str(self.failure), STOPPING)
            self.note(str(self.failure))
            if os.environ.get("LFIELD_TRACEBACK"):
                self.note("".join(traceback.format_exception(error)), lines=True)

    def unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """The loop's exception handler: what was raised beside the core, in a task or a socket's callback."""
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in SCARCE and "socket" in context:
            # Asyncio's own loop tells so of a caller that it has no descriptor for, and tries again.
            self.peers.complain(f"nobody else can be let in: {error.strerror}")
            return
        self.fail(error if isinstance(error, BaseException) else RuntimeError(context["message"]))

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case SendTransfer():
                self.peers.send_transfer(effect.host, effect.header, effect.block)
            case Send():
                self.peers.send(effect.host, effect.message)
            case Write():
                self.logbook.write(effect.text)
            case Say():
                (self.logbook.note if effect.told else self.note)(effect.text, lines=effect.lines)
            case Complain():
                self.peers.complain(effect.text)
            case Call():
                self._call(effect)
            case CancelCall():
                self.guards.cancel(effect.agent.id, effect.thread)
            case Keep():
                self.scribe.keep(effect)
            case MakeSafe():
                self.teller.without_policy(effect.reason, effect.users)
                self.guards.make_safe(effect.device, effect.reason, effect.state)
            case Reach():
                self.peers.reach(effect.host)
            case Died():
                self.broken[effect.agent.id] = effect.agent.broken
                if self.options.dump:
                    self.note(dump_agent(self.mission, self.name, effect.agent, self.options.dump))
            case _:
                self.changed.set()

    def _call(self, asked: Call) -> None:
        def answered(value: DeviceValue | DeviceError) -> None:
            self._enter(partial(self.core.answered, asked, value))

        call = asked.call
        try:
            self.guards.call(
                asked.agent.id,
                call.field,
                call.instruction,
                asked.values,
                answered,
                until=asked.until,
                thread=asked.thread,
            )
        except DeviceError as error:
            answered(error)

    # --- Owner of the links ---------------------------------------------------------------------------

    def hello(self) -> Hello:
        """What this host says of itself now."""
        return self.core.hello()

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""
        self._enter(partial(self.core.linked, hello))

    def unlinked(self, host: str, *, quietly: bool) -> None:
        """A host cannot be talked to any more."""
        self._enter(partial(self.core.unlinked, host, quietly=quietly))

    def wanted(self) -> Collection[str]:
        """The hosts to have links with now."""
        return self.core.wanted()

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came."""
        self._enter(partial(self.core.arrived, host, header, block))

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self._enter(partial(self.core.too_large, host, header, size))

    def received(self, host: str, message: Control, link: Link) -> None:
        """A message came; `host` is '' when an observer sent it."""
        if isinstance(message, Status):
            self.statuses[host] = message
            if host:
                self._enter(partial(self.core.told, host, message))
            self.changed.set()
        elif isinstance(message, RelayedOrder | RelayedAnswer) and self._datagrams is not None:
            self._datagrams.relayed(host, message)
        elif isinstance(message, StatusRequest) or not host:
            self._visitors.received(message, link)
        else:
            self._enter(partial(self.core.received, host, message))

    def flies(self) -> bool:
        """Whether a device is in use here, or a coordinator goes on that nobody has paused or stopped."""
        latched, moving = self.guards.latched, self.guards.moving
        in_use = (device for device in self.mission.devices_of(self.name) if not device.is_sensor)
        if any(device.name not in latched or moving.get(device.name) for device in in_use):
            return True
        held = self.core.coordinators.paused or self.core.coordinators.stopped
        return not held and any(known.state != "EXITED" for known in self.mobility.knowledge())

    def reaped(self, host: str) -> None:
        """Whoever started the hosts says that one has ended for good."""
        self._enter(partial(self.core.reaped, host))

    def pass_on(self, found: Iterable[Fate]) -> None:
        """This host is about to go: it tells all others of the endings it knows, and what it found."""
        self._enter(partial(self.core.pass_on, found))

    def note(self, text: str, *, lines: bool = False) -> None:
        """A line for the log; what a program says may have several `lines`."""
        self.teller.logged(text)
        self.logbook.note(text, lines=lines)

    # --- what others want to know ---------------------------------------------------------------------

    def status(self) -> Status:
        """What `lfield ps` shows of this host."""
        up, journal = self.clock.monotonic() - self.started, self.scribe.journal
        unkept = self.options.admission.unkept
        return status_of(self.core, self.peers, self.guards, journal, self.address, up, self.clock, unkept)
