"""Axes of an ODrive by CANSimple, which has no answers: effects are observed in heartbeats and estimates."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping

from lfield.driver import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.protocols import odrive_tables as t
from lfield_can.protocols.axis_protocol import AxisProtocol, ProtocolContext
from lfield_can.protocols.id_conflict import WITHIN, Alternation

#: Seconds for a change of state, and for homing.
STEP_TIMEOUT, HOMING_TIMEOUT = 1.0, 120.0
#: Seconds for the first estimates.
FIRST_TIMEOUT = 1.0


class Odrive(AxisProtocol):
    """One axis.

    No watchdog: that of an ODrive is in its configuration, at an address that depends on the firmware, and
    CANSimple can neither set nor read it.
    """

    def __init__(self, context: ProtocolContext) -> None:
        super().__init__(context)
        self._axis_state: int | None = None
        self._errors = 0
        self._alternation = Alternation()
        self._mode: tuple[int, int] | None = None
        #: Whether the axis was commanded to hold its position.
        self._is_holding = False
        #: Whether homing was requested and may still run: its heartbeat may not show it yet.
        self._homing_requested = False

    # -- messages of the device -------------------------------------------------------------------------

    def ids(self) -> frozenset[int]:
        """The ids of frames from the axis, without those of frames to it."""
        return frozenset(self.node << 5 | command for command in t.TELEMETRY)

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """Handles a frame of the axis."""
        command = frame.id & 0x1F
        try:
            # Newer firmware appends to frames.
            first, second = t.LAYOUTS[command].unpack_from(frame.data)
        except struct.error:
            return None
        if command == t.HEARTBEAT:
            return self._on_heartbeat(first, second)
        if command == t.ERROR:
            self._errors = first
            return self._state_telemetry()
        if not (math.isfinite(first) and math.isfinite(second)):
            return None
        return self._on_numbers(command, first, second)

    def _on_heartbeat(self, errors: int, axis_state: int) -> dict[str, object]:
        self._errors, self._axis_state = errors, axis_state
        if axis_state != t.CLOSED_LOOP:
            self._mode, self._is_holding = None, False
        return self._state_telemetry()

    def _state_telemetry(self) -> dict[str, object]:
        state, axis_state = self.state, self._axis_state
        if axis_state is not None:
            state.state = t.STATES.get(axis_state, f"state {axis_state}")
        state.fault = t.error_text(self._errors)
        state.enabled = axis_state == t.CLOSED_LOOP and not self._errors
        return {
            "state": state.state,
            "fault": state.fault,
            "enabled": state.enabled,
            "referenced": state.referenced,
        }

    def _on_numbers(self, command: int, first: float, second: float) -> dict[str, object]:
        if command == t.ESTIMATES:
            self._check_second_axis(first, second)
            self.state.position, self.state.velocity = first / self.turns, second / self.turns
            return {"position": self.state.position, "velocity": self.state.velocity}
        if command == t.IQ:
            return {"current": second}
        if command == t.TEMPERATURE:
            return {"temperature": first}
        if command == t.BUS_VOLTAGE:
            return {"voltage": first}
        return {"torque": second * self.turns * math.tau}

    def _check_second_axis(self, position: float, velocity: float) -> None:
        """Checks whether estimates of two axes arrive under this id."""
        now = self.context.clock.monotonic()
        self._alternation.on_position(position, velocity, now)
        if self._alternation.is_proved(now):
            self.conflict = (
                f"two axes have node id {self.node}: its position alternates between two values; give each "
                "its own id"
            )
        elif self.conflict and now - self._alternation.last_return > WITHIN:
            self.conflict = ""

    def on_silence(self) -> None:
        """Discards the state of an axis that has not responded for too long."""
        super().on_silence()
        self._axis_state = self._mode = None
        self._is_holding = False
        self.state.state = "silent"

    # -- setting up -------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Checks the 6-bit node id, and limits that are only valid together."""
        if self.node > 63:
            raise self.context.error(f"an ODrive's node id is 0 to 63, not {self.node}")
        if "current" in self.binding.limits and "speed" not in self.binding.limits:
            raise self.context.error("an ODrive supports the limit 'current' only together with 'speed'")

    async def setup(self) -> str:
        """Waits for state and position; writes the limits of the axis."""
        await self.expect(
            lambda: self._axis_state is not None and self.state.position is not None,
            FIRST_TIMEOUT,
            "it sent no heartbeat or no encoder estimates",
        )
        if self.conflict:
            raise self.context.error(self.conflict)
        speed, current = self.limit("speed"), self.limit("current")
        if speed is not None and current is not None:
            await self._command(t.SET_LIMITS, abs(speed * self.turns), current)
        if (acceleration := self.limit("acceleration")) is not None:
            turns = abs(acceleration * self.turns)
            await self._command(t.SET_TRAVEL_ACCELERATION, turns, turns)
        return f"ODrive axis, node {self.node}, {self.state.state}"

    # -- instructions -----------------------------------------------------------------------------------

    async def enable(self) -> None:
        """Enters closed loop, at a velocity of 0."""
        if self.state.fault:
            raise self.context.error(f"enable refused: {self.state.fault}; resetFault() clears it")
        if self.state.enabled:
            return
        await self._command(t.SET_TORQUE, 0.0)
        await self._command(t.SET_VELOCITY, 0.0, 0.0)
        await self._set_mode(t.VELOCITY, t.DIRECT)
        await self._enter(t.CLOSED_LOOP, lambda: self.state.enabled or bool(self.state.fault))
        if self.state.fault:
            raise self.context.error(f"enable failed: {self.state.fault}")

    async def disable(self) -> None:
        """Enters idle."""
        await self._enter(t.IDLE, lambda: self._axis_state == t.IDLE)

    async def reset_fault(self) -> None:
        """Clears the errors of the axis."""
        await self._command(t.CLEAR_ERRORS, 0)
        await self.expect(lambda: not self._errors, STEP_TIMEOUT, "its errors were not cleared")

    async def home(self) -> None:
        """Runs the homing sequence of the axis, which ends in idle or closed loop."""
        self._homing_requested = True
        try:
            await self._enter(t.HOMING, lambda: self._axis_state == t.HOMING)
            await self.expect(lambda: self._axis_state != t.HOMING, HOMING_TIMEOUT, "homing did not end")
        except DeviceError:
            self._homing_requested = False
            raise
        self._homing_requested = False
        if self._errors or self._axis_state not in (t.IDLE, t.CLOSED_LOOP):
            raise self.context.error(f"homing failed ({self.state.fault or self.state.state})")
        self.state.referenced = True

    async def start_move(self, position: float, speed: float) -> None:
        """Starts a motion by the trapezoidal profile of the axis."""
        self._is_holding = False
        await self._command(t.SET_TRAVEL_SPEED, abs(speed * self.turns))
        # A profile starts when the goal arrives, so the mode must be set before.
        if self._mode != (t.POSITION, t.TRAVEL):
            await self._hold_here(t.TRAVEL)
        await self._command(t.SET_POSITION, position * self.turns, 0, 0)

    async def start_halt(self) -> None:
        """Commands velocity 0, also during homing; repeated, since an earlier command may have been lost."""
        if self._is_homing or self._axis_state == t.CLOSED_LOOP:
            await self._brake()

    async def set_position(self, position: float) -> None:
        """Sets a position as a move at the speed limit."""
        speed = self.limit("speed")
        assert speed is not None, "checked by the axis"
        await self.start_move(position, speed)

    async def set_velocity(self, velocity: float) -> None:
        """Sets a velocity; the value is sent before the mode, in which an old one must not take effect."""
        self._is_holding = False
        await self._command(t.SET_VELOCITY, velocity * self.turns, 0.0)
        await self._set_mode(t.VELOCITY, t.DIRECT)

    async def set_torque(self, torque: float) -> None:
        """Sets a torque of the motor, before the gear."""
        self._is_holding = False
        await self._command(t.SET_TORQUE, torque / (self.turns * math.tau))
        await self._set_mode(t.TORQUE, t.DIRECT)

    # -- safe states ------------------------------------------------------------------------------------

    async def command_safe(self, state: str) -> None:
        """Commands off at once, or velocity 0; torque_hold then holds the position where the axis stopped."""
        if state == "torque_off":
            await self._command(t.SET_STATE, t.IDLE)
            return
        if state == "torque_hold" and self._is_standing() and not self._is_homing:
            # Held at its present position, not at an earlier one.
            self._mode = None
            await self._hold_here(t.DIRECT)
            self._is_holding = True
        else:
            await self._brake()

    def is_safe(self, state: str, is_still: bool) -> bool:
        """An idle axis cannot hold and need not."""
        is_idle = self._axis_state == t.IDLE
        if state == "torque_off":
            return is_idle
        is_holding = self._is_holding or state == "brake"
        return is_still and (is_idle or (self._axis_state == t.CLOSED_LOOP and is_holding))

    def _is_standing(self) -> bool:
        velocity = self.state.velocity
        return velocity is not None and abs(velocity) <= self.binding.option("standstill")

    # -- parts ------------------------------------------------------------------------------------------

    @property
    def _is_homing(self) -> bool:
        """Whether the axis is homing and ignores velocities."""
        return self._homing_requested or self._axis_state == t.HOMING

    async def _brake(self) -> None:
        """Commands velocity 0, in closed loop after homing.

        All commands are repeated: they may have been lost, or another master may have interfered.
        """
        self._mode = None
        await self.set_velocity(0.0)
        if self._is_homing:
            self._homing_requested = False
            await self._command(t.SET_STATE, t.CLOSED_LOOP)

    async def _hold_here(self, input_mode: int) -> None:
        """Enters position mode at the present position."""
        if self.state.position is None:
            raise self.context.error("its position is unknown")
        await self._command(t.SET_POSITION, self.state.position * self.turns, 0, 0)
        await self._set_mode(t.POSITION, input_mode)

    async def _set_mode(self, control: int, inputs: int) -> None:
        if self._mode != (control, inputs):
            await self._command(t.SET_MODE, control, inputs)
            self._mode = (control, inputs)

    async def _enter(self, axis_state: int, condition: Callable[[], bool]) -> None:
        await self._command(t.SET_STATE, axis_state)
        await self.expect(condition, STEP_TIMEOUT, f"it did not enter '{t.STATES[axis_state]}'")

    async def _command(self, command: int, *values: float) -> None:
        """Sends a frame to the axis. Raises DeviceError when a value does not fit."""
        try:
            data = t.LAYOUTS[command].pack(*values)
        except (struct.error, OverflowError):
            raise self.context.error(f"{values[0]} is out of an ODrive's range; check 'gear'") from None
        await self.bus.send(Frame(self.node << 5 | command, data))
