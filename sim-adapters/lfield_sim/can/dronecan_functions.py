"""Functions of a simulated DroneCAN node: a battery, an ESC, or a servo. Payloads of the package
`dronecan`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import dronecan

from lfield.errors import UsageError
from lfield_sim.can.can_bus import FaultLookup
from lfield_sim.can.can_motor import AMBIENT, OVERHEATED
from lfield_sim.state_log import Facts

KELVIN = 273.15
#: Seconds between two messages of measured values.
BATTERY_PERIOD, ESC_PERIOD, SERVO_PERIOD = 1.0, 0.05, 0.05
#: Seconds without a command after which an ESC stops and a servo holds.
ESC_TIMEOUT, SERVO_TIMEOUT = 0.5, 1.0
#: An ESC at full command (rev/min), its raw command, and its lag in seconds.
TOP_SPEED, FULL, LAG = 9000.0, 8191.0, 0.2
#: A servo's greatest speed in rad/s, and its stops in rad.
SERVO_SPEED, SERVO_STOP = 1.0, 1.6

uavcan: Any = dronecan.uavcan


class NodeFunction:
    """One function of a node, `index` among those of its kind."""

    name: ClassVar[str]
    #: Ids of the messages that the function follows.
    commands: ClassVar[frozenset[int]] = frozenset()
    period: ClassVar[float]

    def __init__(self, index: int) -> None:
        self._index = index
        self._until_report = 0.0
        self.power_up()

    def power_up(self) -> None:
        """Starts the function."""

    def power_down(self) -> None:
        """Removes the power."""

    def on_command(self, message: int, payload: Any) -> None:
        """Handles a message that this node follows."""

    def step(self, dt: float, flaw: FaultLookup) -> Iterator[Any]:
        """Advances time; returns the payloads that are due."""
        self._move(dt, flaw)
        self._until_report -= dt
        if self._until_report <= 1e-9:
            self._until_report += self.period
            yield self._report(flaw)

    def facts(self) -> Facts:
        """The log entries of the function."""
        return {}

    def _move(self, dt: float, flaw: FaultLookup) -> None:
        """Advances the model of the function."""

    def _report(self, flaw: FaultLookup) -> Any:
        raise NotImplementedError


class Battery(NodeFunction):
    """A pack of four cells, discharged with 5 A."""

    name, period = "battery", BATTERY_PERIOD
    _CAPACITY, _CURRENT = 74.0, 5.0

    def power_up(self) -> None:
        """Starts with the charge before the restart."""
        self._charge = getattr(self, "_charge", 1.0)

    def _move(self, dt: float, flaw: FaultLookup) -> None:
        self._charge = max(0.0, self._charge - self._CURRENT * 15.0 * dt / 3600.0 / self._CAPACITY)

    def _report(self, flaw: FaultLookup) -> Any:
        info = uavcan.equipment.power.BatteryInfo()
        info.voltage, info.current = 12.8 + 4.0 * self._charge, self._CURRENT
        info.temperature = KELVIN + (OVERHEATED if flaw("overheat") else AMBIENT)
        info.status_flags = 1 + 8 * bool(flaw("overheat")) + 32 * bool(flaw("overcurrent"))
        info.state_of_charge_pct, info.state_of_health_pct = round(100.0 * self._charge), 127
        info.full_charge_capacity_wh = self._CAPACITY
        info.remaining_capacity_wh = self._CAPACITY * self._charge
        info.battery_id, info.model_name = self._index, "lfield pack"
        return info


class Esc(NodeFunction):
    """A motor controller that follows RawCommand, and stops without it."""

    name, period, commands = "esc", ESC_PERIOD, frozenset({1030})

    def power_up(self) -> None:
        """Starts at rest."""
        self._goal = self._speed = 0.0
        self._age = 0.0

    def on_command(self, message: int, payload: Any) -> None:
        """Follows the entry of this ESC in the array; none means 0."""
        if message not in self.commands:
            return
        entries = list(payload.cmd)
        raw = entries[self._index] if self._index < len(entries) else 0
        self._goal, self._age = TOP_SPEED * raw / FULL, 0.0

    def facts(self) -> Facts:
        """The log entry for a turning motor."""
        return {f"esc{self._index}.turning": int(abs(self._speed) > 50.0)}

    def _move(self, dt: float, flaw: FaultLookup) -> None:
        self._age += dt
        goal = 0.0 if self._age > ESC_TIMEOUT or flaw("stuck") else self._goal
        self._speed += (goal - self._speed) * -math.expm1(-dt / LAG)

    def _report(self, flaw: FaultLookup) -> Any:
        status = uavcan.equipment.esc.Status()
        share = abs(self._speed) / TOP_SPEED
        status.voltage, status.current = 16.0 - share, 20.0 * share
        status.temperature = KELVIN + (OVERHEATED if flaw("overheat") else AMBIENT)
        status.rpm, status.power_rating_pct = round(self._speed), round(100.0 * share)
        status.error_count, status.esc_index = int(bool(flaw("overcurrent"))), self._index
        return status


class Servo(NodeFunction):
    """A servo that follows positions between its stops, and holds without commands."""

    name, period, commands = "servo", SERVO_PERIOD, frozenset({1010})

    def power_up(self) -> None:
        """Starts at the present position."""
        self._position = getattr(self, "_position", 0.0)
        self._goal, self._speed, self._age = self._position, 0.0, 0.0

    def on_command(self, message: int, payload: Any) -> None:
        """Follows positions only: other kinds of commands are ignored."""
        if message not in self.commands:
            return
        for command in payload.commands:
            if command.actuator_id == self._index and command.command_type == 1:
                value = float(command.command_value)
                if math.isfinite(value):
                    self._goal, self._age = max(-SERVO_STOP, min(SERVO_STOP, value)), 0.0

    def facts(self) -> Facts:
        """The position in thousandths of a radian, and whether the servo moves."""
        name = f"servo{self._index}"
        moving = int(abs(self._speed) > 0.02)
        return {f"{name}.position": round(1000.0 * self._position), f"{name}.moving": moving}

    def _move(self, dt: float, flaw: FaultLookup) -> None:
        self._age += dt
        if self._age > SERVO_TIMEOUT:
            self._goal = self._position
        distance = 0.0 if flaw("stuck") else self._goal - self._position
        step = max(-SERVO_SPEED * dt, min(SERVO_SPEED * dt, distance))
        self._position, self._speed = self._position + step, step / dt

    def _report(self, flaw: FaultLookup) -> Any:
        status = uavcan.equipment.actuator.Status()
        status.actuator_id, status.position, status.speed = self._index, self._position, self._speed
        status.force, status.power_rating_pct = math.nan, 127
        return status


def functions_of(text: str) -> list[NodeFunction]:
    """The functions of a node in a text: `servo:0+servo:1+battery:0`. Raises UsageError."""
    functions = []
    for part in text.split("+"):
        name, _, index = part.partition(":")
        if name not in _FUNCTIONS or not index.isdecimal() or int(index) > 255:
            raise UsageError(f"'{part}' is not a function; write {':0, '.join(_FUNCTIONS)}:0, joined by +")
        functions.append(_FUNCTIONS[name](int(index)))
    return functions


_FUNCTIONS: Mapping[str, type[NodeFunction]] = {each.name: each for each in (Battery, Esc, Servo)}
