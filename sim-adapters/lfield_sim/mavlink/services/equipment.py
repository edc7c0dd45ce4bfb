"""The commands for what hangs on a vehicle, by number; missions carry them out too.

What is not fitted is refused as the real ones refuse it: ArduPilot says that it failed, PX4 leaves to others
what is not its own and says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import Result
from lfield_sim.mavlink.command import Answer, Command, Late
from lfield_sim.mavlink.geo import Place
from lfield_sim.mavlink.services.service import Service
from lfield_sim.mavlink.telemetry.equipment import (
    camera_feedback,
    camera_image_captured,
    gimbal_manager_information,
)

#: Microseconds that a servo takes.
PULSES = range(0, 3001)
#: Seconds that PX4 takes for a gripper, whether there is one or not: nothing feels it.
GRIPPING = 1.06


class Equipment(Service):
    """The payload of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: Place) -> None:
        super().__init__(autopilot, place)
        self.commands = {number: partial(self._carry_out, number) for number in EQUIPMENT}
        self.requests = {
            dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._no_information,
            dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self._gimbal_information,
        }

    def _carry_out(self, number: int, command: Command) -> Answer:
        pilot, hardware = self.autopilot, HARDWARE_OF.get(number)
        px4 = pilot.flavour.submodes
        if px4 and number in NOT_OF_PX4:
            return NOT_OF_PX4[number], []
        if hardware is not None and hardware not in pilot.payload.fitted:
            return self._miss(number, px4=px4)
        if number == dialect.MAV_CMD_DO_SET_ACTUATOR and not px4:
            return Result.UNSUPPORTED, []
        result, messages = EQUIPMENT[number](pilot, self.place, command)
        if px4 and number == dialect.MAV_CMD_DO_GRIPPER and result is Result.ACCEPTED:
            return Late(Result.ACCEPTED, GRIPPING, progress=True), messages
        return result, messages

    def _no_information(self) -> list[Any] | None:
        """ArduPilot accepts the request and sends nothing."""
        return None if self.autopilot.flavour.submodes else []

    def _gimbal_information(self) -> list[Any] | None:
        if "gimbal" not in self.autopilot.payload.fitted:
            return self._no_information()
        return [gimbal_manager_information(self.autopilot, self.place)]

    def _miss(self, number: int, *, px4: bool) -> Answer:
        """What a command comes to whose hardware is not there."""
        if number == dialect.MAV_CMD_DO_WINCH and not self.autopilot.flies and not px4:
            return Result.UNSUPPORTED, []
        if number == dialect.MAV_CMD_DO_DIGICAM_CONTROL and not px4:
            return Result.ACCEPTED, []
        if not px4:
            return Result.FAILED, []
        if number == dialect.MAV_CMD_DO_GRIPPER:
            return Late(Result.ACCEPTED, GRIPPING, progress=True), []
        return (Result.UNSUPPORTED if number == dialect.MAV_CMD_IMAGE_START_CAPTURE else None), []


def _servo(pilot: Autopilot, _: Place, command: Command) -> Answer:
    number, pulse = command.whole(1), command.whole(2)
    if number not in pilot.payload.servos or pulse not in PULSES:
        return Result.FAILED, []
    pilot.payload.servos[number] = pulse
    return Result.ACCEPTED, []


def _actuators(pilot: Autopilot, _: Place, command: Command) -> Answer:
    """PX4's: six outputs at once from -1 to 1, NaN leaves one as it is; 1000 to 2000 us."""
    for number in range(1, 7):
        value = command.given(number)
        if value is not None and -1.0 <= value <= 1.0:
            pilot.payload.servos[number] = round(1500 + 500 * value)
    return Result.ACCEPTED, []


def _relay(pilot: Autopilot, _: Place, command: Command) -> Answer:
    number, state = command.whole(1), command.whole(2)
    if number not in pilot.payload.relays or state not in (0, 1):
        return Result.FAILED, []
    pilot.payload.relays[number] = bool(state)
    return Result.ACCEPTED, []


def _gripper(pilot: Autopilot, _: Place, command: Command) -> Answer:
    action = command.whole(2)
    if action not in (dialect.GRIPPER_ACTION_RELEASE, dialect.GRIPPER_ACTION_GRAB):
        return Result.FAILED, []
    pilot.payload.gripped = action == dialect.GRIPPER_ACTION_GRAB
    pilot.say("Gripper load grabbed" if pilot.payload.gripped else "Gripper load released")
    return Result.ACCEPTED, []


def _winch(pilot: Autopilot, _: Place, command: Command) -> Answer:
    action, length, rate = command.whole(2), command.given(3), command.given(4) or 0.0
    if action == dialect.WINCH_RELAXED:
        pilot.payload.wind(0.0)
    elif action == dialect.WINCH_RELATIVE_LENGTH_CONTROL and length is not None:
        pilot.payload.wind_by(length, rate)
    elif action == dialect.WINCH_RATE_CONTROL:
        pilot.payload.wind(rate)
    else:
        return Result.FAILED, []
    return Result.ACCEPTED, []


def _digicam(pilot: Autopilot, place: Place, command: Command) -> Answer:
    if command.whole(5) != 1:
        return Result.ACCEPTED, []
    pilot.payload.pictures += 1
    return Result.ACCEPTED, [camera_feedback(pilot, place)]


def _capture(pilot: Autopilot, place: Place, _: Command) -> Answer:
    pilot.payload.pictures += 1
    return Result.ACCEPTED, [camera_image_captured(pilot, place)]


def _gimbal(pilot: Autopilot, _: Place, command: Command) -> Answer:
    """Angles in degrees; NaN leaves one as it is. Rates are not served."""
    return _point(pilot, command.given(1), command.given(2))


def _mount(pilot: Autopilot, _: Place, command: Command) -> Answer:
    if command.whole(7) != dialect.MAV_MOUNT_MODE_MAVLINK_TARGETING:
        return Result.DENIED, []
    return _point(pilot, command.given(1), command.given(3))


def _point(pilot: Autopilot, pitch: float | None, yaw: float | None) -> Answer:
    payload = pilot.payload
    payload.point(
        payload.pitch_goal if pitch is None else math.radians(pitch),
        payload.yaw_goal if yaw is None else math.radians(yaw),
    )
    return Result.ACCEPTED, []


EQUIPMENT: Mapping[int, Callable[[Autopilot, Place, Command], Answer]] = {
    dialect.MAV_CMD_DO_SET_RELAY: _relay,
    dialect.MAV_CMD_DO_SET_SERVO: _servo,
    dialect.MAV_CMD_DO_SET_ACTUATOR: _actuators,
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: _digicam,
    dialect.MAV_CMD_DO_MOUNT_CONTROL: _mount,
    dialect.MAV_CMD_DO_GRIPPER: _gripper,
    dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _gimbal,
    dialect.MAV_CMD_IMAGE_START_CAPTURE: _capture,
    dialect.MAV_CMD_DO_WINCH: _winch,
}
#: Which hardware a command is for; servos and relays need none.
HARDWARE_OF: Mapping[int, str] = {
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: "camera",
    dialect.MAV_CMD_IMAGE_START_CAPTURE: "camera",
    dialect.MAV_CMD_DO_MOUNT_CONTROL: "gimbal",
    dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "gimbal",
    dialect.MAV_CMD_DO_GRIPPER: "gripper",
    dialect.MAV_CMD_DO_WINCH: "winch",
}
#: What PX4 does of ArduPilot's: it refuses outputs by number, and leaves winch and old mount to others.
NOT_OF_PX4: Mapping[int, Result | None] = {
    dialect.MAV_CMD_DO_SET_RELAY: Result.UNSUPPORTED,
    dialect.MAV_CMD_DO_SET_SERVO: Result.UNSUPPORTED,
    dialect.MAV_CMD_DO_MOUNT_CONTROL: None,
    dialect.MAV_CMD_DO_WINCH: None,
}
