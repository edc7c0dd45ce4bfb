"""Telemetry is asked for: every message at the highest rate that the manifest names for what it brings."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.contact.state import SOURCES
from lfield_mavlink.link.dialect import AUTOPILOT, dialect

#: Seconds after which a stream is asked for again, times how often that was in vain, this many times at most.
STALE, LONGEST = 3.0, 10
#: Seconds to wait at opening for what a vehicle tells.
TELLS = 3.0
#: Telemetry that ground stations ask for on the same link, and this driver makes no use of.
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
#: The share of its period after which a message is read; what comes sooner nobody has asked for.
EARLY = 0.6
#: The stream of REQUEST_DATA_STREAM that brings a message, for autopilots that know no intervals.
GROUPS: Mapping[int, int] = {
    dialect.MAVLINK_MSG_ID_SYS_STATUS: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: dialect.MAV_DATA_STREAM_EXTENDED_STATUS,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: dialect.MAV_DATA_STREAM_POSITION,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: dialect.MAV_DATA_STREAM_POSITION,
    dialect.MAVLINK_MSG_ID_ATTITUDE: dialect.MAV_DATA_STREAM_EXTRA1,
    dialect.MAVLINK_MSG_ID_VFR_HUD: dialect.MAV_DATA_STREAM_EXTRA2,
}
#: Messages that parts listen for, beside telemetry or faster than it, and at how many Hz they are wanted.
LISTENED: Mapping[int, float] = {
    # What setVelocity() is confirmed by, within a time-to-live of 0.5 s.
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: 10.0,
    # Readiness is in it.
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    dialect.MAVLINK_MSG_ID_FENCE_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 2.0,
    # A lost position must be known within 2 s, also where packets are lost.
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 6.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    # A foreign setpoint lasts until our next one: a second at most.
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 5.0,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
    dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: 5.0,
}
#: What only the other autopilot has, or is of no use here: PX4 refuses to send heartbeats faster.
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
#: What rovers do not tell, a setpoint with its velocity; and what is read of rovers instead.
ONLY_COPTERS = frozenset({dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED})
ONLY_ROVERS = frozenset({dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT})


class Streams:
    """Asks for the messages that bring telemetry, and asks again when one has stopped.

    A stream stops when the autopilot was restarted, or when it is now heard on another link: ArduPilot has
    the rates of each link on their own.
    """

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        rates = {quantity.name: quantity.rate for quantity in vehicle.manifest.device.telemetry}
        # Message id -> Hz.
        self._rates = {kind: max(rates[name] for name in names) for kind, names in SOURCES.items()}
        self._rates |= LISTENED
        self._last: dict[int, float] = {}
        self._read: dict[int, float] = {}
        # Of what was asked for: how often since it was heard last, and when.
        self._asked: dict[int, tuple[int, float]] = {}
        self._refused: set[int] = set()

    def heard(self, kind: int, now: float) -> None:
        """A message has come, and is read."""
        if kind in self._rates:
            self._last[kind] = self._read[kind] = now
            if kind in self._asked:
                self._asked[kind] = (0, now)

    def is_spare(self, kind: int, now: float) -> bool:
        """Whether a message need not be read, since nobody here uses it, or it comes too soon after the last.

        Such a message counts as heard.
        """
        if kind in UNUSED:
            return not self._vehicle.listens_to(kind)
        # What other parts have asked for may also be told when it changes; a heartbeat is a sign of life.
        if kind not in SOURCES or kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        if now - self._read.get(kind, -math.inf) > EARLY / self._rates[kind]:
            return False
        self._last[kind] = now
        return True

    async def prepare(self) -> None:
        """Ask for every stream, and note what does not come."""
        vehicle = self._vehicle
        self._asked, self._refused = {}, set()
        await asyncio.gather(*(self._ask_for(kind) for kind in self._wanted()))
        await self._ask_for_origin()
        await vehicle.seen(lambda: vehicle.state.knows_frames and not self._lacks_origin, TELLS)
        if self._lacks_origin:
            vehicle.note("it has not told where its frame begins: it has no place in the team's frame yet")
        elif not vehicle.state.knows_frames:
            vehicle.note(
                "it does not tell where home is; positions are of the place where it was switched on"
            )
        await vehicle.seen(lambda: not self._missing(), TELLS)
        if missing := self._missing():
            vehicle.note(f"it does not report {', '.join(missing)}")

    def _wanted(self) -> list[int]:
        """The messages to ask for, of those that its autopilot has."""
        profile = self._vehicle.profile
        others = ONLY_ARDUPILOT if profile.px4 else ONLY_PX4
        others |= frozenset() if profile.kind == "copter" else ONLY_COPTERS
        others |= frozenset() if profile.kind == "rover" else ONLY_ROVERS
        return [kind for kind in self._rates if kind not in others]

    def _missing(self) -> list[str]:
        told = {name for kind, names in SOURCES.items() if kind in self._last for name in names}
        return sorted({name for names in SOURCES.values() for name in names} - told)

    async def keep(self) -> None:
        """Ask again for what does not come or has stopped, until cancelled."""
        while True:
            await asyncio.sleep(STALE / 2)
            if self._vehicle.quiet or self._vehicle.lost or not self._asked:
                continue
            for kind in self._stale():
                await self._ask_for(kind)
            if self._lacks_origin or not self._vehicle.state.knows_frames:
                await self._ask_for_origin()

    def _stale(self) -> list[int]:
        """What is due to be asked for again. What was refused is not asked for."""
        now = self._vehicle.clock.monotonic()
        stale = []
        for kind, (times, at) in self._asked.items():
            pause = max(STALE, 3.0 / self._rates[kind]) * max(1, min(times, LONGEST))
            if kind not in self._refused and now - max(at, self._last.get(kind, at)) > pause:
                stale.append(kind)
        return stale

    @property
    def _lacks_origin(self) -> bool:
        """Whether its place in the team's frame hangs on where its own begins, and it has not told that."""
        placed, state = self._vehicle.binding.frame, self._vehicle.state
        return (
            placed is not None
            and state.origin is None
            and (placed.pose is None or state.origin_moved is None)
        )

    async def _ask_for_origin(self) -> None:
        """Where the estimator's frame is; ArduPilot tells it unasked only once, when it has found it."""
        origin = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
        await self._vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, origin)

    async def _ask_for(self, kind: int) -> None:
        vehicle, rate = self._vehicle, self._rates[kind]
        self._asked[kind] = (self._asked.get(kind, (0, 0.0))[0] + 1, vehicle.clock.monotonic())
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
