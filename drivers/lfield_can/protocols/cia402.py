"""Motion of CiA 402 drives: state machine, modes of operation, setpoints, homing and safe states."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_can import log_messages
from lfield_can.bus.frames import Frame
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.axis_protocol import ProtocolContext
from lfield_can.protocols.cia402_node import STEP_TIMEOUT, Cia402Node
from lfield_can.timing import PeriodicTask

#: Seconds for a new setpoint to be accepted, and for homing.
ACCEPT_TIMEOUT, HOMING_TIMEOUT = 0.5, 120.0
#: Seconds for the bits of an earlier homing to clear.
STALE_BITS = 0.2


class Cia402(Cia402Node):
    """One drive."""

    def __init__(self, context: ProtocolContext) -> None:
        super().__init__(context)
        self._stream = PeriodicTask(context.clock)
        # The present mode of operation, 0 if unknown, and the last position of a stream.
        self._mode = 0
        self._commanded: float | None = None

    def reset_state(self, state: str) -> None:
        """Discards the previous state."""
        self._stream.stop()
        self._mode, self._commanded = 0, None
        super().reset_state(state)

    def on_status(self, statusword: int) -> dict[str, object] | None:
        """Stops the stream of a drive that stopped by itself: its control word could re-enable the drive."""
        changes = super().on_status(statusword)
        if not self.state.enabled:
            self._stream.stop()
        return changes

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops (or starts) a stream too: it feeds the watchdog of the drive."""
        if is_quiet:
            self._stream.stop()
        super().set_quiet(is_quiet)

    def close(self) -> None:
        """Stops a stream too."""
        self._stream.stop()
        super().close()

    # -- instructions -----------------------------------------------------------------------------------

    async def enable(self) -> None:
        """Steps through the state machine to "operation enabled", without an earlier target."""
        if self.pdo_configuration.data.can_send(t.TO_VELOCITY):
            await self.objects.write(0x60FF, 0, 0)
        await self._leave_quick_stop()
        await self._set_mode(t.PROFILE_POSITION)
        for _ in range(len(t.STATES)):
            state = self.state.state
            if self.state.enabled:
                return
            if self.state.fault:
                raise self.context.error(f"enable refused: {self.state.fault}; resetFault() clears it")
            await self._control(t.UPWARDS.get(state, t.DISABLE_VOLTAGE))
            await self._await_exit(state)
        raise self.context.error(f"enable failed: it remains in '{self.state.state}'")

    async def _leave_quick_stop(self) -> None:
        """Leaves a quick stop with torque by transition 16: without voltage a load would fall.

        In velocity mode with target 0, since no earlier goal may take effect. Not every drive supports it.
        """
        if self.state.state != "quick stop active" or not self.pdo_configuration.data.can_send(t.TO_VELOCITY):
            return
        with suppress(DeviceError):
            await self._set_mode(t.PROFILE_VELOCITY)
            await self._control(t.ENABLE)
            await self.context.changes.wait_for(
                lambda: self.state.state != "quick stop active", ACCEPT_TIMEOUT
            )
        if self.state.state == "quick stop active":
            self.context.note(log_messages.TORQUE_GAP.line())

    async def _await_exit(self, state: str) -> None:
        await self.expect(lambda: self.state.state != state, STEP_TIMEOUT, f"it did not leave '{state}'")

    async def disable(self) -> None:
        """Switches the voltage off."""
        self._stream.stop()
        await self._control(t.DISABLE_VOLTAGE)
        await self.expect(lambda: self.state.state in t.IDLE, STEP_TIMEOUT, "its torque did not switch off")

    async def reset_fault(self) -> None:
        """Sends a rising edge of the reset bit."""
        await self._control(t.DISABLE_VOLTAGE)
        await self._control(t.FAULT_RESET)
        await self.expect(lambda: not self.state.fault, STEP_TIMEOUT, "the fault was not cleared")
        await self._control(t.DISABLE_VOLTAGE)

    async def home(self) -> None:
        """Homes the drive by the method of the binding."""
        method: int = self.binding.option("homing_method")
        if method == 0:
            raise self.context.error(
                "home requires 'homing_method' in its binding: the number of the method in the drive's manual"
            )
        self._stream.stop()
        await self.objects.write(0x6098, 0, method)
        if speed := self.binding.option("homing_speed"):
            for subindex in (1, 2):
                await self.objects.write(0x6099, subindex, abs(self.units.to_velocity(speed)))
        await self._set_mode(t.HOMING)
        try:
            await self._control(t.ENABLE | t.START_HOMING)
            await self._await_homing_end()
        finally:
            self.bus.post(self._frame(t.CONTROL, t.ENABLE))
        self.state.referenced = True

    async def _await_homing_end(self) -> None:
        """Waits for the end of homing. The bits of an earlier homing may remain for a moment."""
        await self.context.changes.wait_for(lambda: not self.statusword & t.ACKNOWLEDGED, STALE_BITS)
        done = t.ACKNOWLEDGED | t.TARGET_REACHED

        def has_ended() -> bool:
            bits = self.statusword
            return bits & done == done or bool(bits & t.FAILED) or not self.state.enabled

        await self.expect(has_ended, HOMING_TIMEOUT, "homing did not end")
        if not self.state.enabled or self.statusword & t.FAILED:
            raise self.context.error(f"homing failed ({self.state.fault or self.state.state})")

    async def start_move(self, position: float, speed: float) -> None:
        """Starts a profile to the goal immediately."""
        self._stream.stop()
        await self._set_mode(t.PROFILE_POSITION)
        await self.objects.write(0x6081, 0, abs(self.units.to_velocity(speed)))
        await self._new_setpoint(position)

    async def start_halt(self) -> None:
        """Sets the halt bit, in any mode: the drive brakes as its halt option code (0x605D) defines."""
        self._stream.stop()
        if self.state.enabled:
            await self._control(t.ENABLE | t.HALT)

    async def end_halt(self) -> None:
        """Enters a mode without motion before it clears the halt bit.

        Otherwise a drive would continue to its old goal.
        """
        if not self.state.enabled:
            return
        if self.pdo_configuration.data.can_send(t.TO_VELOCITY):
            await self.objects.write(0x60FF, 0, 0)
            await self._set_mode(t.PROFILE_VELOCITY)
        elif self.state.position is not None:
            await self._set_mode(t.PROFILE_POSITION)
            await self._new_setpoint(self.state.position, t.ENABLE | t.HALT)
        await self._control(t.ENABLE)

    async def set_position(self, position: float) -> None:
        """Sets a new goal of the profile, or with `cyclic` a stream towards it within the speed limit."""
        speed = self.limit("speed")
        assert speed is not None, "checked by the axis"
        if not self.binding.option("cyclic"):
            await self.start_move(position, speed)
            return
        start = self._commanded if self._mode == t.CYCLIC_POSITION else self.state.position
        if start is None:
            raise self.context.error("its position is unknown")
        await self._set_mode(t.CYCLIC_POSITION, (0x607A, self.units.to_counts(start)))
        self._commanded = start
        step = speed * self.binding.option("period")
        await self._start_stream(lambda: self._approach(position, step))

    def _approach(self, goal: float, step: float) -> Frame:
        """The next frame on the way to a goal."""
        assert self._commanded is not None
        self._commanded += max(-step, min(step, goal - self._commanded))
        return self._frame(t.TO_POSITION, self.units.to_counts(self._commanded))

    async def set_velocity(self, velocity: float) -> None:
        """Sets a target velocity, or with `cyclic` a stream of it."""
        await self._set_target(
            self.units.to_velocity(velocity),
            0x60FF,
            t.TO_VELOCITY,
            t.PROFILE_VELOCITY,
            t.CYCLIC_VELOCITY,
        )

    async def set_torque(self, torque: float) -> None:
        """Sets a target torque, or with `cyclic` a stream of it."""
        if not self.units.rated_torque:
            raise self.context.error(
                "setTorque requires 'rated_torque' in its binding: the drive does not report it"
            )
        await self._set_target(
            self.units.to_torque(torque), 0x6071, t.TO_TORQUE, t.PROFILE_TORQUE, t.CYCLIC_TORQUE
        )

    async def _set_target(self, value: int, index: int, code: int, profile: int, cyclic: int) -> None:
        # Report a value that does not fit before the mode changes; build the frame when it is sent, since it
        # may contain mode and control word.
        self._frame(code, value)
        if self.binding.option("cyclic"):
            await self._set_mode(cyclic, (index, value))
            await self._start_stream(lambda: self._frame(code, value))
            return
        self._stream.stop()
        await self._set_mode(profile, (index, value))
        await self.bus.send(self._frame(code, value))

    async def _start_stream(self, frame: Callable[[], Frame]) -> None:
        """Sends a frame now and every period until the setpoint's time-to-live is over."""
        self._stream.stop()
        await self.bus.send(frame())
        period: float = self.binding.option("period")
        self._stream.start(period, lambda: self.bus.post(frame()), duration=self.binding.ttl)

    # -- safe states ------------------------------------------------------------------------------------

    async def command_safe(self, state: str) -> None:
        """Commands a quick stop, or voltage off. Uses SDO if process data are not running."""
        self._stream.stop()
        controlword = t.DISABLE_VOLTAGE if state == "torque_off" else t.QUICK_STOP
        if self.pdo_configuration.data.can_send(t.CONTROL):
            await self._control(controlword)
        if not self.configured or self.pdo_configuration.by_changes:
            await self.objects.write_raw(0x6040, 0, struct.pack("<H", controlword))
            await self.read_state()

    def is_safe(self, state: str, is_still: bool) -> bool:
        """Whether the status word shows the safe state; a drive that is off cannot hold and need not."""
        if state == "torque_off":
            return self.state.state in t.IDLE
        return is_still and (self.state.state in t.IDLE or self.state.state == "quick stop active")

    # -- parts ------------------------------------------------------------------------------------------

    async def _control(self, controlword: int) -> None:
        await self.bus.send(self._frame(t.CONTROL, controlword))

    def _frame(self, entry: int, value: int) -> Frame:
        """Process data to the drive. Raises DeviceError when a value does not fit, or has no PDO."""
        if not self.pdo_configuration.data.can_send(entry):
            raise self.context.error(f"the drive does not {t.OPTIONAL.get(entry, 'take commands yet')}")
        try:
            return Frame(*self.pdo_configuration.data.frame(entry, value))
        except struct.error:
            raise self.context.error(
                f"{value} is out of the drive's range; check 'counts' and 'gear'"
            ) from None

    async def _set_mode(self, mode: int, target: tuple[int, int] | None = None) -> None:
        """Sets a mode of operation and confirms it. `target` is written first: an old one must not take
        effect.
        """
        if self._mode == mode:
            return
        if self.modes and not self.modes & 1 << (mode - 1):
            raise self.context.error(f"the drive has no mode {t.MODES[mode]}")
        self._mode = 0
        if target is not None:
            await self.objects.write(target[0], 0, target[1])
        await self.objects.write_raw(0x6060, 0, bytes([mode]))
        end = self.context.clock.monotonic() + STEP_TIMEOUT
        while await self.objects.read(0x6061) != mode:
            if self.context.clock.monotonic() > end:
                raise self.context.error(f"it did not enter the mode {t.MODES[mode]}")
        self._mode = mode

    async def _new_setpoint(self, position: float, controlword: int = t.ENABLE) -> None:
        """The handshake of profile position mode: set, acknowledged, cleared; with `controlword`.

        The goal is sent by SDO: as process data the control word, whose id has priority, could overtake it.
        """
        await self.objects.write(0x607A, 0, self.units.to_counts(position))
        await self._control(controlword)
        await self.expect(
            lambda: not self.statusword & t.ACKNOWLEDGED, ACCEPT_TIMEOUT, "it holds an old position goal"
        )
        await self._control(controlword | t.NEW_SETPOINT | t.AT_ONCE)
        await self.expect(
            lambda: bool(self.statusword & t.ACKNOWLEDGED), ACCEPT_TIMEOUT, "it did not accept the position"
        )
        await self._control(controlword)
