"""Home, restart, and commands that this driver has no word for."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.geo import Place
from lfield_mavlink.link.dialect import dialect, request_message

#: Seconds within which an autopilot restarts.
RESTART = 60.0
#: Seconds of silence after which it has begun to, and milliseconds by which packets overtake one another.
GONE, OVERTAKEN = 1.0, 500
#: How near the reported home must be to the one that was set, in metres; how often it is asked for, and the
#: seconds after each.
HOME_TOLERANCE = 1.0
HOMES, TELLS = 6, 0.5

#: Numbers that `command` refuses: they move the vehicle, arm it, change its mode or home, or switch what
#: protects it, past the limits of the binding and past the guard. All NAV and CONDITION commands are.
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


class Upkeep:
    """What is done to a vehicle that does not move. `renew` sets it up again as it was before a restart."""

    def __init__(self, vehicle: Contact, renew: Callable[[], Awaitable[None]]) -> None:
        self._vehicle, self._state, self._renew = vehicle, vehicle.state, renew

    async def do_set_home(self, latitude: float, longitude: float, altitude: float) -> None:
        """Home to a place: degrees, and metres above mean sea level. Only before it is armed.

        The fence of the binding is about home, so in flight home stays where it is.
        """
        fits = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(altitude)
        if not fits:
            raise self._vehicle.error("setHome needs a latitude, a longitude and a finite altitude")
        if self._state.armed:
            raise self._vehicle.error("setHome refused: the limits are about home, and the vehicle is armed")
        place = Place(latitude, longitude, altitude)
        await self._vehicle.command("setHome", dialect.MAV_CMD_DO_SET_HOME, 0.0, place=place)

        def there() -> bool:
            home = self._state.home
            return home is not None and math.dist(home.to(place), (0.0, 0.0, 0.0)) <= HOME_TOLERANCE

        for _ in range(HOMES):
            await self._vehicle.exchange.command(
                dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_HOME_POSITION)
            )
            if await self._vehicle.seen(there, TELLS):
                return
        raise self._vehicle.error("setHome was accepted but home is elsewhere")

    async def do_reboot(self) -> None:
        """Restart the autopilot; done when it is back and as it was set up before."""
        if self._state.armed:
            raise self._vehicle.error("reboot refused: the vehicle is armed")
        before = self._state.booted
        restarted = asyncio.Event()
        # The answer may be lost, and then nobody is there to be asked again.
        await self._vehicle.command(
            "reboot",
            dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
            1.0,
            taken=lambda: self._vehicle.silence > GONE,
        )

        def back() -> bool:
            """A clock that runs again from 0; or, of one that told no time, a word after a silence."""
            if self._vehicle.silence > LINK_LOST:
                restarted.set()
            now = self._state.booted
            told = before is not None and now is not None and now < before - OVERTAKEN
            return (told or restarted.is_set()) and self._vehicle.silence < 1.0

        end = self._vehicle.clock.monotonic() + RESTART
        while not await self._vehicle.seen(back, 1.0):
            if self._vehicle.clock.monotonic() > end:
                raise self._vehicle.error(f"reboot: it is not back after {RESTART:g} s", timeout=True)
            self._ask_the_time()
        await self._renew()

    def _ask_the_time(self) -> None:
        """Ask for a message with the time since start: after a restart nothing is streamed."""
        self._vehicle.send(request_message(self._vehicle.system, dialect.MAVLINK_MSG_ID_ATTITUDE))

    async def do_command(self, number: int, parameters: list[float]) -> int:
        """A COMMAND_LONG with up to seven parameters; its MAV_RESULT, whatever that is."""
        if number in REFUSED:
            raise self._vehicle.error(
                f"command {number} refused: it moves, arms or unprotects the vehicle; "
                "use the instruction for it"
            )
        if not 0 <= number <= 0xFFFF or len(parameters) > 7:
            raise self._vehicle.error("command needs a number from 0 to 65535 and at most 7 parameters")
        if not all(math.isfinite(value) and abs(value) < 3.4e38 for value in parameters):
            raise self._vehicle.error("command needs finite parameters")
        answer = await self._vehicle.exchange.command(number, *parameters, once=True)
        if answer.result is None:
            raise self._vehicle.error(f"command {number}: the autopilot did not answer", timeout=True)
        return answer.result
