"""Home, restart, and commands that this driver has no word for."""

from __future__ import annotations

import asyncio
import math

from lfield_mavlink.contact import LINK_LOST, Contact
from lfield_mavlink.dialect import AUTOPILOT, dialect
from lfield_mavlink.geo import Place

#: Seconds within which an autopilot restarts.
RESTART = 60.0
#: How near the reported home must be to the one that was set, in metres.
HOME_TOLERANCE = 1.0

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


class Upkeep(Contact):
    """What is done to a vehicle that does not move."""

    async def do_set_home(self, latitude: float, longitude: float, altitude: float) -> None:
        """Home to a place: degrees, and metres above mean sea level. Only before it is armed.

        The fence of the binding is about home, so in flight home stays where it is.
        """
        fits = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(altitude)
        if not fits:
            raise self.error("setHome needs a latitude, a longitude and a finite altitude")
        if self.state.armed:
            raise self.error("setHome refused: the limits are about home, and the vehicle is armed")
        place = Place(latitude, longitude, altitude)
        await self._command("setHome", dialect.MAV_CMD_DO_SET_HOME, 0.0, place=place)

        def there() -> bool:
            home = self.state.home
            return home is not None and math.dist(home.to(place), (0.0, 0.0, 0.0)) <= HOME_TOLERANCE

        for _ in range(6):
            await self._exchange.command(
                dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_HOME_POSITION)
            )
            if await self._seen(there, 0.5):
                return
        raise self.error("setHome was accepted but home is elsewhere")

    async def do_reboot(self) -> None:
        """Restart the autopilot; done when it is back and as it was set up before."""
        if self.state.armed:
            raise self.error("reboot refused: the vehicle is armed")
        before = self.state.booted
        restarted = asyncio.Event()
        await self._command("reboot", dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)

        def back() -> bool:
            """A clock that runs again from 0; or, of one that told no time, a heartbeat after a silence."""
            if self._silence() > LINK_LOST:
                restarted.set()
            told = before is not None and self.state.booted is not None and self.state.booted < before
            return (told or restarted.is_set()) and self._silence() < 1.0

        end = self.clock.monotonic() + RESTART
        while not await self._seen(back, 1.0):
            if self.clock.monotonic() > end:
                raise self.error(f"reboot: it is not back after {RESTART:g} s", timeout=True)
            self._ask_the_time()
        await self._prepare()
        await self._check_watchdog()

    def _ask_the_time(self) -> None:
        """Ask for a message with the time since start: after a restart nothing is streamed."""
        number, kind = dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_ATTITUDE)
        self._send(
            dialect.MAVLink_command_long_message(self.system, AUTOPILOT, number, 0, kind, 0, 0, 0, 0, 0, 0)
        )

    async def do_command(self, number: int, parameters: list[float]) -> int:
        """A COMMAND_LONG with up to seven parameters; its MAV_RESULT, whatever that is."""
        if number in REFUSED:
            raise self.error(
                f"command {number} refused: it moves, arms or unprotects the vehicle; "
                "use the instruction for it"
            )
        if not 0 <= number <= 0xFFFF or len(parameters) > 7:
            raise self.error("command needs a number from 0 to 65535 and at most 7 parameters")
        if not all(math.isfinite(value) and abs(value) < 3.4e38 for value in parameters):
            raise self.error("command needs finite parameters")
        answer = await self._exchange.command(number, *parameters, once=True)
        if answer.result is None:
            raise self.error(f"command {number}: the autopilot did not answer", timeout=True)
        return answer.result
