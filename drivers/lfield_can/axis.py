"""CanAxis: one axis of any protocol. Monitors it, sets it up, makes it safe, and checks instructions."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports
from lfield_can import log_messages
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.protocols import PROTOCOLS, ProtocolContext
from lfield_can.timing import ChangeNotifier, MoveProgress, Sync

#: Seconds between two checks of a silent device.
WATCH_INTERVAL = 0.1
#: Seconds between two requests to a device before its first message.
PROBE_INTERVAL = 0.3
#: Seconds between two polls.
POLL_INTERVAL = 1.0
#: Seconds until the command of a safe state is repeated, and until it has failed.
SAFE_REPEAT, SAFE_TIMEOUT = 0.2, 5.0
#: Seconds for an axis to slow down by its profile.
HALT_TIMEOUT = 10.0
#: Seconds without progress after which a move has failed, and the least progress in rad.
STUCK_TIME, MIN_PROGRESS = 3.0, 1e-4
#: Rounding tolerance of a position bound in rad.
ROUNDING_POSITION = 1e-9
#: Relative rounding tolerance of a limit.
ROUNDING = 1.0 + 1e-9


class CanAxis(Device):
    """One axis: the instructions of axis.yaml for every protocol."""

    #: The largest magnitude of a number in an instruction; no frame can carry more.
    largest = 1e12

    def __init__(
        self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports, bus: Bus, sync: Sync
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self._changes = ChangeNotifier(clock)
        context = ProtocolContext(binding, bus, sync, clock, self._changes, self.note, self.error)
        self.protocol = PROTOCOLS[binding.option("protocol")](context)
        self._overheard = self.protocol.overheard()
        self.malformed = 0
        self._last_contact: float | None = None
        self._last_velocity: float | None = None
        self._lost = self._is_quiet = self._was_found = self._opened = False
        self._polled_at = 0.0
        self._reported_conflict = ""

    # -- frames and contact -----------------------------------------------------------------------------

    def prepare(self) -> None:
        """Reads the files of the axis. Raises DeviceError."""
        self.protocol.prepare()

    def listens(self) -> frozenset[int]:
        """The keys of the frames that the axis receives."""
        return self.protocol.ids() | self._overheard

    def commands(self) -> frozenset[int]:
        """The keys of frames that must have a single sender on the bus."""
        return self.protocol.ids()

    def on_frame(self, frame: Frame) -> None:
        """Handles a frame of this device; an invalid one is counted and dropped."""
        if frame.id in self._overheard:
            self.protocol.on_overheard(frame)
            return
        values = self.protocol.on_frame(frame)
        if values is None:
            self.malformed += 1
            return
        self._last_contact = self.clock.monotonic()
        self._last_velocity = self.protocol.state.velocity
        self.heard()
        if values:
            self.publish(**values)
        self._changes.notify()

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops everything that feeds the device's watchdog (False: starts it again)."""
        self._is_quiet = is_quiet
        self.protocol.set_quiet(is_quiet)

    def close(self) -> None:
        """Ends the protocol when the driver ends."""
        self.protocol.close()

    async def watch(self) -> None:
        """Logs loss and recovery of the device, stops it after a recovery, and polls it."""
        reported = ""
        while True:
            await asyncio.sleep(WATCH_INTERVAL)
            if not self._opened:
                continue
            try:
                await self._check_presence()
                reported = ""
            except DeviceError as error:
                if error.reason != reported:
                    self.note(log_messages.SETUP_FAILED.line(reason=error.reason))
                reported = error.reason
                await asyncio.sleep(POLL_INTERVAL)

    async def _check_presence(self) -> None:
        is_silent = self._silence() > self.protocol.silence
        self.publish(online=not is_silent)
        if is_silent != self._lost:
            self._lost = is_silent
            self.note((log_messages.SILENT if is_silent else log_messages.RESPONDING).line())
            if is_silent:
                self.protocol.on_silence()
                self.publish(enabled=False, state=self.protocol.state.state)
                self._changes.notify()
            else:
                # The motion of the device during the loss is unknown: stop it.
                await self.make_safe()
        await self._check_id_conflict()
        if self.protocol.state.enabled and self._leaves_bounds:
            self.note(log_messages.LEAVING_BOUNDS.line())
            await self._make_safe("brake")
        if is_silent or self._is_quiet:
            return
        if self.protocol.needs_setup:
            await self._set_up_again()
        if self.clock.monotonic() - self._polled_at >= POLL_INTERVAL:
            self._polled_at = self.clock.monotonic()
            self.publish(**await self.protocol.poll())

    async def _set_up_again(self) -> None:
        """Sets the axis up after a restart. The axis may be moving: another device with its id may have
        booted, or another master on the bus may have disabled it.
        """
        with suppress(DeviceError):  # the set-up below reports the cause
            await self.protocol.command_safe(self.safe_state)
        await self.protocol.setup()
        if self.protocol.state.enabled:
            await self._make_safe(self.safe_state)
        self.note(log_messages.SET_UP_AGAIN.line())

    async def _check_id_conflict(self) -> None:
        """Logs an id conflict and stops the axis, since two devices with one id both follow every command."""
        if self.protocol.needs_setup:
            return  # the set-up reports it
        conflict, reported = self.protocol.conflict, self._reported_conflict
        self._reported_conflict = conflict
        if conflict and not reported:
            self.note(log_messages.ID_CONFLICT.line(reason=conflict))
            if self.protocol.state.enabled:
                await self._make_safe(self.safe_state)
        elif reported and not conflict:
            self.note(log_messages.ID_UNIQUE.line())

    async def _open(self) -> str:
        await self._find()
        self._was_found = True
        identity = await self.protocol.setup()
        self.publish(online=True)
        self._opened = True
        return identity

    def _touched(self) -> bool:
        """Whether the device was found and so set up; before its first message it is only queried."""
        return self._was_found

    async def _serial(self) -> str:
        return await self.protocol.serial()

    async def _find(self) -> None:
        """Waits for the first message of the device."""
        timeout: float = self.binding.option("connect")
        end = self.clock.monotonic() + timeout
        while self.clock.monotonic() < end:
            self.protocol.call()
            if await self._changes.wait_for(
                lambda: self._last_contact is not None, min(PROBE_INTERVAL, timeout)
            ):
                return
        raise self.error(
            f"no message from node {self.protocol.node} at {self.binding.endpoint} within {timeout:g} s; "
            "check its power, wires and terminators, the bit rate, and the id in its binding",
            timeout=True,
        )

    async def _set_watchdog(self, longest: float) -> float | None:
        return await self.protocol.set_watchdog(longest)

    async def _make_safe(self, state: str) -> None:
        start = self.clock.monotonic()
        # An earlier velocity may be outdated.
        self.protocol.state.velocity = None

        def is_safe() -> bool:
            has_contact = self._last_contact is not None and self._last_contact > start
            return has_contact and self.protocol.is_safe(state, self._is_still)

        while True:
            await self.protocol.command_safe(state)
            if await self._changes.wait_for(is_safe, SAFE_REPEAT):
                # The velocity may arrive in a separate frame; `_moving` uses it.
                await self._changes.wait_for(lambda: self.protocol.state.velocity is not None, SAFE_REPEAT)
                if self.protocol.state.velocity is not None:
                    # The value was requested, but not published yet.
                    self.publish(velocity=self.protocol.state.velocity)
                return
            if self.clock.monotonic() >= start + SAFE_TIMEOUT or self._silence() > self.protocol.silence:
                break
        self._check_contact()
        raise self.error(f"the safe state {state} is not confirmed ({self._state_text()})")

    def _moving(self) -> str:
        silence, velocity = self._silence(), self._last_velocity
        motion = "its speed is unknown" if velocity is None else f"turning at {abs(velocity):.2g} rad/s"
        if silence > self.protocol.silence:
            last_motion = f", last seen {motion}" if velocity is not None else ""
            if self._last_contact is None:
                return "no message yet"
            return f"no message for {silence:.1f} s{last_motion}"
        if not self._is_still:
            return motion
        if not self.protocol.is_safe(self.safe_state, True):
            # Another master on the bus has moved it out of its safe state.
            return f"no longer in {self.safe_state} ({self._state_text()})"
        return ""

    # -- state ------------------------------------------------------------------------------------------

    @property
    def _is_still(self) -> bool:
        velocity = self.protocol.state.velocity
        return velocity is not None and abs(velocity) <= self.binding.option("standstill")

    @property
    def _leaves_bounds(self) -> bool:
        """Whether the axis is outside its bounds and moves farther out, as a velocity may cause."""
        position, velocity = self.protocol.state.position, self.protocol.state.velocity
        if position is None or velocity is None or self._is_still:
            return False
        margin = self.binding.option("tolerance")
        below = position < self.binding.option("lowest") - margin and velocity < 0.0
        return below or (position > self.binding.option("highest") + margin and velocity > 0.0)

    def _silence(self) -> float:
        return math.inf if self._last_contact is None else self.clock.monotonic() - self._last_contact

    def _state_text(self) -> str:
        state = self.protocol.state
        speed = "?" if state.velocity is None else f"{state.velocity:.3g}"
        return f"{state.state or 'no state'}, {speed} rad/s{f', fault: {state.fault}' if state.fault else ''}"

    def _check_contact(self) -> None:
        if self._silence() > self.protocol.silence:
            # Report it before the periodic check does: the caller reads the state.
            self.protocol.on_silence()
            self.publish(online=False, enabled=False, state=self.protocol.state.state)
            cause = self.protocol.bus.problem_text
            cause_text = f" ({cause})" if cause else ""
            raise self.error(f"no message for {self._silence():.1f} s{cause_text}", timeout=True)

    # -- instructions -----------------------------------------------------------------------------------

    async def do_enable(self) -> None:
        self._check_set_up("enable")
        await self.protocol.enable()

    async def do_disable(self) -> None:
        """Switches its torque off."""
        self._check_set_up("disable")
        await self.protocol.disable()

    async def do_reset_fault(self) -> None:
        """Clears the faults of the device."""
        self._check_set_up("resetFault")
        await self.protocol.reset_fault()

    async def do_home(self) -> None:
        """Finds the zero position."""
        self._check_ready("home")
        await self.protocol.home()
        self.publish(referenced=self.protocol.state.referenced)

    async def do_halt(self) -> None:
        """Slows down by the profile, and stays enabled."""
        self._check_set_up("halt")
        # An earlier velocity may be outdated.
        self.protocol.state.velocity = None
        await self.protocol.start_halt()
        if not await self._changes.wait_for(lambda: self._is_still, HALT_TIMEOUT):
            raise self.error(f"halt: it is still moving after {HALT_TIMEOUT:g} s ({self._state_text()})")
        await self.protocol.end_halt()

    async def do_stop(self) -> None:
        """Quick stop."""
        self._check_contact()
        await self._make_safe("brake")

    async def do_move_to(self, position: float, speed: float) -> None:
        self._check_position("moveTo", position)
        self._check_within("moveTo", "speed", speed, "rad/s")
        if speed <= 0.0:
            raise self.error(f"moveTo requires a speed above 0, not {speed:g}")
        self._check_ready("moveTo")
        await self.protocol.start_move(position, speed)
        await self._travel(position)

    async def do_set_position(self, position: float) -> None:
        """A position setpoint."""
        self._check_position("setPosition", position)
        if "speed" not in self.binding.limits:
            raise self.error("setPosition requires the limit 'speed' in its binding")
        self._check_ready("setPosition")
        await self.protocol.set_position(position)

    async def do_set_velocity(self, velocity: float) -> None:
        """A velocity setpoint."""
        self._check_within("setVelocity", "speed", velocity, "rad/s")
        self._check_outward("setVelocity", velocity)
        self._check_ready("setVelocity")
        await self.protocol.set_velocity(velocity)

    async def do_set_torque(self, torque: float) -> None:
        """A torque setpoint."""
        self._check_within("setTorque", "torque", torque, "N m")
        self._check_outward("setTorque", torque)
        self._check_ready("setTorque")
        await self.protocol.set_torque(torque)

    # -- parts of instructions --------------------------------------------------------------------------

    async def _travel(self, goal: float) -> None:
        """Waits until the axis is at rest at its goal, as long as it makes progress."""
        tolerance: float = self.binding.option("tolerance")
        progress = MoveProgress(self.clock, STUCK_TIME, MIN_PROGRESS)
        while True:
            self._check_ready("moveTo")
            position = self.protocol.state.position
            distance = abs(goal - position) if position is not None else math.inf
            if distance <= tolerance and self._is_still:
                return
            if failure := progress.failure(distance):
                await self.do_halt()  # Without it the motion continues when the obstacle is gone.
                raise self.error(failure)
            await self._changes.wait_change(WATCH_INTERVAL)

    def _check_set_up(self, instruction: str) -> None:
        self._check_contact()
        if self.protocol.conflict:
            raise self.error(f"{instruction} refused: {self.protocol.conflict}")
        if self.protocol.needs_setup:
            raise self.error(f"{instruction} refused: the device has restarted and is being set up again")

    def _check_ready(self, instruction: str) -> None:
        """Raises DeviceError unless the device is enabled."""
        self._check_set_up(instruction)
        state = self.protocol.state
        if state.fault:
            raise self.error(f"{instruction} refused: {state.fault}; resetFault() clears it")
        if not state.enabled:
            raise self.error(f"{instruction} refused: it is not enabled ({state.state}); call enable() first")

    def _check_within(self, instruction: str, limit: str, value: float, unit: str) -> None:
        bound = self.binding.limits.get(limit, math.inf)
        if not math.isfinite(value):
            raise self.error(f"{instruction} requires a finite number, not {value}")
        if abs(value) > bound * ROUNDING:
            raise self.error(
                f"{instruction} refused: {value:g} {unit} is above the limit of {bound:g} {unit}"
            )

    def _check_position(self, instruction: str, position: float) -> None:
        lowest, highest = self.binding.option("lowest"), self.binding.option("highest")
        if not math.isfinite(position):
            raise self.error(f"{instruction} requires a finite number, not {position}")
        if not lowest - ROUNDING_POSITION <= position <= highest + ROUNDING_POSITION:
            raise self.error(
                f"{instruction} refused: {position:g} rad is outside {lowest:g} to {highest:g} rad"
            )
        if not self.protocol.state.referenced and not self.binding.waives("no_homing"):
            raise self.error(
                f"{instruction} refused: it has not been homed; call home() first, or accept that by "
                "'waivers: [no_homing]' in its binding"
            )

    def _check_outward(self, instruction: str, direction: float) -> None:
        """Beyond a bound, permits only motion back."""
        position = self.protocol.state.position
        if position is None:
            return
        below = position < self.binding.option("lowest") and direction < 0.0
        if below or (position > self.binding.option("highest") and direction > 0.0):
            raise self.error(
                f"{instruction} refused: at {position:g} rad it would move farther out of its bounds"
            )
