"""Requests telemetry streams: each message at the highest rate of its quantities in the manifest."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.contact.vehicle_state import SOURCES
from lfield_mavlink.link.dialect import AUTOPILOT, dialect

#: Seconds after which a stream is requested again, times the failed requests up to a maximum.
STALE, LONGEST = 3.0, 10
#: Seconds to wait for the first message at opening.
FIRST_MESSAGE_TIMEOUT = 3.0
#: Telemetry that other ground stations request on the same link, unused here.
UNUSED = frozenset(
    {
        dialect.MAVLINK_MSG_ID_SCALED_IMU,
        dialect.MAVLINK_MSG_ID_RAW_IMU,
        dialect.MAVLINK_MSG_ID_SCALED_PRESSURE,
        dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        dialect.MAVLINK_MSG_ID_RC_CHANNELS_RAW,
        dialect.MAVLINK_MSG_ID_RC_CHANNELS,
        dialect.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        dialect.MAVLINK_MSG_ID_HIGHRES_IMU,
        dialect.MAVLINK_MSG_ID_ALTITUDE,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS,
        dialect.MAVLINK_MSG_ID_VIBRATION,
        dialect.MAVLINK_MSG_ID_ODOMETRY,
    }
)
#: Share of its period before which another message of a kind is skipped.
EARLY = 0.6
#: The REQUEST_DATA_STREAM group of a message, for autopilots without message intervals.
GROUPS: Mapping[int, int] = {
    dialect.MAVLINK_MSG_ID_SYS_STATUS: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: dialect.MAV_DATA_STREAM_POSITION,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: dialect.MAV_DATA_STREAM_POSITION,
    dialect.MAVLINK_MSG_ID_ATTITUDE: dialect.MAV_DATA_STREAM_EXTRA1,
    dialect.MAVLINK_MSG_ID_VFR_HUD: dialect.MAV_DATA_STREAM_EXTRA2,
}
#: Messages that parts need in addition or faster, with their rates in Hz.
EXTRA_RATES: Mapping[int, float] = {
    # Confirms setVelocity() within a time-to-live of 0.5 s.
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: 10.0,
    # Contains readiness.
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    dialect.MAVLINK_MSG_ID_FENCE_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 2.0,
    # A lost position must be detected within 2 s, also with packet loss.
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 6.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    # A foreign setpoint lasts until our next one: a second at most.
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 5.0,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
    dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: 5.0,
}
#: Messages that PX4 lacks or refuses to send faster (heartbeats).
ONLY_ARDUPILOT = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
    }
)
ONLY_PX4 = frozenset(
    {
        dialect.MAVLINK_MSG_ID_CURRENT_MODE,
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    }
)
#: Rovers do not send a setpoint with its velocity; the alternative for rovers.
ONLY_COPTERS = frozenset({dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED})
ONLY_ROVERS = frozenset({dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT})


class TelemetryStreams:
    """Requests telemetry messages, again when one has stopped.

    A stream stops when the autopilot restarts, or when the vehicle sends on another link: ArduPilot has
    separate rates for each link.
    """

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        rates = {quantity.name: quantity.rate for quantity in vehicle.manifest.device.telemetry}
        # Message id -> Hz.
        self._rates = {kind: max(rates[name] for name in names) for kind, names in SOURCES.items()}
        self._rates |= EXTRA_RATES
        self._last: dict[int, float] = {}
        self._read: dict[int, float] = {}
        # Requested messages: requests since the last message, and its time.
        self._requests: dict[int, tuple[int, float]] = {}
        self._refused: set[int] = set()

    def on_message(self, kind: int, now: float) -> None:
        """Records a message that was received and decoded."""
        if kind in self._rates:
            self._last[kind] = self._read[kind] = now
            if kind in self._requests:
                self._requests[kind] = (0, now)

    def is_spare(self, kind: int, now: float) -> bool:
        """Whether a message need not be decoded: unused, or too soon after the last.

        Such a message counts as received.
        """
        if kind in UNUSED:
            return not self._vehicle.listens_to(kind)
        # Other parts may need every message; a heartbeat proves contact.
        if kind not in SOURCES or kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        if now - self._read.get(kind, -math.inf) > EARLY / self._rates[kind]:
            return False
        self._last[kind] = now
        return True

    async def prepare(self) -> None:
        """Requests every stream, and logs those that do not arrive."""
        vehicle = self._vehicle
        self._requests, self._refused = {}, set()
        await asyncio.gather(*(self._request(kind) for kind in self._required()))
        await self._request_origin()
        await vehicle.wait_for(
            lambda: vehicle.state.knows_frames and not self._lacks_origin, FIRST_MESSAGE_TIMEOUT
        )
        if self._lacks_origin:
            vehicle.note(log_messages.NO_ORIGIN.line())
        elif not vehicle.state.knows_frames:
            vehicle.note(log_messages.NO_HOME.line())
        await vehicle.wait_for(lambda: not self._missing(), FIRST_MESSAGE_TIMEOUT)
        if missing := self._missing():
            vehicle.note(log_messages.TELEMETRY_MISSING.line(names=", ".join(missing)))

    def _required(self) -> list[int]:
        """The messages to request, of those that the autopilot supports."""
        profile = self._vehicle.profile
        unsupported = ONLY_ARDUPILOT if profile.px4 else ONLY_PX4
        unsupported |= frozenset() if profile.kind == "copter" else ONLY_COPTERS
        unsupported |= frozenset() if profile.kind == "rover" else ONLY_ROVERS
        return [kind for kind in self._rates if kind not in unsupported]

    def _missing(self) -> list[str]:
        received = {name for kind, names in SOURCES.items() if kind in self._last for name in names}
        return sorted({name for names in SOURCES.values() for name in names} - received)

    async def run(self) -> None:
        """Repeats requests for missing streams until cancelled."""
        while True:
            await asyncio.sleep(STALE / 2)
            if self._vehicle.is_quiet or self._vehicle.lost or not self._requests:
                continue
            for kind in self._stale():
                await self._request(kind)
            if self._lacks_origin or not self._vehicle.state.knows_frames:
                await self._request_origin()

    def _stale(self) -> list[int]:
        """The messages to request again, except refused ones."""
        now = self._vehicle.clock.monotonic()
        stale = []
        for kind, (count, requested_at) in self._requests.items():
            pause = max(STALE, 3.0 / self._rates[kind]) * max(1, min(count, LONGEST))
            if (
                kind not in self._refused
                and now - max(requested_at, self._last.get(kind, requested_at)) > pause
            ):
                stale.append(kind)
        return stale

    @property
    def _lacks_origin(self) -> bool:
        """Whether the position in the team's frame depends on an origin that is not known yet."""
        frame, state = self._vehicle.binding.frame, self._vehicle.state
        return (
            frame is not None and state.origin is None and (frame.pose is None or state.origin_moved is None)
        )

    async def _request_origin(self) -> None:
        """Requests the origin of the estimator's frame; ArduPilot sends it only once by itself."""
        origin = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
        await self._vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, origin)

    async def _request(self, kind: int) -> None:
        vehicle, rate = self._vehicle, self._rates[kind]
        self._requests[kind] = (self._requests.get(kind, (0, 0.0))[0] + 1, vehicle.clock.monotonic())
        answer = await vehicle.exchange.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 1e6 / rate)
        if answer.result == dialect.MAV_RESULT_ACCEPTED:
            return
        if kind in GROUPS:
            group, hertz = GROUPS[kind], math.ceil(rate)
            vehicle.send(
                dialect.MAVLink_request_data_stream_message(vehicle.system, AUTOPILOT, group, hertz, 1)
            )
        elif answer.result is not None:
            self._refused.add(kind)
