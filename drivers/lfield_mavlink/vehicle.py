"""One vehicle: combines its parts, and its life cycle from the first heartbeat."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from typing import Any

from msgspec import Struct

from lfield.driver import (
    Clock,
    DeviceBinding,
    DeviceError,
    Frame,
    Manifest,
    Reports,
    Setting,
    SettingsComparison,
)
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.contact.exchange import is_for_us
from lfield_mavlink.contact.identity import Identity
from lfield_mavlink.contact.link_health import LinkHealth
from lfield_mavlink.contact.telemetry_streams import TelemetryStreams
from lfield_mavlink.frames import frame_of
from lfield_mavlink.limit_enforcer import LimitEnforcer
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.packet_sources import REMEDY, Sources
from lfield_mavlink.link.ports import LinkCounts
from lfield_mavlink.modes import AUTONOMOUS
from lfield_mavlink.parts.fences import Fences, Rally
from lfield_mavlink.parts.flight import Flight
from lfield_mavlink.parts.guidance import Guidance
from lfield_mavlink.parts.maintenance import Maintenance
from lfield_mavlink.parts.missions import Missions
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.readiness import Readiness
from lfield_mavlink.parts.returns import Returns
from lfield_mavlink.parts.standstill import StandstillCheck
from lfield_mavlink.parts.storage import Files, Settings
from lfield_mavlink.payload.actuators import Actuators
from lfield_mavlink.payload.camera import Camera
from lfield_mavlink.payload.gimbal import Gimbal
from lfield_mavlink.payload.state_reports import StateReports
from lfield_mavlink.plan_flight import PlanFlight
from lfield_mavlink.services.autopilot_version import AutopilotVersion
from lfield_mavlink.services.file_transfer import FileTransfer
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.services.plan_transfer import PlanTransfer
from lfield_mavlink.setting_store import SettingStore
from lfield_mavlink.vehicle_facts import VehicleFacts
from lfield_mavlink.watchdog import Watchdog

#: Seconds within which two vehicles with one system id are detected.
SETTLES = 6.0
#: Requests for the unique id before the vehicle is armed, and seconds for a second answer.
BOARD_REQUESTS, SECOND = 2, 0.2


class LinkViews(Struct, frozen=True):
    """Data of the links of a vehicle.

    `counts` returns the counters of their readers, `silence_reason` a possible reason for silence, and
    `others` another station that commands it, if known; `sources` are the addresses that it sends from.
    """

    counts: Callable[[], LinkCounts] = LinkCounts
    silence_reason: Callable[[], str] = lambda: ""
    sources: Sources | None = None
    others: Callable[[], str] = lambda: ""


class MavlinkVehicle(Contact):
    """A vehicle with an autopilot that uses MAVLink 2; `send` sends a message."""

    #: MAVLink transmits 32-bit floats, in other units too.
    largest = 1e12

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        send: Callable[[Any], None],
        links: LinkViews | None = None,
    ) -> None:
        super().__init__(binding, manifest, clock, reports, send)
        links = links or LinkViews()
        self._silence_reason, self._sources = links.silence_reason, links.sources
        self._handled_moves = 0
        self._streams, self._health = TelemetryStreams(self), LinkHealth(self, links.counts)
        self._version = AutopilotVersion(self)
        self._identity = Identity(self, self._version.renew, lambda: (self.state.autopilot, self.state.type))
        self.parameters = Parameters(self, self._version.encoding)
        self.files = FileTransfer(self)
        self.plans = PlanTransfer(self, lambda: not self.profile.px4)
        self.motion = Motion(self, self.parameters, links.others)
        self.watchdog = Watchdog(self, self.parameters)
        self._store = SettingStore(self, self.parameters, self.watchdog)
        limits = Limits(binding, self.error)
        readiness = Readiness(self, self.motion)
        returns = Returns(self, limits, self.parameters, self.plans)
        self._flight = Flight(self, self.motion, limits, readiness, self.parameters, returns)
        self._standstill = StandstillCheck(self, self.motion)
        self._limit_enforcer = LimitEnforcer(self, self.motion)
        self._facts = VehicleFacts(self, self.parameters, self.motion.fence, binding)
        self._guidance = Guidance(self, self.motion, limits)
        self._missions = Missions(self, self.motion, limits, self.plans, returns)
        fences = Fences(self, self.plans, self.parameters)
        states = StateReports(self)
        self._camera = Camera(self, states)
        self.parts = (
            self._flight,
            readiness,
            self._guidance,
            self._missions,
            fences,
            PlanFlight(self, self.motion, self._missions, fences, self.plans),
            Rally(self, self.plans),
            Actuators(self, states),
            Gimbal(self, states),
            self._camera,
            Maintenance(self, self._renew),
            Settings(self, self.parameters, self.watchdog.protects),
            Files(self, self.files),
        )

    # -- messages -------------------------------------------------------------------------------------

    def on_message(self, message: Any) -> None:
        """Handles a message of this vehicle's autopilot."""
        now = self.clock.monotonic()
        self._note_sources()
        if self._identity.other_vehicle:
            # Another vehicle's state is ignored, except for its identity.
            self._on_other_vehicle(message)
            return
        self._health.count(message.get_seq(), now)
        self._streams.on_message(message.get_msgId(), now)
        super().on_message(message)
        if self._identity.is_another_kind:
            self._reconnected("a heartbeat of another type")

    def _on_other_vehicle(self, message: Any) -> None:
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self.state.set_kind(message.autopilot, message.type)
        elif is_for_us(message, self.station) and message.get_msgId() in (
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        ):
            self._dispatch(message)
        self._changed.set()

    # -- identity -------------------------------------------------------------------------------------

    def _note_sources(self) -> None:
        """Logs changes of the vehicle's addresses."""
        if self._sources is None:
            return
        while self._sources.events:
            self.note(self._sources.events.pop(0))
        if self._sources.moves != self._handled_moves:
            self._handled_moves = self._sources.moves
            self._reconnected("a change of its address")

    def on_other_source(self) -> None:
        """Handles a packet with the vehicle's ids from an unknown address."""
        self._note_sources()
        self._changed.set()

    def reconnected(self) -> None:
        """Handles a link to the vehicle that was reopened."""
        self._reconnected("a link was reopened")

    def _reconnected(self, reason: str) -> None:
        self._identity.suspect(reason)

    def _may_send(self, message: Any) -> bool:
        return self._identity.may_send(message)

    async def _gate(self, number: int) -> None:
        await self._identity.gate(number)

    def check_link(self) -> None:
        """Raises DeviceError when the link is lost, or messages of another vehicle arrive."""
        if self._identity.other_vehicle:
            raise self.error(self._identity.other_vehicle)
        if self.silence > LINK_LOST and (conflict := self.conflict):
            raise self.error(f"no message for {self.silence:.1f} s, and {conflict}", timeout=True)
        super().check_link()

    @property
    def conflict(self) -> str:
        """Describes the other vehicle with its system id, '' without one."""
        return "" if self._sources is None else self._sources.conflict(self.clock.monotonic())

    async def check_alone(self) -> None:
        """Ensures that one vehicle has this system id, and identifies it. Raises DeviceError.

        Two vehicles behind one peer, such as a router, both answer a request.
        """
        sources, now = self._sources, self.clock.monotonic
        if sources is not None and not await self.wait_for(lambda: sources.is_settled(now()), SETTLES):
            raise self.error("whether another vehicle has its system id is not known yet; try again")
        for _ in range(BOARD_REQUESTS if sources is not None else 0):
            self._identity.on_version(await self._version.renew())
            if await self.wait_for(lambda: bool(self.conflict), SECOND):
                break
        if conflict := self.conflict:
            raise self.error(f"arm refused: {conflict}; {REMEDY}")
        await self._identity.verify()

    # -- its telemetry --------------------------------------------------------------------------------

    def is_spare(self, kind: int, sequence: int) -> bool:
        """Whether a message need not be decoded; it counts as received."""
        now = self.clock.monotonic()
        is_spare = self._streams.is_spare(kind, now)
        if is_spare:
            self.heard()
            self._health.count(sequence, now)
        return is_spare

    # -- life cycle -----------------------------------------------------------------------------------

    async def _open(self) -> str:
        timeout: float = self.binding.option("connect")
        if not await self.wait_for(lambda: self.state.heartbeat_at is not None, timeout):
            raise self.error(
                f"no heartbeat from system {self.system} at {self.binding.endpoint} within {timeout:g} s; "
                f"{self._silence_reason()}",
                timeout=True,
            )
        self.check_identity()
        await self._identity.learn()
        await self._streams.prepare()
        if self.profile.px4 and (reason := self.binding.reasons.get(AUTONOMOUS)):
            self.note(log_messages.AUTONOMOUS_WAIVED.line(reason=reason))
        return f"{self.profile.stack} {self.profile.kind}, system {self.system}"

    def _touched(self) -> bool:
        """Always False: opening sends requests and selects telemetry, which does not affect motion."""
        return False

    async def _renew(self) -> None:
        """Repeats the requests and settings of opening. Raises DeviceError."""
        await self._streams.prepare()
        await self.check_watchdog()

    def background_tasks(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """Background tasks while the vehicle is open."""
        return (
            self._watch(),
            self._identity.run(),
            self._streams.run(),
            self._health.run(),
            self._limit_enforcer.run(),
            self._missions.run(),
            self.motion.speed.run(),
            self.motion.hover.run(),
            self._guidance.run(),
            self._facts.run(),
            self._camera.run(),
            self.motion.monitor.run(),
        )

    async def _watch(self) -> None:
        """Logs loss and recovery of the link; sets the vehicle up again when it is back."""
        is_ready = True
        while True:
            await asyncio.sleep(LINK_LOST / 4)
            is_silent = self.silence > LINK_LOST
            if is_silent != self.lost and self.state.heartbeat_at is not None:
                self.lost = is_silent
                self.note((log_messages.LINK_SILENT if is_silent else log_messages.LINK_BACK).line())
                is_ready = False
            if not (is_ready or is_silent or self.is_quiet):
                is_ready = await self._try_renewal()

    async def _try_renewal(self) -> bool:
        if not self._identity.is_certain:
            return False
        try:
            self.check_identity()
            await self._renew()
        except DeviceError as error:
            self.note(log_messages.SETUP_FAILED.line(reason=error.reason))
            return False
        return True

    # -- called by the guard --------------------------------------------------------------------------

    async def execute(self, instruction: str, arguments: Sequence[object]) -> Any:
        """See `Device`. The telemetry that caused an exception is published before it is raised."""
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

    async def stored_settings(self, names: Iterable[str]) -> Mapping[str, float]:
        """See `StoredSettings`."""
        return await self._store.values(names)

    async def compare_settings(self, file: str, data: bytes) -> SettingsComparison:
        """See `StoredSettings`."""
        return await self._store.compare(file, data)

    def _in_use(self) -> str:
        return "its motors are on" if self.state.armed else ""

    async def _make_safe(self, state: str) -> None:
        if self._identity.other_vehicle or self.silence <= LINK_LOST:
            await self._identity.verify()
        await self._flight.make_safe(state)
        self.assume_control()

    def _safe_action(self, state: str) -> str:
        return self.profile.safe_action(state)

    def _frame(self) -> Frame | None:
        placement = self.binding.frame
        return None if placement is None else frame_of(placement, self.state)

    def _moving(self) -> str:
        return self._standstill.description()

    def _taken_over(self) -> bool:
        return not self.motion.is_ours

    def _guard_restarted(self, was_taken_over: bool) -> None:
        if was_taken_over:
            self.motion.failsafe.on_earlier_engagement()
        else:
            self.motion.release()
            self._flight.may_be_arming()

    async def do_release(self) -> None:
        """Gives control to the program in the present mode."""
        self.motion.release()
        self.assume_control()

    def stop_setpoints(self) -> None:
        """Stops the setpoint stream."""
        self.motion.stream.stop()
