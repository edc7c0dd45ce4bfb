"""CanAxis: the instructions of axis.yaml for every protocol, and what must hold before each."""

from __future__ import annotations

import math

from lfield_can.contact import LOOK, AxisContact

#: Seconds without coming closer after which a travel has failed, and what counts as closer, in rad.
STUCK, CLOSER = 3.0, 1e-4
#: A speed that has been rounded may be above its limit by so much, relatively.
ROUNDING = 1.0 + 1e-9


class CanAxis(AxisContact):
    """One axis."""

    # -- instructions -----------------------------------------------------------------------------------

    async def do_enable(self) -> None:
        """Follow commands."""
        self._check_set_up("enable")
        await self.protocol.enable()

    async def do_disable(self) -> None:
        """Torque off."""
        self._check_set_up("disable")
        await self.protocol.disable()

    async def do_reset_fault(self) -> None:
        """Clear faults."""
        self._check_set_up("resetFault")
        await self.protocol.reset_fault()

    async def do_home(self) -> None:
        """Find the zero."""
        self._check_ready("home")
        await self.protocol.home()
        self.publish(referenced=self.protocol.state.referenced)

    async def do_stop(self) -> None:
        """Quick stop."""
        self._check_heard()
        await self._make_safe("brake")

    async def do_move_to(self, position: float, speed: float) -> None:
        """Travel to a position."""
        self._check_position("moveTo", position)
        self._check_within("moveTo", "speed", speed, "rad/s")
        if speed <= 0.0:
            raise self.error(f"moveTo needs a speed above 0, not {speed:g}")
        self._check_ready("moveTo")
        await self.protocol.begin_move(position, speed)
        await self._travel(position)

    async def do_set_position(self, position: float) -> None:
        """One position setpoint."""
        self._check_position("setPosition", position)
        if "speed" not in self.binding.limits:
            raise self.error("setPosition needs the limit 'speed' in its binding: how fast may it go there?")
        self._check_ready("setPosition")
        await self.protocol.set_position(position)

    async def do_set_velocity(self, velocity: float) -> None:
        """One velocity setpoint."""
        self._check_within("setVelocity", "speed", velocity, "rad/s")
        self._check_outward("setVelocity", velocity)
        self._check_ready("setVelocity")
        await self.protocol.set_velocity(velocity)

    async def do_set_torque(self, torque: float) -> None:
        """One torque setpoint."""
        self._check_within("setTorque", "torque", torque, "N m")
        self._check_outward("setTorque", torque)
        self._check_ready("setTorque")
        await self.protocol.set_torque(torque)

    # -- parts of instructions --------------------------------------------------------------------------

    async def _travel(self, goal: float) -> None:
        """Wait until it is at its goal and stands, as long as it comes closer."""
        near: float = self.binding.option("tolerance")
        best, best_at = math.inf, self.clock.monotonic()
        while True:
            self._check_ready("moveTo")
            position = self.protocol.state.position
            left = abs(goal - position) if position is not None else math.inf
            if left <= near and self._still:
                return
            now = self.clock.monotonic()
            if left < best - CLOSER:
                best, best_at = left, now
            if now - best_at > STUCK:
                raise self.error(f"moveTo gave up: no progress for {STUCK:g} s, {left:.3f} rad from its goal")
            await self._news.next(LOOK)

    def _check_set_up(self, what: str) -> None:
        self._check_heard()
        if self.protocol.needs_setup:
            raise self.error(f"{what} refused: the device has restarted and is being set up again")

    def _check_ready(self, what: str) -> None:
        """Raise unless the device follows commands."""
        self._check_set_up(what)
        state = self.protocol.state
        if state.fault:
            raise self.error(f"{what} refused: {state.fault}; resetFault() clears it")
        if not state.enabled:
            raise self.error(f"{what} refused: it is not enabled ({state.state}); call enable() first")

    def _check_within(self, what: str, limit: str, value: float, unit: str) -> None:
        bound = self.binding.limits.get(limit, math.inf)
        if not math.isfinite(value):
            raise self.error(f"{what} needs a finite number, not {value}")
        if abs(value) > bound * ROUNDING:
            raise self.error(f"{what} refused: {value:g} {unit} is above the limit of {bound:g} {unit}")

    def _check_position(self, what: str, position: float) -> None:
        lowest, highest = self.binding.option("lowest"), self.binding.option("highest")
        if not math.isfinite(position):
            raise self.error(f"{what} needs a finite number, not {position}")
        if not lowest <= position <= highest:
            raise self.error(f"{what} refused: {position:g} rad is outside {lowest:g} to {highest:g} rad")
        if not self.protocol.state.referenced and not self.binding.waives("no_homing"):
            raise self.error(
                f"{what} refused: it has not been homed; call home() first, or accept that by "
                "'waivers: [no_homing]' in its binding"
            )

    def _check_outward(self, what: str, direction: float) -> None:
        """Beyond a bound, only the way back is free."""
        position = self.protocol.state.position
        if position is None:
            return
        below = position < self.binding.option("lowest") and direction < 0.0
        if below or (position > self.binding.option("highest") and direction > 0.0):
            raise self.error(f"{what} refused: at {position:g} rad it would go farther out of its bounds")
