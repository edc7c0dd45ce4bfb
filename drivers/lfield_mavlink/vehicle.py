"""One vehicle: what it can do, part by part, and its life from the first heartbeat on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from lfield.driver import Clock, DeviceBinding, DeviceError, Frame, Manifest, Reports, Setting
from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.contact.exchange import is_for_us
from lfield_mavlink.contact.identity import Identity
from lfield_mavlink.contact.link_health import LinkHealth
from lfield_mavlink.contact.streams import Streams
from lfield_mavlink.frames import frame_of
from lfield_mavlink.limit_keeper import LimitKeeper
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.ports import LinkCounts
from lfield_mavlink.link.sources import REMEDY, Sources
from lfield_mavlink.modes import AUTONOMOUS
from lfield_mavlink.nature import Nature
from lfield_mavlink.parts.fences import Fences, Rally
from lfield_mavlink.parts.flight import Flight
from lfield_mavlink.parts.guidance import Guidance
from lfield_mavlink.parts.missions import Missions
from lfield_mavlink.parts.motion import Motion
from lfield_mavlink.parts.payload import Payload
from lfield_mavlink.parts.readiness import Readiness
from lfield_mavlink.parts.rest import Rest
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.parts.storage import Files, Settings
from lfield_mavlink.parts.upkeep import Upkeep
from lfield_mavlink.services.file_transfer import FileTransfer
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.services.plan_transfer import PlanTransfer
from lfield_mavlink.services.version import Version
from lfield_mavlink.watchdog import Watchdog

#: Seconds within which it is known whether two vehicles have one system id.
SETTLES = 6.0
#: How often it is asked for its unique id before it is armed, and the seconds for a second answer to come.
ASKED, SECOND = 2, 0.2


class MavlinkVehicle(Contact):
    """A vehicle with an autopilot that speaks MAVLink 2.

    `send` sends it a message, `counts` tells what the readers of its links have counted, `why_silent` why it
    may not be heard, `sources` knows the addresses that it is heard from, and `others` which other stations
    command it, as far as that is heard.
    """

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        send: Callable[[Any], None],
        counts: Callable[[], LinkCounts] = LinkCounts,
        why_silent: Callable[[], str] = lambda: "",
        sources: Sources | None = None,
        others: Callable[[], str] = lambda: "",
    ) -> None:
        super().__init__(binding, manifest, clock, reports, send)
        self._why_silent, self._sources = why_silent, sources
        self._moves = 0
        self._streams, self._health = Streams(self), LinkHealth(self, counts)
        self._version = Version(self)
        self._identity = Identity(self, self._version.renew, lambda: (self.state.autopilot, self.state.type))
        self.parameters = Parameters(self, self._version.encoding)
        self.files = FileTransfer(self)
        self.plans = PlanTransfer(self, lambda: not self.profile.px4)
        self.motion = Motion(self, self.parameters)
        self.motion.monitor.others = others
        self.watchdog = Watchdog(self, self.parameters)
        limits = Limits(binding, self.error)
        readiness = Readiness(self, self.motion)
        returns = Returns(self, limits, self.parameters, self.plans)
        self._flight = Flight(self, self.motion, limits, readiness, self.parameters, returns)
        self._rest = Rest(self, self.motion)
        self._keeper = LimitKeeper(self, self.motion)
        self._nature = Nature(self, self.parameters, self.motion.fence, binding)
        self._guidance = Guidance(self, self.motion, limits)
        self._missions = Missions(self, self.motion, limits, self.plans, returns)
        self.parts = (
            self._flight,
            readiness,
            self._guidance,
            self._missions,
            Fences(self, self.plans, self.parameters),
            Rally(self, self.plans),
            Payload(self),
            Upkeep(self, self._renew),
            Settings(self, self.parameters, self.watchdog.protects),
            Files(self, self.files),
        )

    # -- messages -------------------------------------------------------------------------------------

    def on_message(self, message: Any) -> None:
        """A message of this vehicle's autopilot."""
        now = self.clock.monotonic()
        self._note_sources()
        if self._identity.stranger:
            # Another vehicle's state is not this one's; only what tells who it is counts.
            self._on_stranger(message)
            return
        self._health.count(message.get_seq(), now)
        self._streams.heard(message.get_msgId(), now)
        super().on_message(message)
        if self._identity.is_another_kind:
            self._reconnected("a heartbeat of another type")

    def _on_stranger(self, message: Any) -> None:
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self.state.autopilot, self.state.type = message.autopilot, message.type
        elif is_for_us(message, self.station) and message.get_msgId() in (
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        ):
            self._hand_over(message)
        self._news.set()

    # -- who it is ------------------------------------------------------------------------------------

    def _note_sources(self) -> None:
        """What is new about the addresses that it is heard from."""
        if self._sources is None:
            return
        while self._sources.events:
            self.note(self._sources.events.pop(0))
        if self._sources.moves != self._moves:
            self._moves = self._sources.moves
            self._reconnected("a change of its address")

    def on_other_source(self) -> None:
        """A packet with its ids came from an address that is not known as its own."""
        self._note_sources()
        self._news.set()

    def reconnected(self) -> None:
        """A link that it is reached on was opened anew."""
        self._reconnected("a link was opened anew")

    def _reconnected(self, reason: str) -> None:
        self._identity.suspect(reason)

    def _may_send(self, message: Any) -> bool:
        return self._identity.may_send(message)

    async def _gate(self, number: int) -> None:
        await self._identity.gate(number)

    def check_link(self) -> None:
        """Raise DeviceError when the vehicle is not heard any more, or another one is."""
        if self._identity.stranger:
            raise self.error(self._identity.stranger)
        if self.silence > LINK_LOST and (conflict := self.conflict):
            raise self.error(f"nothing heard for {self.silence:.1f} s, and {conflict}", timeout=True)
        super().check_link()

    @property
    def conflict(self) -> str:
        """Which other vehicle has its system id, '' when none has."""
        return "" if self._sources is None else self._sources.conflict(self.clock.monotonic())

    async def check_alone(self) -> None:
        """Make certain that one vehicle has this system id, and which. Raises DeviceError.

        Two behind one far end, such as a router, both answer what is asked.
        """
        sources, now = self._sources, self.clock.monotonic
        if sources is not None and not await self.seen(lambda: sources.is_settled(now()), SETTLES):
            raise self.error("whether another vehicle has its system id is not known yet; try again")
        for _ in range(ASKED if sources is not None else 0):
            self._identity.look(await self._version.renew())
            if await self.seen(lambda: bool(self.conflict), SECOND):
                break
        if conflict := self.conflict:
            raise self.error(f"arm refused: {conflict}; {REMEDY}")
        await self._identity.verify()

    # -- its telemetry --------------------------------------------------------------------------------

    def is_spare(self, kind: int, sequence: int) -> bool:
        """Whether a message need not be read; it counts all the same."""
        now = self.clock.monotonic()
        spare = self._streams.is_spare(kind, now)
        if spare:
            self.heard()
            self._health.count(sequence, now)
        return spare

    # -- its life -------------------------------------------------------------------------------------

    async def _open(self) -> str:
        patience: float = self.binding.option("connect")
        if not await self.seen(lambda: self.state.heard is not None, patience):
            raise self.error(
                f"no heartbeat from system {self.system} at {self.binding.endpoint} within {patience:g} s; "
                f"{self._why_silent()}",
                timeout=True,
            )
        self.check_identity()
        await self._identity.learn()
        await self._streams.prepare()
        if self.profile.px4 and (reason := self.binding.reasons.get(AUTONOMOUS)):
            self.note(f"its own motions go on when this computer dies, as its binding waives: {reason}")
        return f"{self.profile.stack} {self.profile.kind}, system {self.system}"

    def _touched(self) -> bool:
        """Opening asks, and says which telemetry is wanted: it flies on as before."""
        return False

    async def _renew(self) -> None:
        """Ask and set again what was asked and set when it was opened. Raises DeviceError."""
        await self._streams.prepare()
        await self.check_watchdog()

    def keep(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """What runs beside the calls while the vehicle is open."""
        return (
            self._watch(),
            self._identity.keep(),
            self._streams.keep(),
            self._health.keep(),
            self._keeper.keep(),
            self._missions.keep(),
            self.motion.speed.keep(),
            self.motion.hover.keep(),
            self._guidance.keep(),
            self._nature.keep(),
            self.motion.monitor.keep(),
        )

    async def _watch(self) -> None:
        """Tell when the link is lost and found; when it is back, what it was told is told again."""
        ready = True
        while True:
            await asyncio.sleep(LINK_LOST / 4)
            silent = self.silence > LINK_LOST
            if silent != self.lost and self.state.heard is not None:
                self.lost = silent
                self.note("nothing heard; the link is lost" if silent else "heard again")
                ready = False
            if not (ready or silent or self.quiet):
                ready = await self._renewed()

    async def _renewed(self) -> bool:
        if not self._identity.is_certain:
            return False
        try:
            self.check_identity()
            await self._renew()
        except DeviceError as error:
            self.note(f"it is back, but not as it was: {error.reason}")
            return False
        return True

    # -- what the guard asks --------------------------------------------------------------------------

    async def execute(self, instruction: str, arguments: Sequence[object]) -> Any:
        """See `Device`. An exception comes when the telemetry that caused it can be read."""
        try:
            return await super().execute(instruction, arguments)
        except DeviceError:
            await self.motion.monitor.settle()
            raise

    async def _set_watchdog(self, longest: float) -> float | None:
        return await self.watchdog.seconds(longest)

    async def _settings(self) -> Sequence[Setting]:
        return await self.watchdog.settings()

    async def _serial(self) -> str:
        return await self._version.serial()

    async def _write_setting(self, name: str, value: float) -> None:
        await self.parameters.write(name, value)

    def _in_use(self) -> str:
        return "its motors are on" if self.state.armed else ""

    async def _make_safe(self, state: str) -> None:
        if self._identity.stranger or self.silence <= LINK_LOST:
            await self._identity.verify()
        await self._flight.make_safe(state)
        self.take_charge()

    def _frame(self) -> Frame | None:
        placement = self.binding.frame
        return None if placement is None else frame_of(placement, self.state)

    def _moving(self) -> str:
        return self._rest.words()

    def _taken_over(self) -> bool:
        return not self.motion.ours

    def _guard_restarted(self, taken: bool) -> None:
        if taken:
            self.motion.failsafe.has_had_it()
        else:
            self.motion.release()
            self._flight.may_be_arming()

    async def do_release(self) -> None:
        """Whatever mode it is in, the program takes the vehicle back."""
        self.motion.release()
        self.take_charge()

    def stop_setpoints(self) -> None:
        """Send no setpoint of a stream any more."""
        self.motion.stream.stop()
