"""One servo: its control table in SI units, and the few things that must be done in the right order."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfield.driver import DeviceError
from lfield_dynamixel.bus.bus import COMMAND
from lfield_dynamixel.bus.chain import Chain, NoAnswer, Node
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.bus.words import alerted, faults
from lfield_dynamixel.tables import Item, Model, models

#: Above this a value that has been rounded is above its limit, relatively.
ROUNDED = 1.0 + 1e-9
#: What a servo answers, and the level at which it answers everything.
ANSWERS, ALL = "status_return_level", 2
#: Operating modes: the name in L and the value of the register (e-manual, address 11).
MODES = {"current": 0, "velocity": 1, "position": 3, "extended": 4, "currentPosition": 5, "pwm": 16}
POSITION_MODES = ("position", "extended", "currentPosition")

#: What the watchdog register reads after it has fired: the goals are read-only until it is set to 0.
FIRED = 255
WATCHDOG_LONGEST = 127

#: Bits of the drive mode register (e-manual, address 10): it follows the cable of another servo and ignores
#: goals; profiles are given as times, in milliseconds. Bit 0 turns the direction of all that it measures and
#: takes; bit 3 switches the torque on by any goal.
_SLAVE, _TIME_BASED = 1 << 1, 1 << 2
_LONGEST_PROFILE = 32737


@dataclass(frozen=True, slots=True)
class Present:
    """What a servo measures: rad, rad/s, A, N m (NaN where the model cannot say), V, °C."""

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
    """The state that does not change by itself: torque on, hardware errors in words, watchdog in counts."""

    torque: bool
    faults: str
    watchdog: int


def present(model: Model, status: Status) -> Present:
    """What an answer to a read of `model.present` says."""
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
        alert=alerted(model.protocol, status),
    )


def condition(model: Model, status: Status) -> Condition:
    """What an answer to a read of `model.state` says."""
    start, items = model.state[0], model.items
    bits = items["hardware_error"].decode(status.data, start) if model.has("hardware_error") else status.error
    watchdog = items["bus_watchdog"].decode(status.data, start) if model.watchdog else 0
    torque = bool(items["torque_enable"].decode(status.data, start))
    return Condition(torque, faults(model.protocol, bits), watchdog)


class Servo:
    """One servo on a chain. `open` comes first; everything else needs its model.

    `mode` is its operating mode by name, `reach` the least and greatest angle (rad) that it accepts in
    position mode, `top_speed` its own limit (rad/s). `is_slave` says that it follows the cable of another
    servo and ignores goals. `pushing` says that it holds something by the force
    that it was given: to stay, it must go on.
    """

    model: Model

    def __init__(self, chain: Chain, node: Node) -> None:
        self.chain, self.node = chain, node
        self.mode = "position"
        self.time_based = self.is_slave = False
        self.reach = (-math.inf, math.inf)
        self.top_speed = math.inf
        self.pushing = False

    async def open(self, wanted: str = "") -> str:
        """Find it and read how it is set; its identity in words. Raises DeviceError, also when it is not of
        the model that is wanted.
        """
        if await self.chain.ping(self.node) is None and await self.chain.ping(self.node) is None:
            raise NoAnswer(self.node.number, "is it powered, on this bus, of this baud rate and protocol?")
        number = await self._model_number()
        model = models().get((self.node.protocol, number))
        if model is None:
            known = ", ".join(sorted(m.name for m in models().values()))
            raise self.error(f"is of the model number {number}, which is not in the tables (known: {known})")
        if wanted not in ("", model.name):
            raise self.error(f"is a {model.name}; its binding says that it is a {wanted}")
        self.model, self.top_speed = model, model.fastest * model.velocity
        if conflict := await self.chain.roll_call(self.node, *model.present):
            raise DeviceError(f"servo {self.node.number}", conflict)
        firmware = await self.get("firmware_version")
        await self.read_settings()
        return f"{model.name} {self.node.number} (firmware {firmware}, {self.mode} mode)"

    async def _model_number(self) -> int:
        """Read the model number; a servo that is set to answer pings only is told to answer all."""
        try:
            status = await self.chain.read(self.node, 0, 2)
        except NoAnswer:
            if self.node.protocol == 1:
                raise
            address, answer_all = models()[2, 1020].items["status_return_level"].address, b"\x02"
            await self.chain.tell(self.node, address, answer_all)
            status = await self.chain.read(self.node, 0, 2)
        return int.from_bytes(status.data, "little")

    async def read_settings(self) -> None:
        """Read what the driver relies on: mode, kind of profile, limits of position and speed."""
        if not self.keeps_answers and await self.get(ANSWERS) < ALL:
            await self.answer_all()
        if self.model.has("operating_mode"):
            value = await self.get("operating_mode")
            self.mode = next((name for name, number in MODES.items() if number == value), f"mode {value}")
            drive_mode = await self.get("drive_mode")
            self.time_based, self.is_slave = bool(drive_mode & _TIME_BASED), bool(drive_mode & _SLAVE)
            self.top_speed = await self.get("velocity_limit") * self.model.velocity
        low, high = await self.get("min_position_limit"), await self.get("max_position_limit")
        self.reach = self.model.to_angle(low), self.model.to_angle(high)

    @property
    def keeps_answers(self) -> bool:
        """Whether what it answers is in its EEPROM, as that of an AX."""
        return self.item(ANSWERS).address < self.model.ram

    async def answer_all(self) -> None:
        """Have it answer writes too; it need not answer this one. Seen to be so; raises DeviceError."""
        item = self.item(ANSWERS)
        await self.chain.tell(self.node, item.address, item.encode(ALL))
        if await self.get(ANSWERS) != ALL:
            raise self.error("does not take that it answers writes: switch its torque off first")

    # -- the control table ------------------------------------------------------------------------------

    def item(self, name: str) -> Item:
        """Where a value stands. Raises DeviceError when the model has none such."""
        if not self.model.has(name):
            raise self.error(f"is a {self.model.name}: it has no {name.replace('_', ' ')}")
        return self.model.items[name]

    async def get(self, name: str, *, urgency: int = COMMAND) -> int:
        """The value of an item, in counts. Raises DeviceError."""
        item = self.item(name)
        return item.decode(
            (await self.chain.read(self.node, item.address, item.size, urgency=urgency)).data, item.address
        )

    async def put(self, name: str, counts: int, *, urgency: int = COMMAND) -> None:
        """Write an item and see that it is what was written. Raises DeviceError."""
        item = self.item(name)
        await self.chain.write(self.node, item.address, item.encode(counts), urgency=urgency)
        seen = await self.get(name, urgency=urgency)
        if seen != counts:
            raise self.error(f"has {seen} as its {name.replace('_', ' ')} after {counts} was written")

    async def put_eeprom(self, **values: int) -> None:
        """Write items that need the torque off, and see them. Then it is as it was, without motion."""
        was_on = (await self.condition()).torque
        if was_on:
            await self.put("torque_enable", 0)
        try:
            for name, counts in values.items():
                await self.put(name, counts)
            await self.read_settings()
        except DeviceError:
            if was_on:
                await self.stiffen()
            raise
        # Not when it was cancelled: what makes it safe may have switched the torque off meanwhile.
        if was_on:
            await self.stiffen()

    # -- what it measures -------------------------------------------------------------------------------

    async def present(self, *, urgency: int = COMMAND) -> Present:
        """What it measures now. Raises DeviceError."""
        return present(self.model, await self.chain.read(self.node, *self.model.present, urgency=urgency))

    async def condition(self, *, urgency: int = COMMAND) -> Condition:
        """Torque, hardware errors and watchdog now. Raises DeviceError."""
        return condition(self.model, await self.chain.read(self.node, *self.model.state, urgency=urgency))

    # -- what it does -----------------------------------------------------------------------------------

    async def stiffen(self) -> None:
        """Switch the torque on, seen to have happened; its goal is first where it is.

        An AX that has shut down has a torque limit of 0 from then on; this gives it its strength back.
        """
        await self.write_here(await self.present())
        if self.model.has("torque_limit"):
            await self.put("torque_limit", await self.get("max_torque"))
        await self.put("torque_enable", 1)

    async def switch(self, mode: str) -> None:
        """Change the operating mode. The torque goes off for it and comes back without motion."""
        if mode not in MODES:
            raise self.error(f"has no mode '{mode}'; there are: {', '.join(MODES)}")
        if mode != self.mode:
            await self.put_eeprom(operating_mode=MODES[mode])

    def here(self, seen: Present) -> tuple[str, int]:
        """The goal that means to stay: which item, and its value in counts."""
        if self.mode in POSITION_MODES:
            low, high = (self.model.to_counts(a) for a in self.reach)
            return "goal_position", min(
                max(seen.counts, low), high
            ) if self.mode == "position" else seen.counts
        return f"goal_{self.mode}", 0

    async def write_here(self, seen: Present, *, urgency: int = COMMAND) -> None:
        """Make what it does now its goal: it stays. Raises DeviceError."""
        self.pushing = False
        name, counts = self.here(seen)
        item = self.item(name)
        await self.chain.write(self.node, item.address, item.encode(counts), urgency=urgency)

    def to_counts(self, angle: float) -> int:
        """The position of an angle in counts; in position mode within its limits, which are rounded too."""
        if self.mode == "position":
            angle = min(max(angle, self.reach[0]), self.reach[1])
        return self.model.to_counts(angle)

    def check_profile(self, distance: float, speed: float, acceleration: float) -> None:
        """Raise DeviceError for a way that takes longer than a profile can: it would go faster."""
        seconds = self._times(distance, speed, acceleration)[1] if self.time_based else 0.0
        if seconds > _LONGEST_PROFILE / 1000.0:
            raise self.error(
                f"takes {seconds:.1f} s for this way at {speed:g} rad/s, and its profiles, which are times "
                f"(drive mode), last {_LONGEST_PROFILE / 1000.0:g} s at most: go in several steps"
            )

    def _times(self, distance: float, speed: float, acceleration: float) -> tuple[float, float]:
        """Seconds of a time-based profile: until its speed is reached, and in all."""
        ramp = speed / acceleration if acceleration else 0.0
        return ramp, (distance / speed if speed else 0.0) + ramp

    def motion(self, angle: float, distance: float, speed: float, acceleration: float) -> tuple[int, bytes]:
        """A goal with its profile, as one write: address and bytes. rad, rad, rad/s, rad/s2 (0: at once)."""
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
        """Have it stop by itself after at most `longest` seconds without a packet; what it then says (s)."""
        if not self.model.watchdog:
            return None
        counts = min(max(int(longest / self.model.watchdog + 1e-9), 1), WATCHDOG_LONGEST)
        if (await self.condition()).watchdog == FIRED:
            await self.clear_watchdog()
        await self.put("bus_watchdog", counts)
        return counts * self.model.watchdog

    async def clear_watchdog(self) -> None:
        """Take it out of the stop that its watchdog made: its goals are writable again, and it stays.

        One that is limp gets no goal: by its drive mode that may switch the torque on.
        """
        seen, torque = await self.present(), (await self.condition()).torque
        await self.chain.write(self.node, self.item("bus_watchdog").address, b"\0")
        if torque:
            await self.write_here(seen)

    @property
    def cure(self) -> str:
        """What brings it back after it has shut down, in words."""
        if self.node.protocol == 1:
            return "torque(true) brings it back when the cause is gone"
        return "reboot() restarts it"

    def error(self, reason: str) -> DeviceError:
        """An exception about this servo."""
        return DeviceError(f"servo {self.node.number}", f"servo {self.node.number} {reason}")


def _counts(value: float, unit: float, greatest: int) -> int:
    """A value in counts, not above it, and never 0: in a profile that would mean without limit."""
    return max(math.floor(min(value / unit, greatest) * ROUNDED), 1)
