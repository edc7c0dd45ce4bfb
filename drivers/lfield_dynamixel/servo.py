"""One servo: its control table in SI units, and operations that need several steps in order."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver import DeviceError
from lfield_dynamixel.bus.error_text import WEAKENING, fault_text, has_alert
from lfield_dynamixel.bus.half_duplex_bus import COMMAND
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.bus.servo_chain import Chain, NoAnswer, Node
from lfield_dynamixel.control_tables import Item, Model, model_number_address, models
from lfield_dynamixel.joints.mounting import Joint

#: Relative rounding tolerance of a limit.
ROUNDED = 1.0 + 1e-9
#: The register of the status return level.
STATUS_RETURN_LEVEL = "status_return_level"
#: Operating modes in which a servo follows positions.
POSITION_MODES = ("position", "extended", "currentPosition")

#: Value of the watchdog register after it has expired: goals are read-only until it is set to 0.
WATCHDOG_FIRED = 255
WATCHDOG_LONGEST = 127

#: Bits of the drive mode register (e-manual, address 10): slave of another servo's cable, which ignores
#: goals; time-based profiles in milliseconds. Bit 0 reverses the direction; bit 3 switches the torque on by
#: any goal.
_SLAVE, _TIME_BASED = 1 << 1, 1 << 2
_LONGEST_PROFILE = 32737

#: The value of a Feetech servo's torque limit register that is its stall torque.
_WHOLE_TORQUE = 1000


class Present(Struct, frozen=True):
    """Measured values: rad, rad/s, A, N m (NaN if unknown for the model), V, °C."""

    counts: int
    position: float
    velocity: float
    current: float
    effort: float
    voltage: float
    temperature: float
    moving: bool
    alert: bool


class Condition(Struct, frozen=True):
    """State that does not change by itself: torque on, hardware errors in words, watchdog in counts.

    `weak`: the torque is on, but reduced (Feetech servos after an error); the joint may sag under its load.
    """

    torque: bool
    faults: str
    watchdog: int
    weak: bool = False


def present(model: Model, status: Status) -> Present:
    """The measured values in an answer to a read of `model.present`."""
    start, data, items = model.present[0], status.data, model.items
    counts = items["present_position"].decode(data, start)
    ampere = math.nan
    if model.current:
        ampere = items["present_current"].decode(data, start) * model.current
    return Present(
        counts=counts,
        position=model.to_angle(counts),
        velocity=items["present_velocity"].decode(data, start) * model.velocity,
        current=ampere,
        effort=ampere * model.torque if model.torque is not None else math.nan,
        voltage=items["present_voltage"].decode(data, start) * model.voltage,
        temperature=items["present_temperature"].decode(data, start),
        moving=bool(items["moving"].decode(data, start)),
        alert=has_alert(model.protocol, status),
    )


def condition(model: Model, status: Status) -> Condition:
    """The condition in an answer to a read of `model.state`."""
    start, items = model.state[0], model.items
    bits = items["hardware_error"].decode(status.data, start) if model.has("hardware_error") else status.error
    watchdog = items["bus_watchdog"].decode(status.data, start) if model.watchdog else 0
    torque = bool(items["torque_enable"].decode(status.data, start))
    weak = torque and model.protocol == 0 and bool(bits & WEAKENING)
    return Condition(torque, fault_text(model.protocol, bits), watchdog, weak)


class Servo:
    """One servo on a chain. Call `open` first; all other methods need its model.

    Angles, speeds and currents are those of its `joint`. `mode` is its operating mode by name, `reach` the
    range of angles (rad) in position mode, `top_speed` its own limit (rad/s). `is_slave`: it follows the
    cable of another servo and ignores goals. `pushing`: it holds something by force, and must continue to
    hold it.
    """

    model: Model

    def __init__(self, chain: Chain, node: Node, joint: Joint | None = None) -> None:
        self.chain, self.node, self.joint = chain, node, joint or Joint(node.number)
        self.mode = "position"
        self.time_based = self.is_slave = False
        self.reach = (-math.inf, math.inf)
        self._limits = (-(1 << 31), 1 << 31)
        self.top_speed = math.inf
        self.pushing = False

    def set_pushing(self, pushing: bool) -> None:
        """Sets whether the servo presses on an object."""
        self.pushing = pushing

    async def open(self, expected: str = "") -> str:
        """Finds the servo and reads its settings; returns its identity. Raises DeviceError, also for another
        model than expected.
        """
        if await self.chain.ping(self.node) is None and await self.chain.ping(self.node) is None:
            raise NoAnswer(self.node.number, "check its power, and the bus, baud rate and protocol")
        number = await self._model_number()
        model = models().get((self.node.protocol, number))
        if model is None:
            model_names = ", ".join(
                sorted(m.name for m in models().values() if m.protocol == self.node.protocol)
            )
            raise self.error(
                f"is of the model number {number}, which is not in the tables (known: {model_names}); "
                "check 'protocol' in its binding"
            )
        if expected not in ("", model.name):
            raise self.error(f"is a {model.name}, but its binding says {expected}")
        self.model, self.top_speed = model, model.fastest * model.velocity
        self.joint = self.joint.fitted(model)
        if conflict := await self.chain.id_conflict(self.node, *model.present):
            raise DeviceError(f"servo {self.node.number}", conflict)
        versions = [name for name in ("firmware_version", "firmware_minor") if model.has(name)]
        firmware = ".".join([str(await self.read_item(name)) for name in versions])
        await self.read_settings()
        return f"{model.name} {self.joint.label} (firmware {firmware}, {self.mode} mode)"

    async def _model_number(self) -> int:
        """Reads the model number; a servo that answers pings only is configured to answer all."""
        start = model_number_address(self.node.protocol)
        try:
            status = await self.chain.read(self.node, start, 2)
        except NoAnswer:
            if self.node.protocol != 2:
                raise
            address, answer_all = models()[2, 1020].items["status_return_level"].address, b"\x02"
            await self.chain.write_unconfirmed(self.node, address, answer_all)
            status = await self.chain.read(self.node, start, 2)
        return int.from_bytes(status.data, "little")

    async def read_settings(self) -> None:
        """Reads the settings that the driver needs: mode, kind of profile, limits of position and speed."""
        modes = self.model.modes
        if not self.keeps_answers and await self.read_item(STATUS_RETURN_LEVEL) < self.model.answers:
            await self.set_return_level(self.model.answers)
        if modes:
            value = await self.read_item("operating_mode")
            # Two modes may have one value: the present one is kept.
            if modes.get(self.mode) != value:
                self.mode = next((name for name, number in modes.items() if number == value), f"mode {value}")
        if self.model.has("drive_mode"):
            drive_mode = await self.read_item("drive_mode")
            self.time_based, self.is_slave = bool(drive_mode & _TIME_BASED), bool(drive_mode & _SLAVE)
            self.top_speed = await self.read_item("velocity_limit") * self.model.velocity
        limits = await self.read_item("min_position_limit"), await self.read_item("max_position_limit")
        # A damaged limit may be beyond the positions of the servo, and no goal.
        low, high = (min(counts, self.model.last) for counts in limits)
        first, second = (self.joint.to_joint(self.model.to_angle(counts)) for counts in (low, high))
        self._limits, self.reach = (low, high), (min(first, second), max(first, second))

    @property
    def keeps_answers(self) -> bool:
        """Whether the status return level is in the EEPROM, as in an AX or a Feetech servo."""
        return self.item(STATUS_RETURN_LEVEL).address < self.model.ram

    async def set_return_level(self, level: int) -> None:
        """Sets the status return level; these writes may be unanswered. Confirmed; raises DeviceError."""
        for name, value in (("lock", 0), (STATUS_RETURN_LEVEL, level), ("lock", 1)):
            if self.model.has(name):
                await self.chain.write_unconfirmed(self.node, *self.write_of(name, value))
        if await self.read_item(STATUS_RETURN_LEVEL) != level:
            raise self.error(f"refuses {level} as its status return level: switch its torque off first")

    # -- the control table ------------------------------------------------------------------------------

    def item(self, name: str) -> Item:
        """The item of a value. Raises DeviceError when the model has none."""
        if not self.model.has(name):
            raise self.error(f"is a {self.model.name}: it has no {name.replace('_', ' ')}")
        return self.model.items[name]

    def write_of(self, name: str, counts: int) -> tuple[int, bytes]:
        """A write of an item: address and bytes. Raises DeviceError for a value that it cannot have."""
        item = self.item(name)
        try:
            return item.address, item.encode(counts)
        except ValueError:
            raise self.error(f"cannot have {counts} counts as its {name.replace('_', ' ')}") from None

    async def read_item(self, name: str, *, urgency: int = COMMAND) -> int:
        """The value of an item, in counts. Raises DeviceError."""
        item = self.item(name)
        return item.decode(
            (await self.chain.read(self.node, item.address, item.size, urgency=urgency)).data, item.address
        )

    async def write_item(self, name: str, counts: int, *, urgency: int = COMMAND) -> None:
        """Writes an item and reads it back. Raises DeviceError."""
        await self.chain.write(self.node, *self.write_of(name, counts), urgency=urgency)
        observed = await self.read_item(name, urgency=urgency)
        if observed != counts:
            raise self.error(f"has {observed} as its {name.replace('_', ' ')} after {counts} was written")

    async def write_eeprom(self, **values: int) -> None:
        """Writes items that need the torque off, and confirms them. Restores the torque without motion."""
        was_on = (await self.condition()).torque
        if was_on:
            await self.write_item("torque_enable", 0)
        try:
            await self._write_unlocked(values)
            await self.read_settings()
        except DeviceError:
            if was_on:
                await self.stiffen()
            raise
        # Not when it was cancelled: a safe state may have switched the torque off meanwhile.
        if was_on:
            await self.stiffen()

    async def _write_unlocked(self, values: Mapping[str, int]) -> None:
        """Writes items and confirms them. A locked Feetech servo loses them at power-off."""
        if self.model.has("lock"):
            await self.write_item("lock", 0)
        try:
            for name, counts in values.items():
                await self.write_item(name, counts)
        finally:
            if self.model.has("lock"):
                await self.write_item("lock", 1)

    # -- measured values --------------------------------------------------------------------------------

    async def present(self, *, urgency: int = COMMAND) -> Present:
        """The present measured values. Raises DeviceError."""
        return self.reading(await self.chain.read(self.node, *self.model.present, urgency=urgency))

    def reading(self, status: Status) -> Present:
        """The measured values of the joint in an answer."""
        servo_reading, sign = present(self.model, status), self.joint.direction
        return replace(
            servo_reading,
            position=self.joint.to_joint(servo_reading.position),
            velocity=sign * servo_reading.velocity,
            current=sign * servo_reading.current,
            effort=sign * servo_reading.effort,
        )

    async def condition(self, *, urgency: int = COMMAND) -> Condition:
        """The present torque, hardware errors and watchdog. Raises DeviceError."""
        return condition(self.model, await self.chain.read(self.node, *self.model.state, urgency=urgency))

    @property
    def is_bounded(self) -> bool:
        """Whether the position limits of the servo apply: in position mode, also under another name."""
        return self.model.modes.get(self.mode) == self.model.modes.get("position")

    # -- motion -----------------------------------------------------------------------------------------

    async def stiffen(self) -> None:
        """Switches the torque on, confirmed; first sets the goal to the present position."""
        await self.write_hold_goal(await self.present())
        if self.model.has("torque_limit"):
            await self.restore_torque_limit()
        await self.write_item("torque_enable", 1)

    async def switch(self, mode: str) -> None:
        """Changes the operating mode. The torque is off meanwhile and restored without motion."""
        self.item("operating_mode")
        if mode not in self.model.modes:
            raise self.error(f"has no mode '{mode}'; there are: {', '.join(self.model.modes)}")
        modes = self.model.modes
        if modes[mode] != modes.get(self.mode):
            await self.write_eeprom(operating_mode=modes[mode])
        if mode != self.mode and self.model.has("torque_limit"):
            await self.restore_torque_limit()
        self.mode = mode

    async def restore_torque_limit(self) -> None:
        """Sets the torque limit to its maximum: an AX that has shut down has 0."""
        await self.write_item("torque_limit", await self.read_item("max_torque"))

    async def limit_force(self, current: float) -> None:
        """Limits the force of later motions, in A of the motor. Raises DeviceError."""
        if self.model.has("goal_current"):
            await self.write_item("goal_current", round(current / self.model.current))
        elif current <= (stall := self.model.stall or 0.0):
            await self.write_item("torque_limit", max(round(current / stall * _WHOLE_TORQUE), 1))
        else:
            raise self.error(
                f"cannot be limited to {current:g} A: its stall current is {stall or math.nan:g} A"
            )

    def hold_goal(self, reading: Present) -> tuple[str, int]:
        """The goal for holding: item and value in counts."""
        if self.mode in POSITION_MODES:
            low, high = self._limits
            return "goal_position", min(max(reading.counts, low), high) if self.is_bounded else reading.counts
        return f"goal_{self.mode}", 0

    async def write_hold_goal(self, reading: Present, *, urgency: int = COMMAND) -> None:
        """Sets the goal for holding. Raises DeviceError."""
        self.pushing = False
        await self.chain.write(self.node, *self.write_of(*self.hold_goal(reading)), urgency=urgency)

    def to_counts(self, angle: float) -> int:
        """The position of an angle in counts; in position mode within its limits, which are rounded too."""
        if self.is_bounded:
            angle = min(max(angle, self.reach[0]), self.reach[1])
        return self.model.to_counts(self.joint.to_servo(angle))

    def check_profile(self, distance: float, speed: float, acceleration: float) -> None:
        """Raises DeviceError for a motion longer than a profile can last: it would be faster."""
        seconds = self._times(distance, speed, acceleration)[1] if self.time_based else 0.0
        if seconds > _LONGEST_PROFILE / 1000.0:
            raise self.error(
                f"takes {seconds:.1f} s for this motion at {speed:g} rad/s, but its time-based profiles "
                f"(drive mode) last at most {_LONGEST_PROFILE / 1000.0:g} s: move in several steps"
            )

    def _times(self, distance: float, speed: float, acceleration: float) -> tuple[float, float]:
        """Seconds of a time-based profile: acceleration, and total."""
        ramp = speed / acceleration if acceleration else 0.0
        return ramp, (distance / speed if speed else 0.0) + ramp

    def motion(self, angle: float, distance: float, speed: float, acceleration: float) -> tuple[int, bytes]:
        """A goal with its profile, as one write: address and bytes. rad, rad, rad/s, rad/s2 (0:
        unlimited).
        """
        model = self.model
        values = {"goal_position": self.to_counts(angle)}
        if self.time_based:
            ramp, seconds = self._times(distance, speed, acceleration)
            span = values["profile_velocity"] = max(round(min(seconds * 1000.0, _LONGEST_PROFILE)), 1)
            values["profile_acceleration"] = round(min(ramp * 1000.0, span // 2))
        else:
            values["profile_velocity"] = _counts(speed, model.velocity, model.fastest)
            if acceleration and model.acceleration:
                values["profile_acceleration"] = _counts(acceleration, model.acceleration, model.hardest)
        names = ("profile_acceleration", "goal_time", "profile_velocity", "goal_position")
        items = sorted((model.items[name].address, name) for name in names if model.has(name))
        return items[0][0], b"".join(self.write_of(n, values.get(n, 0))[1] for _, n in items)

    # -- its own watchdog -------------------------------------------------------------------------------

    async def set_watchdog(self, longest: float) -> float | None:
        """Sets the watchdog to at most `longest` s without a packet; returns the actual time (s)."""
        if not self.model.watchdog:
            return None
        counts = min(max(int(longest / self.model.watchdog + 1e-9), 1), WATCHDOG_LONGEST)
        if (await self.condition()).watchdog == WATCHDOG_FIRED:
            await self.clear_watchdog()
        await self.write_item("bus_watchdog", counts)
        return counts * self.model.watchdog

    async def clear_watchdog(self) -> None:
        """Ends the stop by the watchdog: goals are writable again, and the servo holds.

        A limp servo gets no goal, which may switch the torque on, depending on its drive mode.
        """
        observed, torque = await self.present(), (await self.condition()).torque
        await self.chain.write(self.node, self.item("bus_watchdog").address, b"\0")
        if torque:
            await self.write_hold_goal(observed)

    @property
    def remedy(self) -> str:
        """The remedy after the servo has shut down."""
        if self.node.protocol != 2:
            return "torque(true) restores it when the cause is gone"
        return "reboot() restarts it"

    def error(self, reason: str) -> DeviceError:
        """An exception about this servo."""
        return DeviceError(f"servo {self.node.number}", f"servo {self.joint.label} {reason}")


def _counts(value: float, unit: float, greatest: int) -> int:
    """A value in counts, rounded down, and never 0, which means unlimited in a profile."""
    return max(math.floor(min(value / unit, greatest) * ROUNDED), 1)
