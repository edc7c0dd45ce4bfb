"""Motion of CiA 402 drives: the state machine, modes of operation, setpoints, homing and safe states."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.axis_protocol import Wiring
from lfield_can.protocols.cia402_node import STEP, Cia402Node
from lfield_can.timing import Repeating

#: Seconds for a new setpoint to be taken, and for a homing.
TAKEN, HOMED = 0.5, 120.0
#: Seconds for the bits of an earlier homing to go.
STALE_BITS = 0.2


class Cia402(Cia402Node):
    """One drive."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        self._stream = Repeating(wiring.clock)
        # The mode of operation that is in effect, 0 when it is not known, and where a stream has led.
        self._mode = 0
        self._commanded: float | None = None

    def forget(self, state: str) -> None:
        """What was known is not true any more."""
        self._stream.stop()
        self._mode, self._commanded = 0, None
        super().forget(state)

    def on_status(self, statusword: int) -> dict[str, object] | None:
        """A stream may carry the control word: it must not lead a drive back that has stopped by itself."""
        told = super().on_status(statusword)
        if not self.state.enabled:
            self._stream.stop()
        return told

    def quiet(self, on: bool) -> None:
        """A stream feeds its watchdog too."""
        if on:
            self._stream.stop()
        super().quiet(on)

    def close(self) -> None:
        """No stream either."""
        self._stream.stop()
        super().close()

    # -- instructions -----------------------------------------------------------------------------------

    async def enable(self) -> None:
        """Step by step up the state machine, without a target that is left from before."""
        if self.agreed.data.takes(t.TO_VELOCITY):
            await self.objects.write(0x60FF, 0, 0)
        await self._take_up()
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

    async def _take_up(self) -> None:
        """Out of a quick stop that holds by transition 16: without voltage a load would fall.

        In the velocity mode, whose target is 0, since no goal from before may act. Not every drive can.
        """
        if self.state.state != "quick stop active" or not self.agreed.data.takes(t.TO_VELOCITY):
            return
        with suppress(DeviceError):
            await self._set_mode(t.PROFILE_VELOCITY)
            await self._control(t.ENABLE)
            await self.wiring.news.seen(lambda: self.state.state != "quick stop active", TAKEN)
        if self.state.state == "quick stop active":
            self.wiring.note("it cannot be enabled out of a quick stop, and is without torque for a moment")

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
        await self.objects.write(0x6098, 0, method)
        if speed := self.binding.option("homing_speed"):
            for subindex in (1, 2):
                await self.objects.write(0x6099, subindex, abs(self.units.to_velocity(speed)))
        await self._set_mode(t.HOMING)
        try:
            await self._control(t.ENABLE | t.START_HOMING)
            await self._homed()
        finally:
            self.bus.post(self._frame(t.CONTROL, t.ENABLE))
        self.state.referenced = True

    async def _homed(self) -> None:
        """Wait for the end. The bits of an earlier homing may stand for a moment."""
        await self.wiring.news.seen(lambda: not self.statusword & t.ACKNOWLEDGED, STALE_BITS)
        done = t.ACKNOWLEDGED | t.TARGET_REACHED

        def over() -> bool:
            bits = self.statusword
            return bits & done == done or bool(bits & t.FAILED) or not self.state.enabled

        await self.expect(over, HOMED, "homing did not end")
        if not self.state.enabled or self.statusword & t.FAILED:
            raise self.wiring.error(f"homing failed ({self.state.fault or self.state.state})")

    async def begin_move(self, position: float, speed: float) -> None:
        """A profile to the goal, at once."""
        self._stream.stop()
        await self._set_mode(t.PROFILE_POSITION)
        await self.objects.write(0x6081, 0, abs(self.units.to_velocity(speed)))
        await self._new_setpoint(position)

    async def begin_halt(self) -> None:
        """The halt bit, in whatever mode it is: it brakes as its halt option code (0x605D) says."""
        self._stream.stop()
        if self.state.enabled:
            await self._control(t.ENABLE | t.HALT)

    async def end_halt(self) -> None:
        """Into a mode in which nothing leads it away, and only then without the halt bit.

        Without it a drive would go on to its old goal.
        """
        if not self.state.enabled:
            return
        if self.agreed.data.takes(t.TO_VELOCITY):
            await self.objects.write(0x60FF, 0, 0)
            await self._set_mode(t.PROFILE_VELOCITY)
        elif self.state.position is not None:
            await self._set_mode(t.PROFILE_POSITION)
            await self._new_setpoint(self.state.position, t.ENABLE | t.HALT)
        await self._control(t.ENABLE)

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
        await self._set_mode(t.CYCLIC_POSITION, (0x607A, self.units.to_counts(at)))
        self._commanded = at
        step = speed * self.binding.option("period")
        await self._begin_stream(lambda: self._approach(position, step))

    def _approach(self, goal: float, step: float) -> Frame:
        """The next frame on the way to a goal."""
        assert self._commanded is not None
        self._commanded += max(-step, min(step, goal - self._commanded))
        return self._frame(t.TO_POSITION, self.units.to_counts(self._commanded))

    async def set_velocity(self, velocity: float) -> None:
        """One target velocity, or with `cyclic` a stream of it."""
        await self._set_target(
            velocity,
            self.units.to_velocity(velocity),
            0x60FF,
            t.TO_VELOCITY,
            t.PROFILE_VELOCITY,
            t.CYCLIC_VELOCITY,
        )

    async def set_torque(self, torque: float) -> None:
        """One target torque, or with `cyclic` a stream of it."""
        if not self.units.rated_torque:
            raise self.wiring.error(
                "setTorque needs 'rated_torque' in its binding: the drive does not tell it"
            )
        await self._set_target(
            torque, self.units.to_torque(torque), 0x6071, t.TO_TORQUE, t.PROFILE_TORQUE, t.CYCLIC_TORQUE
        )

    async def _set_target(
        self, what: float, value: int, index: int, code: int, profile: int, cyclic: int
    ) -> None:
        # What cannot be sent is told before the mode changes; and a frame is made when it goes, since it may
        # carry the mode and the control word too.
        self._frame(code, value)
        if self.binding.option("cyclic"):
            await self._set_mode(cyclic, (index, value))
            await self._begin_stream(lambda: self._frame(code, value))
            return
        self._stream.stop()
        await self._set_mode(profile, (index, value))
        await self.bus.send(self._frame(code, value))

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
        if self.agreed.data.takes(t.CONTROL):
            await self._control(word)
        if not self.configured or self.agreed.by_changes:
            await self.objects.write_raw(0x6040, 0, struct.pack("<H", word))
            await self.ask()

    def is_safe(self, state: str, still: bool) -> bool:
        """By the status word; a drive that is off cannot hold, and need not."""
        if state == "torque_off":
            return self.state.state in t.IDLE
        return still and (self.state.state in t.IDLE or self.state.state == "quick stop active")

    # -- parts ------------------------------------------------------------------------------------------

    async def _control(self, word: int) -> None:
        await self.bus.send(self._frame(t.CONTROL, word))

    def _frame(self, entry: int, value: int) -> Frame:
        """Process data to the drive. Raises DeviceError when a value does not fit, or has nowhere to go."""
        if not self.agreed.data.takes(entry):
            raise self.wiring.error(f"the drive does not {t.OPTIONAL.get(entry, 'take commands yet')}")
        try:
            return Frame(*self.agreed.data.frame(entry, value))
        except struct.error:
            raise self.wiring.error(
                f"{value} is more than the drive can be told; check 'counts' and 'gear'"
            ) from None

    async def _set_mode(self, mode: int, target: tuple[int, int] | None = None) -> None:
        """A mode of operation, seen to be in effect. `target` is written first: an old one must not act."""
        if self._mode == mode:
            return
        if self.modes and not self.modes & 1 << (mode - 1):
            raise self.wiring.error(f"the drive has no mode {t.MODES[mode]}")
        self._mode = 0
        if target is not None:
            await self.objects.write(target[0], 0, target[1])
        await self.objects.write_raw(0x6060, 0, bytes([mode]))
        end = self.wiring.clock.monotonic() + STEP
        while await self.objects.read(0x6061) != mode:
            if self.wiring.clock.monotonic() > end:
                raise self.wiring.error(f"it did not go to the mode {t.MODES[mode]}")
        self._mode = mode

    async def _new_setpoint(self, position: float, word: int = t.ENABLE) -> None:
        """The handshake of the profile position mode: set, acknowledged, taken back; all along with `word`.

        The goal goes by SDO: as process data it could be overtaken by the control word, whose id comes first.
        """
        await self.objects.write(0x607A, 0, self.units.to_counts(position))
        await self._control(word)
        await self.expect(
            lambda: not self.statusword & t.ACKNOWLEDGED, TAKEN, "it holds an old position goal"
        )
        await self._control(word | t.NEW_SETPOINT | t.AT_ONCE)
        await self.expect(
            lambda: bool(self.statusword & t.ACKNOWLEDGED), TAKEN, "it did not take the position"
        )
        await self._control(word)
