"""Axes of CiA 402 drives on CANopen. Objects and bits are in cia402_tables, setting up is in cia402_setup."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from lfield_can.frames import Frame
from lfield_can.protocols import cia402_setup as setting
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.axis_protocol import AxisProtocol, Wiring
from lfield_can.protocols.canopen_node import CanopenNode
from lfield_can.protocols.cia402_units import Units
from lfield_can.protocols.repeating import Repeating

#: Seconds for one step of the state machine, for a new setpoint to be taken, and for a homing.
STEP, TAKEN, HOMED = 1.0, 0.5, 120.0
#: Seconds for the bits of an earlier homing to go.
STALE_BITS = 0.2
#: Seconds without process data after which position and velocity are not known any more.
OLD = 0.3


class Cia402(AxisProtocol):
    """One drive."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        option = self.binding.option
        if self.node == 0:
            raise wiring.error("a CANopen node id is 1 to 127; node 0 is all of them")
        if option("counts") == 0:
            raise wiring.error(
                "cia402 needs 'counts' in its binding: position counts in one turn of the motor"
            )
        self._units = Units(
            self.turns,
            option("counts"),
            option("velocity_unit"),
            option("rated_torque"),
            option("rated_current"),
        )
        self._objects = CanopenNode(self.binding.field, self.node, self.bus.post)
        self._beats = Repeating(wiring.clock)
        self._stream = Repeating(wiring.clock)
        self._handlers: Mapping[int, Callable[..., Mapping[str, object] | None]] = {
            t.HEARTBEAT: self._on_heartbeat,
            t.STATUS: self._on_status,
            t.MOTION: self._on_motion,
            t.FORCE: self._on_force,
            t.EMERGENCY: self._on_emergency,
        }
        self._longest = 0.0
        self._nmt: int | None = None
        self._statusword = self._error_code = self._register = 0
        self._mapped: frozenset[int] = frozenset()
        self._motion_at = -OLD
        self._mode = self._modes = 0
        self._configured = False
        self._commanded: float | None = None
        self._has_voltage = True

    # -- what the drive says ----------------------------------------------------------------------------

    def ids(self) -> frozenset[int]:
        """Everything that a node of this id sends."""
        codes = (t.EMERGENCY, t.STATUS, t.MOTION, t.FORCE, t.SDO_ANSWER, t.HEARTBEAT)
        return frozenset(code + self.node for code in codes)

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """One frame of the node."""
        code = frame.id - self.node
        if code == t.SDO_ANSWER:
            self._objects.on_answer(frame.data)
            return {}
        if code in t.TRANSMITTED and code not in self._mapped:
            return {}  # it is not ours yet: laid out as somebody else has set it up
        try:
            values = t.LAYOUTS[code].unpack(frame.data)
        except struct.error:
            return None
        return self._handlers[code](*values)

    def _on_heartbeat(self, value: int) -> dict[str, object]:
        self._nmt = value & 0x7F
        if self._nmt == t.BOOTED:
            self.state.referenced = False
        if self._configured and self._nmt != t.OPERATIONAL:
            self._configured, self.needs_setup = False, True
            self._forget("not operational")
        if self.wiring.clock.monotonic() - self._motion_at > OLD:
            self.state.position = self.state.velocity = None
        return {}

    def _on_status(self, statusword: int) -> dict[str, object] | None:
        state = t.state_of(statusword)
        if not state:
            return None
        self._statusword, self.state.state = statusword, state
        self.state.enabled = state == "operation enabled"
        if not state.startswith("fault"):
            self._error_code = self._register = 0
        words = t.error_words(self._error_code, self._register) or "fault"
        self.state.fault = words if state.startswith("fault") else ""
        return self._told()

    def _on_motion(self, position: int, velocity: int) -> dict[str, object]:
        self._motion_at = self.wiring.clock.monotonic()
        self.state.position, self.state.velocity = (
            self._units.position(position),
            self._units.velocity(velocity),
        )
        return {"position": self.state.position, "velocity": self.state.velocity}

    def _on_force(self, torque: int, current: int) -> dict[str, object]:
        values: dict[str, object] = {}
        if self._units.rated_torque:
            values["torque"] = self._units.torque(torque)
        if self._units.rated_current:
            values["current"] = current / 1000.0 * self._units.rated_current
        return values

    def _on_emergency(self, code: int, register: int) -> dict[str, object]:
        self._error_code, self._register = code, register
        if code:
            self.wiring.note(f"emergency: {t.error_words(code, register)}")
        return {}

    def _told(self) -> dict[str, object]:
        state = self.state
        return {
            "state": state.state,
            "fault": state.fault,
            "enabled": state.enabled,
            "referenced": state.referenced,
        }

    def _forget(self, state: str) -> None:
        """What was known is not true any more."""
        self._stream.stop()
        self._mode, self._commanded = 0, None
        self.state.state, self.state.enabled = state, False
        self.state.position = self.state.velocity = None

    def silent(self) -> None:
        """Not heard for too long."""
        self._forget("silent")

    # -- setting up -------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Read the EDS file."""
        if path := self.binding.option("eds"):
            self._objects.load(path)

    def call(self) -> None:
        """Ask for the device type: a node need not have heartbeats before it is set up."""
        self._objects.ping()

    async def setup(self) -> str:
        """Identify it, set everything up, and start its process data."""
        node, note, error = self._objects, self.wiring.note, self.wiring.error
        self._configured = False
        identity = await setting.identify(node, error)
        await setting.set_heartbeat(node)
        self._mapped = await setting.map_process_data(node, self.node, note)
        await setting.read_ratings(node, self._units)
        await setting.set_limits(node, self.binding, self._units, note)
        await setting.set_quick_stop(node, self.binding.safe_state, error)
        self._modes = await setting.optional(node, 0x6502) or 0
        if self._longest:
            await self.set_watchdog(self._longest)
        await self._start()
        self._configured, self.needs_setup = True, False
        return f"CiA 402 drive, node {self.node}, {identity}"

    async def _start(self) -> None:
        """Operational, and telling its state and motion."""
        self._nmt = None
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_START, self.node])))
        await self.expect(lambda: self._nmt == t.OPERATIONAL, STEP, "it did not become operational")
        self.state.position = None
        await self.expect(
            lambda: self.state.position is not None and bool(self.state.state),
            STEP,
            "it sent no process data",
        )

    async def set_watchdog(self, longest: float) -> float | None:
        """Its consumer heartbeat, which our own heartbeats feed from now on."""
        self._longest = longest
        master: int = self.binding.option("master")
        beat = Frame(t.HEARTBEAT + master, bytes([t.OPERATIONAL]))
        self._beats.start(longest / 4.0, lambda: self.bus.post(beat))
        note, safe_state = self.wiring.note, self.binding.safe_state
        seconds = await setting.set_watchdog(self._objects, master, longest, safe_state, note)
        # The drive begins to watch with the first heartbeat that it hears from now on (CiA 301, 7.2.8.2.2).
        await self.bus.send(beat)
        return seconds

    async def poll(self) -> Mapping[str, object]:
        """The supply voltage, and the cause of a fault that was not told."""
        values: dict[str, object] = {}
        if self.state.fault and not self._error_code:
            self._error_code = await setting.optional(self._objects, 0x603F) or 0
            self._register = await setting.optional(self._objects, 0x1001) or 0
            values.update(self._on_status(self._statusword) or {})
        if self._has_voltage:
            millivolts = await setting.optional(self._objects, 0x6079)
            self._has_voltage = millivolts is not None
            if millivolts is not None:
                values["voltage"] = millivolts / 1000.0
        return values

    def quiet(self, on: bool) -> None:
        """Our heartbeats feed its watchdog."""
        if on:
            self._stream.stop()
            self._beats.stop()
        elif self._longest:
            self._beats.again()

    def close(self) -> None:
        """No heartbeats, no worker."""
        self._stream.stop()
        self._beats.stop()
        self._objects.close()

    # -- instructions -----------------------------------------------------------------------------------

    async def enable(self) -> None:
        """Step by step up the state machine, without a target that is left from before."""
        await self._objects.write(0x60FF, 0, 0)
        await self._set_mode(t.PROFILE_POSITION)
        for _ in range(len(t.STATES)):
            state = self.state.state
            if self.state.enabled:
                return
            if self.state.fault:
                raise self.wiring.error(f"enable refused: {self.state.fault}; resetFault() clears it")
            await self._control(t.UPWARDS.get(state, t.DISABLE_VOLTAGE))
            await self._leave(state)
        raise self.wiring.error(f"enable failed: it stays in '{self.state.state}'")

    async def _leave(self, state: str) -> None:
        await self.expect(lambda: self.state.state != state, STEP, f"it did not leave '{state}'")

    async def disable(self) -> None:
        """Voltage off."""
        self._stream.stop()
        await self._control(t.DISABLE_VOLTAGE)
        await self.expect(lambda: self.state.state in t.IDLE, STEP, "its torque did not go off")

    async def reset_fault(self) -> None:
        """A rising edge of the reset bit."""
        await self._control(t.DISABLE_VOLTAGE)
        await self._control(t.FAULT_RESET)
        await self.expect(lambda: not self.state.fault, STEP, "the fault did not go away")
        await self._control(t.DISABLE_VOLTAGE)

    async def home(self) -> None:
        """By the method of the binding."""
        method: int = self.binding.option("homing_method")
        if method == 0:
            raise self.wiring.error(
                "home needs 'homing_method' in its binding: the number of the method in the drive's manual"
            )
        self._stream.stop()
        await self._objects.write(0x6098, 0, method)
        if speed := self.binding.option("homing_speed"):
            for subindex in (1, 2):
                await self._objects.write(0x6099, subindex, abs(self._units.to_velocity(speed)))
        await self._set_mode(t.HOMING)
        try:
            await self._control(t.ENABLE | t.START_HOMING)
            await self._homed()
        finally:
            self.bus.post(self._frame(t.CONTROL, t.ENABLE))
        self.state.referenced = True

    async def _homed(self) -> None:
        """Wait for the end. The bits of an earlier homing may stand for a moment."""
        await self.wiring.news.seen(lambda: not self._statusword & t.ACKNOWLEDGED, STALE_BITS)
        done = t.ACKNOWLEDGED | t.TARGET_REACHED

        def over() -> bool:
            bits = self._statusword
            return bits & done == done or bool(bits & t.FAILED) or not self.state.enabled

        await self.expect(over, HOMED, "homing did not end")
        if not self.state.enabled or self._statusword & t.FAILED:
            raise self.wiring.error(f"homing failed ({self.state.fault or self.state.state})")

    async def begin_move(self, position: float, speed: float) -> None:
        """A profile to the goal, at once."""
        self._stream.stop()
        await self._set_mode(t.PROFILE_POSITION)
        await self._new_setpoint(position, speed)

    async def set_position(self, position: float) -> None:
        """A new goal of the profile, or with `cyclic` a stream towards it within the speed limit."""
        speed = self.limit("speed")
        assert speed is not None, "the axis has refused it without"
        if not self.binding.option("cyclic"):
            await self.begin_move(position, speed)
            return
        at = self._commanded if self._mode == t.CYCLIC_POSITION else self.state.position
        if at is None:
            raise self.wiring.error("its position is not known")
        await self._set_mode(t.CYCLIC_POSITION, (0x607A, self._units.to_counts(at)))
        self._commanded = at
        step = speed * self.binding.option("period")
        await self._begin_stream(lambda: self._approach(position, step))

    def _approach(self, goal: float, step: float) -> Frame:
        """The next frame on the way to a goal."""
        assert self._commanded is not None
        self._commanded += max(-step, min(step, goal - self._commanded))
        return self._frame(t.POSITION, self._units.to_counts(self._commanded))

    async def set_velocity(self, velocity: float) -> None:
        """One target velocity, or with `cyclic` a stream of it."""
        await self._set_target(
            velocity,
            self._units.to_velocity(velocity),
            0x60FF,
            t.VELOCITY,
            t.PROFILE_VELOCITY,
            t.CYCLIC_VELOCITY,
        )

    async def set_torque(self, torque: float) -> None:
        """One target torque, or with `cyclic` a stream of it."""
        if not self._units.rated_torque:
            raise self.wiring.error(
                "setTorque needs 'rated_torque' in its binding: the drive does not tell it"
            )
        await self._set_target(
            torque, self._units.to_torque(torque), 0x6071, t.TORQUE, t.PROFILE_TORQUE, t.CYCLIC_TORQUE
        )

    async def _set_target(
        self, what: float, value: int, index: int, code: int, profile: int, cyclic: int
    ) -> None:
        frame = self._frame(code, value)
        if self.binding.option("cyclic"):
            await self._set_mode(cyclic, (index, value))
            await self._begin_stream(lambda: frame)
            return
        self._stream.stop()
        await self._set_mode(profile, (index, value))
        await self.bus.send(frame)

    async def _begin_stream(self, frame: Callable[[], Frame]) -> None:
        """Now, and then every period until the setpoint's time-to-live is over."""
        self._stream.stop()
        await self.bus.send(frame())
        period: float = self.binding.option("period")
        self._stream.start(period, lambda: self.bus.post(frame()), lasts=self.binding.ttl)

    # -- safe states ------------------------------------------------------------------------------------

    async def command_safe(self, state: str) -> None:
        """Quick stop, or voltage off. Where process data do not run, by SDO."""
        self._stream.stop()
        word = t.DISABLE_VOLTAGE if state == "torque_off" else t.QUICK_STOP
        await self._control(word)
        if not self._configured:
            await self._objects.write_raw(0x6040, 0, struct.pack("<H", word))
            self._on_status(await self._objects.read(0x6041))
            self.state.velocity = self._units.velocity(await self._objects.read(0x606C))

    def is_safe(self, state: str, still: bool) -> bool:
        """By the status word; a drive that is off cannot hold, and need not."""
        if state == "torque_off":
            return self.state.state in t.IDLE
        return still and (self.state.state in t.IDLE or self.state.state == "quick stop active")

    # -- parts ------------------------------------------------------------------------------------------

    async def _control(self, word: int) -> None:
        await self.bus.send(self._frame(t.CONTROL, word))

    def _frame(self, code: int, *values: int) -> Frame:
        """Process data to the drive. Raises DeviceError when a value does not fit."""
        try:
            return Frame(code + self.node, t.LAYOUTS[code].pack(*values))
        except struct.error:
            raise self.wiring.error(
                f"{values[0]} is more than the drive can be told; check 'counts' and 'gear'"
            ) from None

    async def _set_mode(self, mode: int, target: tuple[int, int] | None = None) -> None:
        """A mode of operation, seen to be in effect. `target` is written first: an old one must not act."""
        if self._mode == mode:
            return
        if self._modes and not self._modes & 1 << (mode - 1):
            raise self.wiring.error(f"the drive has no mode {t.MODES[mode]}")
        self._mode = 0
        if target is not None:
            await self._objects.write(target[0], 0, target[1])
        await self._objects.write_raw(0x6060, 0, bytes([mode]))
        end = self.wiring.clock.monotonic() + STEP
        while await self._objects.read(0x6061) != mode:
            if self.wiring.clock.monotonic() > end:
                raise self.wiring.error(f"it did not go to the mode {t.MODES[mode]}")
        self._mode = mode

    async def _new_setpoint(self, position: float, speed: float) -> None:
        """The handshake of the profile position mode: set, acknowledged, taken back.

        The goal goes by SDO: as process data it could be overtaken by the control word, whose id comes first.
        """
        await self._objects.write(0x6081, 0, abs(self._units.to_velocity(speed)))
        await self._objects.write(0x607A, 0, self._units.to_counts(position))
        await self._control(t.ENABLE)
        await self.expect(
            lambda: not self._statusword & t.ACKNOWLEDGED, TAKEN, "it holds an old position goal"
        )
        await self._control(t.ENABLE | t.NEW_SETPOINT | t.AT_ONCE)
        await self.expect(
            lambda: bool(self._statusword & t.ACKNOWLEDGED), TAKEN, "it did not take the position"
        )
        await self._control(t.ENABLE)
