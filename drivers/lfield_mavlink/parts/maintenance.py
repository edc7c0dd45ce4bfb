"""Home, restart, and raw commands."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import dialect, request_message

#: Seconds for an autopilot to restart.
RESTART = 60.0
#: Seconds of silence after which a restart has begun; milliseconds of packet reordering.
GONE, OVERTAKEN = 1.0, 500
#: Tolerance of the reported home in metres; number of requests, and seconds after each.
HOME_TOLERANCE = 1.0
HOME_ATTEMPTS, HOME_TIMEOUT = 6, 0.5

#: Commands that `command` refuses, since they would bypass the binding's limits and the guard: motion,
#: arming, modes, home, protections. All NAV and CONDITION commands.
_RANGES = (range(16, 160), range(176, 181), range(184, 200), range(207, 211), range(240, 249))
REFUSED = frozenset(number for numbers in _RANGES for number in numbers) | frozenset(
    {
        dialect.MAV_CMD_MISSION_START,
        dialect.MAV_CMD_ACTUATOR_TEST,
        dialect.MAV_CMD_COMPONENT_ARM_DISARM,
        dialect.MAV_CMD_DO_VTOL_TRANSITION,
        dialect.MAV_CMD_GUIDED_CHANGE_SPEED,
        dialect.MAV_CMD_GUIDED_CHANGE_ALTITUDE,
        dialect.MAV_CMD_GUIDED_CHANGE_HEADING,
        dialect.MAV_CMD_DO_FENCE_ENABLE,
        dialect.MAV_CMD_DO_GUIDED_LIMITS,
        dialect.MAV_CMD_DO_SET_MISSION_CURRENT,
    }
)


class Maintenance:
    """Maintenance of a vehicle at rest. `renew` sets it up again after a restart."""

    def __init__(self, vehicle: Contact, renew: Callable[[], Awaitable[None]]) -> None:
        self._vehicle, self._state, self._renew = vehicle, vehicle.state, renew

    async def do_set_home(self, latitude: float, longitude: float, altitude: float) -> None:
        """Sets home: degrees, and metres above mean sea level. Only before arming.

        The limits of the binding are relative to home, so it must not change in flight.
        """
        is_valid = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(altitude)
        if not is_valid:
            raise self._vehicle.error("setHome requires a latitude, a longitude and a finite altitude")
        if self._state.armed:
            raise self._vehicle.error(
                "setHome refused: the vehicle is armed, and its limits are relative to home"
            )
        place = Place(latitude, longitude, altitude)
        await self._vehicle.command("setHome", dialect.MAV_CMD_DO_SET_HOME, 0.0, place=place)

        def is_set() -> bool:
            home = self._state.home
            return home is not None and math.dist(home.vector_to(place), (0.0, 0.0, 0.0)) <= HOME_TOLERANCE

        for _ in range(HOME_ATTEMPTS):
            await self._vehicle.exchange.command(
                dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_HOME_POSITION)
            )
            if await self._vehicle.wait_for(is_set, HOME_TIMEOUT):
                return
        raise self._vehicle.error("setHome was accepted, but home is elsewhere")

    async def do_reboot(self) -> None:
        """Restarts the autopilot; done when it is back and set up again."""
        if self._state.armed:
            raise self._vehicle.error("reboot refused: the vehicle is armed")
        booted_before = self._state.booted
        restarted = asyncio.Event()
        # The answer may be lost, and cannot be requested again.
        await self._vehicle.command(
            "reboot",
            dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
            1.0,
            is_accepted=lambda: self._vehicle.silence > GONE,
        )

        def has_restarted() -> bool:
            """Whether a clock restarted from 0, or, without a known time, a message arrived after a
            silence.
            """
            if self._vehicle.silence > LINK_LOST:
                restarted.set()
            booted = self._state.booted
            has_rebooted = (
                booted_before is not None and booted is not None and booted < booted_before - OVERTAKEN
            )
            return (has_rebooted or restarted.is_set()) and self._vehicle.silence < 1.0

        end = self._vehicle.clock.monotonic() + RESTART
        while not await self._vehicle.wait_for(has_restarted, 1.0):
            if self._vehicle.clock.monotonic() > end:
                raise self._vehicle.error(f"reboot: it is not back after {RESTART:g} s", timeout=True)
            self._request_time()
        await self._renew()

    def _request_time(self) -> None:
        """Requests a message with the time since boot: after a restart nothing is streamed."""
        self._vehicle.send(request_message(self._vehicle.system, dialect.MAVLINK_MSG_ID_ATTITUDE))

    async def do_command(self, number: int, parameters: list[float]) -> int:
        """Sends a COMMAND_LONG with up to seven parameters; returns its MAV_RESULT."""
        if number in REFUSED:
            raise self._vehicle.error(
                f"command {number} refused: it can move or arm the vehicle, or disable a protection; "
                "use an instruction"
            )
        if not 0 <= number <= 0xFFFF or len(parameters) > 7:
            raise self._vehicle.error("command requires a number from 0 to 65535 and at most 7 parameters")
        if not all(math.isfinite(value) and abs(value) < 3.4e38 for value in parameters):
            raise self._vehicle.error("command requires finite parameters")
        answer = await self._vehicle.exchange.command(number, *parameters, once=True)
        if answer.result is None:
            raise self._vehicle.error(f"command {number}: the autopilot did not answer", timeout=True)
        return answer.result
