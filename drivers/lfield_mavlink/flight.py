"""Modes, arming, taking off, landing, and the safe states: each confirmed by the vehicle's state."""

from __future__ import annotations

import math

from lfield_mavlink.contact import LINK_LOST, SHOWS
from lfield_mavlink.dialect import dialect
from lfield_mavlink.geo import Vector
from lfield_mavlink.orders import Order
from lfield_mavlink.travel import CLOSER, Travel


class Flight(Travel):
    """What brings a vehicle into the air and down, and what keeps others' hands free."""

    # -- instructions ---------------------------------------------------------------------------------

    async def do_arm(self) -> None:
        """In a mode that may be armed in, then armed; its own watchdog is looked at before."""
        self._begin("arm")
        if self.state.armed:
            return
        await self._check_watchdog_holds()
        if self.state.mode != self.profile.arming:
            await self._set_mode(self.profile.arming)
        await self._achieve("arm", lambda: self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    async def do_disarm(self) -> None:
        """Motors off."""
        self._begin("disarm")
        await self._achieve("disarm", lambda: not self.state.armed, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    async def do_takeoff(self, height: float) -> None:
        """Up to `height` above home."""
        self._check_goal("takeoff", (0.0, 0.0, -height))
        if height <= 0.0:
            raise self.error(f"takeoff needs a height above 0, not {height:g}")
        self._begin("takeoff")
        if not self.state.armed:
            # PX4 would accept it, and fly off when it is armed later.
            raise self.error("takeoff refused: the motors are off; call arm() first")
        stood = self.state.landed

        def climbing() -> bool:
            return bool(stood) and not self.state.landed

        order = self._orders.take_off(height)
        await self._start("takeoff", order, taken=climbing)
        near = min(self._tolerance, 0.1 * height)
        await self._travel("takeoff", order, lambda place: abs(height + place[2]), near)

    async def do_land(self) -> None:
        """Down to the ground, here."""
        self._begin("land")
        await self._leave_for("land", self.profile.land, dialect.MAV_CMD_NAV_LAND)

        def height(place: Vector) -> float:
            return 0.0 if self._down else max(-place[2], CLOSER) + 1.0

        await self._travel("land", Order(frozenset({self.profile.land})), height, 0.0)

    async def do_return_home(self) -> None:
        """Back to where home is; what flies and can land is done when it stands there."""
        self._begin("returnHome")
        home = self.profile.home
        await self._leave_for("returnHome", home, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH)
        lands = self.profile.kind == "copter"
        way = _Way()

        def left(place: Vector) -> float:
            if lands:
                return 0.0 if self._down else way.left(place)
            return math.hypot(*place[:2])

        await self._travel("returnHome", Order(frozenset({home})), left, 0.0 if lands else self._tolerance)

    async def do_hold(self) -> None:
        """Stop and stay."""
        self._begin("hold")
        await self._set_mode(self.profile.hold)

    async def do_set_mode(self, name: str) -> None:
        """Any mode of the autopilot, by its own name for it."""
        wanted = name.upper()
        if self.profile.mode_values(wanted) is None:
            known = ", ".join(sorted(self.profile.modes.values()))
            raise self.error(f"{self.profile.stack} has no mode '{name}'; it has {known}")
        self._begin(f"mode {wanted}")
        await self._set_mode(wanted)

    async def do_release(self) -> None:
        """Whatever mode it is in, the program takes the vehicle back."""
        self._commanded = frozenset({self.state.mode})

    # -- the safe state -------------------------------------------------------------------------------

    async def _make_safe(self, state: str) -> None:
        self._stream.stop()
        if self.state.heard is not None and self._silence() <= LINK_LOST:
            if not self.state.armed:
                return
            if not self._ours:
                # A pilot or the autopilot's own failsafe flies it: to take it from them would be less safe.
                self.note(f"in {self.state.mode}, by a pilot or a failsafe: left to them")
                return
            if self.state.landed and self.profile.flies and await self._disarmed():
                return
        await self._set_mode(self.profile.safe(state))

    async def _disarmed(self) -> bool:
        """Try to switch the motors off on the ground; the autopilot refuses if it is not there."""
        answer = await self._exchange.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        if answer.result != dialect.MAV_RESULT_ACCEPTED:
            return False
        return await self._seen(lambda: not self.state.armed, SHOWS)

    # -- parts ----------------------------------------------------------------------------------------

    @property
    def _down(self) -> bool:
        """Whether it stands on the ground, or does not move by itself."""
        return bool(self.state.landed) or not self.state.armed

    async def _leave_for(self, what: str, mode: str, command: int) -> None:
        """Enter the mode of a command that has one of its own, such as NAV_LAND."""
        self._commanded |= {mode}
        await self._achieve(what, lambda: self.state.mode == mode or self._down, command)
        self._commanded = frozenset({mode})


class _Way:
    """The way back of a flight that may first climb, as a number that only falls while it gets on."""

    def __init__(self) -> None:
        self._moved = 0.0
        self._last: Vector | None = None

    def left(self, place: Vector) -> float:
        """Minus the metres flown so far: a return has a shape of its own, so any motion is progress."""
        if self._last is not None:
            self._moved += math.dist(place, self._last)
        self._last = place
        return 1e6 - self._moved
