"""One servo: its control table in SI units, and operations that need several steps in order."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfield.driver import DeviceError
from lfield_dynamixel.bus.error_text import fault_text, has_alert
from lfield_dynamixel.bus.half_duplex_bus import COMMAND
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.bus.servo_chain import Chain, NoAnswer, Node
from lfield_dynamixel.control_tables import Item, Model, models

#: Relative rounding tolerance of a limit.
ROUNDED = 1.0 + 1e-9
#: The status return level, and the level at which it answers everything.
STATUS_RETURN_LEVEL, RETURN_ALL = "status_return_level", 2
#: Operating modes: the name in L and the register value (e-manual, address 11).
MODES = {"current": 0, "velocity": 1, "position": 3, "extended": 4, "currentPosition": 5, "pwm": 16}
POSITION_MODES = ("position", "extended", "currentPosition")

#: Value of the watchdog register after it has expired: goals are read-only until it is set to 0.
WATCHDOG_FIRED = 255
WATCHDOG_LONGEST = 127

#: Bits of the drive mode register (e-manual, address 10): slave of another servo's cable, which ignores
#: goals; time-based profiles in milliseconds. Bit 0 reverses the direction; bit 3 switches the torque on by
#: any goal.
_SLAVE, _TIME_BASED = 1 << 1, 1 << 2
_LONGEST_PROFILE = 32737


@dataclass(frozen=True, slots=True)
class Present:
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


@dataclass(frozen=True, slots=True)
class Condition:
    """State that does not change by itself: torque on, hardware errors in words, watchdog in counts."""

    torque: bool
    faults: str
    watchdog: int


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
    return Condition(torque, fault_text(model.protocol, bits), watchdog)


class Servo:
    """One servo on a chain. Call `open` first; everything else needs its model.

    `mode` is its operating mode by name, `reach` the range of angles (rad) in position mode, `top_speed` its
    own limit (rad/s). `is_slave`: it follows the cable of another servo and ignores goals. `pushing`: it
    holds something by force, and must continue to hold it.
    """

    model: Model

    def __init__(self, chain: Chain, node: Node) -> None:
        self.chain, self.node = chain, node
        self.mode = "position"
        self.time_based = self.is_slave = False
        self.reach = (-math.inf, math.inf)
        self.top_speed = math.inf
        self.pushing = False

    def set_pushing(self, pushing: bool) -> None:
        """Sets whether it presses on an object."""
        self.pushing = pushing

    async def open(self, expected: str = "") -> str:
        """Finds it and reads its settings; returns its identity. Raises DeviceError, also for another model
        than expected.
        """
        if await self.chain.ping(self.node) is None and await self.chain.ping(self.node) is None:
            raise NoAnswer(self.node.number, "check its power, and the bus, baud rate and protocol")
        number = await self._model_number()
        model = models().get((self.node.protocol, number))
        if model is None:
            known = ", ".join(sorted(m.name for m in models().values()))
            raise self.error(f"is of the model number {number}, which is not in the tables (known: {known})")
        if expected not in ("", model.name):
            raise self.error(f"is a {model.name}, but its binding says {expected}")
        self.model, self.top_speed = model, model.fastest * model.velocity
        if conflict := await self.chain.id_conflict(self.node, *model.present):
            raise DeviceError(f"servo {self.node.number}", conflict)
        firmware = await self.read_item("firmware_version")
        await self.read_settings()
        return f"{model.name} {self.node.number} (firmware {firmware}, {self.mode} mode)"

    async def _model_number(self) -> int:
        """Reads the model number; a servo that answers pings only is configured to answer all."""
        try:
            status = await self.chain.read(self.node, 0, 2)
        except NoAnswer:
            if self.node.protocol == 1:
                raise
            address, answer_all = models()[2, 1020].items["status_return_level"].address, b"\x02"
            await self.chain.write_unconfirmed(self.node, address, answer_all)
            status = await self.chain.read(self.node, 0, 2)
        return int.from_bytes(status.data, "little")

    async def read_settings(self) -> None:
        """Reads what the driver relies on: mode, kind of profile, limits of position and speed."""
        if not self.keeps_answers and await self.read_item(STATUS_RETURN_LEVEL) < RETURN_ALL:
            await self.answer_all()
        if self.model.has("operating_mode"):
            value = await self.read_item("operating_mode")
            self.mode = next((name for name, number in MODES.items() if number == value), f"mode {value}")
            drive_mode = await self.read_item("drive_mode")
            self.time_based, self.is_slave = bool(drive_mode & _TIME_BASED), bool(drive_mode & _SLAVE)
            self.top_speed = await self.read_item("velocity_limit") * self.model.velocity
        low, high = await self.read_item("min_position_limit"), await self.read_item("max_position_limit")
        self.reach = self.model.to_angle(low), self.model.to_angle(high)

    @property
    def keeps_answers(self) -> bool:
        """Whether its status return level is in its EEPROM, as in an AX."""
        return self.item(STATUS_RETURN_LEVEL).address < self.model.ram

    async def answer_all(self) -> None:
        """Makes it answer writes too; this one may be unanswered. Confirmed; raises DeviceError."""
        item = self.item(STATUS_RETURN_LEVEL)
        await self.chain.write_unconfirmed(self.node, item.address, item.encode(RETURN_ALL))
        if await self.read_item(STATUS_RETURN_LEVEL) != RETURN_ALL:
            raise self.error("refuses to answer writes: switch its torque off first")

    # -- the control table ------------------------------------------------------------------------------

    def item(self, name: str) -> Item:
        """The item of a value. Raises DeviceError when the model has none."""
        if not self.model.has(name):
            raise self.error(f"is a {self.model.name}: it has no {name.replace('_', ' ')}")
        return self.model.items[name]

    async def read_item(self, name: str, *, urgency: int = COMMAND) -> int:
        """The value of an item, in counts. Raises DeviceError."""
        item = self.item(name)
        return item.decode(
            (await self.chain.read(self.node, item.address, item.size, urgency=urgency)).data, item.address
        )

    async def write_item(self, name: str, counts: int, *, urgency: int = COMMAND) -> None:
        """Writes an item and reads it back. Raises DeviceError."""
        item = self.item(name)
        await self.chain.write(self.node, item.address, item.encode(counts), urgency=urgency)
        observed = await self.read_item(name, urgency=urgency)
        if observed != counts:
            raise self.error(f"has {observed} as its {name.replace('_', ' ')} after {counts} was written")

    async def write_eeprom(self, **values: int) -> None:
        """Writes items that need the torque off, and confirms them. Restores the torque without motion."""
        was_on = (await self.condition()).torque
        if was_on:
            await self.write_item("torque_enable", 0)
        try:
            for name, counts in values.items():
                await self.write_item(name, counts)
            await self.read_settings()
        except DeviceError:
            if was_on:
                await self.stiffen()
            raise
        # Not when it was cancelled: a safe state may have switched the torque off meanwhile.
        if was_on:
            await self.stiffen()

    # -- measured values --------------------------------------------------------------------------------

    async def present(self, *, urgency: int = COMMAND) -> Present:
        """Its present measured values. Raises DeviceError."""
        return present(self.model, await self.chain.read(self.node, *self.model.present, urgency=urgency))

    async def condition(self, *, urgency: int = COMMAND) -> Condition:
        """Its present torque, hardware errors and watchdog. Raises DeviceError."""
        return condition(self.model, await self.chain.read(self.node, *self.model.state, urgency=urgency))

    # -- motion -----------------------------------------------------------------------------------------

    async def stiffen(self) -> None:
        """Switches the torque on, confirmed; first sets its goal to its position.

        An AX that has shut down has a torque limit of 0; this restores it.
        """
        await self.write_hold_goal(await self.present())
        if self.model.has("torque_limit"):
            await self.write_item("torque_limit", await self.read_item("max_torque"))
        await self.write_item("torque_enable", 1)

    async def switch(self, mode: str) -> None:
        """Changes the operating mode. The torque is off meanwhile and restored without motion."""
        if mode not in MODES:
            raise self.error(f"has no mode '{mode}'; there are: {', '.join(MODES)}")
        if mode != self.mode:
            await self.write_eeprom(operating_mode=MODES[mode])

    def hold_goal(self, reading: Present) -> tuple[str, int]:
        """The goal for holding: item and value in counts."""
        if self.mode in POSITION_MODES:
            low, high = (self.model.to_counts(a) for a in self.reach)
            return "goal_position", min(
                max(reading.counts, low), high
            ) if self.mode == "position" else reading.counts
        return f"goal_{self.mode}", 0

    async def write_hold_goal(self, reading: Present, *, urgency: int = COMMAND) -> None:
        """Sets the goal for holding. Raises DeviceError."""
        self.pushing = False
        name, counts = self.hold_goal(reading)
        item = self.item(name)
        await self.chain.write(self.node, item.address, item.encode(counts), urgency=urgency)

    def to_counts(self, angle: float) -> int:
        """The position of an angle in counts; in position mode within its limits, which are rounded too."""
        if self.mode == "position":
            angle = min(max(angle, self.reach[0]), self.reach[1])
        return self.model.to_counts(angle)

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
                values["profile_acceleration"] = _counts(acceleration, model.acceleration, model.fastest)
        names = [n for n in ("profile_acceleration", "profile_velocity", "goal_position") if model.has(n)]
        items = sorted((model.items[name].address, name) for name in names)
        return items[0][0], b"".join(model.items[n].encode(values.get(n, 0)) for _, n in items)

    # -- its own watchdog -------------------------------------------------------------------------------

    async def set_watchdog(self, longest: float) -> float | None:
        """Sets its own watchdog to at most `longest` seconds without a packet; returns the actual time
        (s).
        """
        if not self.model.watchdog:
            return None
        counts = min(max(int(longest / self.model.watchdog + 1e-9), 1), WATCHDOG_LONGEST)
        if (await self.condition()).watchdog == WATCHDOG_FIRED:
            await self.clear_watchdog()
        await self.write_item("bus_watchdog", counts)
        return counts * self.model.watchdog

    async def clear_watchdog(self) -> None:
        """Ends the stop by its watchdog: goals are writable again, and it holds.

        A limp one gets no goal, which may switch the torque on, depending on its drive mode.
        """
        observed, torque = await self.present(), (await self.condition()).torque
        await self.chain.write(self.node, self.item("bus_watchdog").address, b"\0")
        if torque:
            await self.write_hold_goal(observed)

    @property
    def cure(self) -> str:
        """The remedy after it has shut down."""
        if self.node.protocol == 1:
            return "torque(true) restores it when the cause is gone"
        return "reboot() restarts it"

    def error(self, reason: str) -> DeviceError:
        """An exception about this servo."""
        return DeviceError(f"servo {self.node.number}", f"servo {self.node.number} {reason}")


def _counts(value: float, unit: float, greatest: int) -> int:
    """A value in counts, not above it, and never 0, which means unlimited in a profile."""
    return max(math.floor(min(value / unit, greatest) * ROUNDED), 1)
