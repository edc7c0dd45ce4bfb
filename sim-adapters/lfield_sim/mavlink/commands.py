"""The commands the fake knows: number -> what it does, with ArduPilot's results."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from lfield_sim.autopilot import FORCE, Result
from lfield_sim.mavlink.telemetry import MESSAGES

if TYPE_CHECKING:
    from lfield_sim.mavlink.protocol import MavlinkFake


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT: its number and seven values."""

    number: int
    values: tuple[float, ...]

    def value(self, index: int) -> float:
        """Parameter `index`, counted from 1 as in the MAVLink tables; NaN reads as 0."""
        value = self.values[index - 1]
        return 0.0 if math.isnan(value) else value

    def whole(self, index: int) -> int:
        """Parameter `index` as a whole number; what is not one reads as -1."""
        value = self.value(index)
        return int(value) if math.isfinite(value) else -1


Answer = tuple[Result, list[Any]]


def answer(fake: MavlinkFake, command: Command) -> Answer:
    """Carry a command out: its result, and messages that follow the acknowledgement."""
    handler = _COMMANDS.get(command.number)
    return handler(fake, command) if handler else (Result.UNSUPPORTED, [])


def _arm(fake: MavlinkFake, command: Command) -> Answer:
    force = command.whole(2) == FORCE
    wanted = command.whole(1)
    if wanted not in (0, 1):
        return Result.UNSUPPORTED, []
    return (fake.autopilot.arm(force=force) if wanted else fake.autopilot.disarm(force=force)), []


def _takeoff(fake: MavlinkFake, command: Command) -> Answer:
    return fake.autopilot.takeoff(command.value(7)), []


def _land(fake: MavlinkFake, _: Command) -> Answer:
    return fake.autopilot.land(), []


def _return(fake: MavlinkFake, _: Command) -> Answer:
    return fake.autopilot.go_home(), []


def _set_mode(fake: MavlinkFake, command: Command) -> Answer:
    if not command.whole(1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return Result.DENIED, []
    return fake.autopilot.set_mode(command.whole(2)), []


def _yaw(fake: MavlinkFake, command: Command) -> Answer:
    angle, relative = command.value(1), command.whole(4)
    if not 0.0 <= angle <= 360.0 or relative not in (0, 1):
        return Result.FAILED, []
    start = fake.autopilot.vehicle.yaw if relative else 0.0
    turn = -1.0 if relative and command.value(3) < 0 else 1.0
    return fake.autopilot.set_yaw(start + turn * math.radians(angle)), []


def _speed(fake: MavlinkFake, command: Command) -> Answer:
    if command.whole(1) not in (0, 1):
        return Result.UNSUPPORTED, []
    return fake.autopilot.set_speed(command.value(2)), []


def _set_interval(fake: MavlinkFake, command: Command) -> Answer:
    kind, micros = command.whole(1), command.value(2)
    if kind not in MESSAGES:
        return Result.FAILED, []
    # -1 stops the stream; 0 asks for the default rate, which on ArduPilot is none.
    fake.stream(kind, 1e6 / micros if micros > 0 else 0.0)
    return Result.ACCEPTED, []


def _get_interval(fake: MavlinkFake, command: Command) -> Answer:
    kind = command.whole(1)
    if kind not in MESSAGES:
        return Result.FAILED, []
    micros = round(fake.interval(kind) * 1e6) or -1
    return Result.ACCEPTED, [dialect.MAVLink_message_interval_message(kind, micros)]


def _request_message(fake: MavlinkFake, command: Command) -> Answer:
    builder = MESSAGES.get(command.whole(1))
    return (Result.ACCEPTED, [builder(fake.autopilot, fake.place)]) if builder else (Result.FAILED, [])


_COMMANDS: Mapping[int, Callable[[MavlinkFake, Command], Answer]] = {
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    dialect.MAV_CMD_NAV_LAND: _land,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_CONDITION_YAW: _yaw,
    dialect.MAV_CMD_DO_SET_MODE: _set_mode,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _speed,
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    dialect.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: _request_message,
}
