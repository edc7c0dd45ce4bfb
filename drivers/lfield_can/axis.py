"""CanAxis: one axis of any protocol, heard, set up and made safe; what must hold before each instruction."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports
from lfield_can.bus.bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.protocols import PROTOCOLS, Wiring
from lfield_can.timing import News, Sync

#: Seconds between two looks at a device that says nothing.
LOOK = 0.1
#: Seconds between two calls to a device that has not been heard yet.
CALL = 0.3
#: Seconds between two polls.
POLL = 1.0
#: Seconds until the command of a safe state is sent again, and until the guard is told that it failed.
SAFE_AGAIN, SAFE_BY = 0.2, 5.0
#: Seconds for an axis to slow down by its profile.
HALTS_BY = 10.0
#: Seconds without coming closer after which a travel has failed, and what counts as closer, in rad.
STUCK, CLOSER = 3.0, 1e-4
#: A position that has been rounded may be beyond its bound by so much, in rad.
ROUNDING_POSITION = 1e-9
#: A value that has been rounded may be beyond its limit by so much, relatively.
ROUNDING = 1.0 + 1e-9


class CanAxis(Device):
    """One axis: the instructions of axis.yaml for every protocol."""

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        bus: Bus,
        sync: Sync,
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self._news = News(clock)
        wiring = Wiring(binding, bus, sync, clock, self._news, self.note, self.error)
        self.protocol = PROTOCOLS[binding.option("protocol")](wiring)
        self._overheard = self.protocol.overheard()
        self.malformed = 0
        self._heard_at: float | None = None
        self._last_velocity: float | None = None
        self._lost = self._quiet = self._found = self._opened = False
        self._polled = 0.0
        self._conflict_told = ""

    # -- frames and signs of life -----------------------------------------------------------------------

    def prepare(self) -> None:
        """Read its files. Raises DeviceError."""
        self.protocol.prepare()

    def listens(self) -> frozenset[int]:
        """The keys of the frames that it wants."""
        return self.protocol.ids() | self._overheard

    def commands(self) -> frozenset[int]:
        """The keys that nobody else on the bus may command."""
        return self.protocol.ids()

    def on_frame(self, frame: Frame) -> None:
        """A frame of this device; one that makes no sense is counted and dropped."""
        if frame.id in self._overheard:
            self.protocol.on_overheard(frame)
            return
        values = self.protocol.on_frame(frame)
        if values is None:
            self.malformed += 1
            return
        self._heard_at = self.clock.monotonic()
        self._last_velocity = self.protocol.state.velocity
        self.heard()
        if values:
            self.publish(**values)
        self._news.tell()

    def quiet(self, on: bool) -> None:
        """Nothing that feeds the device's watchdog from now on (False: again)."""
        self._quiet = on
        self.protocol.quiet(on)

    def close(self) -> None:
        """The driver ends."""
        self.protocol.close()

    async def watch(self) -> None:
        """Tell when the device is lost and found; bring it back standing still; poll it."""
        told = ""
        while True:
            await asyncio.sleep(LOOK)
            if not self._opened:
                continue
            try:
                await self._look()
                told = ""
            except DeviceError as error:
                if error.reason != told:
                    self.note(f"{error.reason}; trying again")
                told = error.reason
                await asyncio.sleep(POLL)

    async def _look(self) -> None:
        silent = self._silence() > self.protocol.silence
        self.publish(online=not silent)
        if silent != self._lost:
            self._lost = silent
            self.note("it is not heard any more" if silent else "heard again")
            if silent:
                self.protocol.silent()
                self.publish(enabled=False, state=self.protocol.state.state)
                self._news.tell()
            else:
                # Nobody knows what it did meanwhile: it comes back standing.
                await self.make_safe()
        await self._look_at_conflict()
        if self.protocol.state.enabled and self._runs_out:
            self.note("it was leaving its bounds and is stopped")
            await self._make_safe("brake")
        if silent or self._quiet:
            return
        if self.protocol.needs_setup:
            await self._set_up_again()
        if self.clock.monotonic() - self._polled >= POLL:
            self._polled = self.clock.monotonic()
            self.publish(**await self.protocol.poll())

    async def _set_up_again(self) -> None:
        """After a restart. It may be in motion all the same: another device with its id has booted, or some
        other master on the bus has taken it out of operation."""
        with suppress(DeviceError):  # the set-up below reports the cause
            await self.protocol.command_safe(self.safe_state)
        await self.protocol.setup()
        if self.protocol.state.enabled:
            await self._make_safe(self.safe_state)
        self.note("it had restarted and is set up again, not enabled")

    async def _look_at_conflict(self) -> None:
        """Two devices with one id follow every command: they are told of once, and stopped."""
        if self.protocol.needs_setup:
            return  # the set-up tells of it
        conflict, told = self.protocol.conflict, self._conflict_told
        self._conflict_told = conflict
        if conflict and not told:
            self.note(f"{conflict}; motion is refused")
            if self.protocol.state.enabled:
                await self._make_safe(self.safe_state)
        elif told and not conflict:
            self.note("one device has its id again")

    async def _open(self) -> str:
        await self._find()
        self._found = True
        identity = await self.protocol.setup()
        self.publish(online=True)
        self._opened = True
        return identity

    def _touched(self) -> bool:
        """It is only called until it is heard; then it is set up."""
        return self._found

    async def _serial(self) -> str:
        return await self.protocol.serial()

    async def _find(self) -> None:
        """Wait until the device is heard."""
        patience: float = self.binding.option("connect")
        end = self.clock.monotonic() + patience
        while self.clock.monotonic() < end:
            self.protocol.call()
            if await self._news.seen(lambda: self._heard_at is not None, min(CALL, patience)):
                return
        raise self.error(
            f"nothing heard from node {self.protocol.node} at {self.binding.endpoint} within {patience:g} s; "
            "check its power, the wires and terminators, the bit rate, and its id in the bindings",
            timeout=True,
        )

    async def _set_watchdog(self, longest: float) -> float | None:
        return await self.protocol.set_watchdog(longest)

    async def _make_safe(self, state: str) -> None:
        begun = self.clock.monotonic()
        # What it told before says nothing of what it does now.
        self.protocol.state.velocity = None

        def is_safe() -> bool:
            heard = self._heard_at is not None and self._heard_at > begun
            return heard and self.protocol.is_safe(state, self._still)

        while True:
            await self.protocol.command_safe(state)
            if await self._news.seen(is_safe, SAFE_AGAIN):
                # Its speed may come in a frame of its own; `_moving` tells it.
                await self._news.seen(lambda: self.protocol.state.velocity is not None, SAFE_AGAIN)
                if self.protocol.state.velocity is not None:
                    # It may have been asked for, and then nobody has heard of it yet.
                    self.publish(velocity=self.protocol.state.velocity)
                return
            if self.clock.monotonic() >= begun + SAFE_BY or self._silence() > self.protocol.silence:
                break
        self._check_heard()
        raise self.error(f"it does not show the safe state {state} ({self._told()})")

    def _moving(self) -> str:
        silence, velocity = self._silence(), self._last_velocity
        known = "its speed is not known" if velocity is None else f"turning at {abs(velocity):.2g} rad/s"
        if silence > self.protocol.silence:
            last = f", last seen {known}" if velocity is not None else ""
            return f"not heard for {silence:.1f} s{last}" if self._heard_at is not None else "not heard yet"
        if not self._still:
            return known
        if not self.protocol.is_safe(self.safe_state, True):
            # Somebody else on the bus has led it out again, and may turn it at any time.
            return f"not in {self.safe_state} any more ({self._told()})"
        return ""

    # -- what is known ----------------------------------------------------------------------------------

    @property
    def _still(self) -> bool:
        velocity = self.protocol.state.velocity
        return velocity is not None and abs(velocity) <= self.binding.option("standstill")

    @property
    def _runs_out(self) -> bool:
        """Whether it is outside its bounds and on its way farther out, as velocities may lead it."""
        position, velocity = self.protocol.state.position, self.protocol.state.velocity
        if position is None or velocity is None or self._still:
            return False
        margin = self.binding.option("tolerance")
        below = position < self.binding.option("lowest") - margin and velocity < 0.0
        return below or (position > self.binding.option("highest") + margin and velocity > 0.0)

    def _silence(self) -> float:
        return math.inf if self._heard_at is None else self.clock.monotonic() - self._heard_at

    def _told(self) -> str:
        state = self.protocol.state
        speed = "?" if state.velocity is None else f"{state.velocity:.3g}"
        return f"{state.state or 'no state'}, {speed} rad/s{f', fault: {state.fault}' if state.fault else ''}"

    def _check_heard(self) -> None:
        if self._silence() > self.protocol.silence:
            # Before it is noticed in its turn: whoever catches this reads it.
            self.protocol.silent()
            self.publish(online=False, enabled=False, state=self.protocol.state.state)
            raise self.error(f"not heard for {self._silence():.1f} s", timeout=True)

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

    async def do_halt(self) -> None:
        """Slow down by the profile, and stay enabled."""
        self._check_set_up("halt")
        # What it told before says nothing of what it does now.
        self.protocol.state.velocity = None
        await self.protocol.begin_halt()
        if not await self._news.seen(lambda: self._still, HALTS_BY):
            raise self.error(f"halt: it does not stand after {HALTS_BY:g} s ({self._told()})")
        await self.protocol.end_halt()

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
        if self.protocol.conflict:
            raise self.error(f"{what} refused: {self.protocol.conflict}")
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
        if not lowest - ROUNDING_POSITION <= position <= highest + ROUNDING_POSITION:
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
