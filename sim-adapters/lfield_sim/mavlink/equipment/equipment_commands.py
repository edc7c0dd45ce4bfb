"""Payload commands by number, also used by missions.

Missing payload is refused as by the real ones: ArduPilot reports a failure, PX4 does not answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.equipment.camera import IMAGE, VIDEO
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import CommandAnswer, DelayedResult, MavCommand
from lfield_sim.mavlink.services.service import VehicleService
from lfield_sim.mavlink.telemetry.equipment_messages import camera_feedback

#: Accepted pulses of a servo in microseconds.
PULSES = range(0, 3001)
#: Seconds of PX4 for a gripper, fitted or not: there is no sensor.
GRIPPING = 1.06


class EquipmentCommands(VehicleService):
    """Payload commands of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self.commands = {number: partial(self._carry_out, number) for number in EQUIPMENT}
        self.requests = {dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._no_information}

    def _carry_out(self, number: int, command: MavCommand) -> CommandAnswer:
        pilot, hardware = self.autopilot, HARDWARE_OF.get(number)
        px4 = pilot.flavour.submodes
        if px4 and number in NOT_OF_PX4:
            return NOT_OF_PX4[number], []
        if hardware is not None and hardware not in pilot.payload.fitted:
            return self._miss(number, px4=px4)
        if number == dialect.MAV_CMD_DO_SET_ACTUATOR and not px4:
            return MavResult.UNSUPPORTED, []
        result, messages = EQUIPMENT[number](pilot, self.place, command)
        if px4 and number == dialect.MAV_CMD_DO_GRIPPER and result is MavResult.ACCEPTED:
            return DelayedResult(MavResult.ACCEPTED, GRIPPING, progress=True), messages
        return result, messages

    def _no_information(self) -> list[Any] | None:
        """No information: ArduPilot accepts the request and sends no message."""
        return None if self.autopilot.flavour.submodes else []

    def _miss(self, number: int, *, px4: bool) -> CommandAnswer:
        """The result of a command for missing payload."""
        if number == dialect.MAV_CMD_DO_WINCH and not self.autopilot.flies and not px4:
            return MavResult.UNSUPPORTED, []
        if number == dialect.MAV_CMD_DO_DIGICAM_CONTROL and not px4:
            return MavResult.ACCEPTED, []
        if not px4:
            return MavResult.FAILED, []
        if number == dialect.MAV_CMD_DO_GRIPPER:
            return DelayedResult(MavResult.ACCEPTED, GRIPPING, progress=True), []
        return (MavResult.UNSUPPORTED if number in CAPTURES else None), []


def _servo(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    number, pulse = command.whole(1), command.whole(2)
    if number not in pilot.payload.servos or pulse not in PULSES:
        return MavResult.FAILED, []
    pilot.payload.servos[number] = pulse
    return MavResult.ACCEPTED, []


def _actuators(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    """Sets PX4's actuators: six outputs from -1 to 1, NaN keeps one; 1000 to 2000 us."""
    for number in range(1, 7):
        value = command.optional(number)
        if value is not None and -1.0 <= value <= 1.0:
            pilot.payload.servos[number] = round(1500 + 500 * value)
    return MavResult.ACCEPTED, []


def _relay(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    number, state = command.whole(1), command.whole(2)
    if number not in pilot.payload.relays or state not in (0, 1):
        return MavResult.FAILED, []
    pilot.payload.relays[number] = bool(state)
    return MavResult.ACCEPTED, []


def _gripper(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    action = command.whole(2)
    if action not in (dialect.GRIPPER_ACTION_RELEASE, dialect.GRIPPER_ACTION_GRAB):
        return MavResult.FAILED, []
    pilot.payload.gripped = action == dialect.GRIPPER_ACTION_GRAB
    pilot.say("Gripper load grabbed" if pilot.payload.gripped else "Gripper load released")
    return MavResult.ACCEPTED, []


def _winch(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    action, length, rate = command.whole(2), command.optional(3), command.optional(4) or 0.0
    if action == dialect.WINCH_RELAXED:
        pilot.payload.wind(0.0)
    elif action == dialect.WINCH_RELATIVE_LENGTH_CONTROL and length is not None:
        pilot.payload.wind_by(length, rate)
    elif action == dialect.WINCH_RATE_CONTROL:
        pilot.payload.wind(rate)
    else:
        return MavResult.FAILED, []
    return MavResult.ACCEPTED, []


def _digicam(pilot: Autopilot, place: GeoOrigin, command: MavCommand) -> CommandAnswer:
    return _capture(pilot, place, command) if command.whole(5) == 1 else (MavResult.ACCEPTED, [])


def _capture(pilot: Autopilot, place: GeoOrigin, command: MavCommand) -> CommandAnswer:
    """Triggers the camera by the autopilot, which reports the place."""
    pilot.payload.camera.set_mode(IMAGE)
    series = command.number == dialect.MAV_CMD_IMAGE_START_CAPTURE
    interval, count = (command.value(2), command.whole(3)) if series else (0.0, 1)
    result = pilot.payload.camera.shoot(pilot.now, interval, count)
    return result, [camera_feedback(pilot, place)] if result is MavResult.ACCEPTED else []


def _stop_capture(pilot: Autopilot, _: GeoOrigin, __: MavCommand) -> CommandAnswer:
    return pilot.payload.camera.stop_shooting(), []


def _record(pilot: Autopilot, _: GeoOrigin, command: MavCommand) -> CommandAnswer:
    camera = pilot.payload.camera
    if command.number == dialect.MAV_CMD_VIDEO_STOP_CAPTURE:
        return camera.stop_recording(), []
    camera.set_mode(VIDEO)
    return camera.record(pilot.now), []


EQUIPMENT: Mapping[int, Callable[[Autopilot, GeoOrigin, MavCommand], CommandAnswer]] = {
    dialect.MAV_CMD_DO_SET_RELAY: _relay,
    dialect.MAV_CMD_DO_SET_SERVO: _servo,
    dialect.MAV_CMD_DO_SET_ACTUATOR: _actuators,
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: _digicam,
    dialect.MAV_CMD_DO_GRIPPER: _gripper,
    dialect.MAV_CMD_IMAGE_START_CAPTURE: _capture,
    dialect.MAV_CMD_IMAGE_STOP_CAPTURE: _stop_capture,
    dialect.MAV_CMD_VIDEO_START_CAPTURE: _record,
    dialect.MAV_CMD_VIDEO_STOP_CAPTURE: _record,
    dialect.MAV_CMD_DO_WINCH: _winch,
}
#: Commands of the camera protocol.
CAPTURES = frozenset({
    dialect.MAV_CMD_IMAGE_START_CAPTURE, dialect.MAV_CMD_IMAGE_STOP_CAPTURE,
    dialect.MAV_CMD_VIDEO_START_CAPTURE, dialect.MAV_CMD_VIDEO_STOP_CAPTURE,
})  # fmt: skip
#: Payload required by a command; servos and relays need none.
HARDWARE_OF: Mapping[int, str] = {
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: "camera",
    dialect.MAV_CMD_IMAGE_START_CAPTURE: "camera",
    dialect.MAV_CMD_IMAGE_STOP_CAPTURE: "camera",
    dialect.MAV_CMD_VIDEO_START_CAPTURE: "camera",
    dialect.MAV_CMD_VIDEO_STOP_CAPTURE: "camera",
    dialect.MAV_CMD_DO_GRIPPER: "gripper",
    dialect.MAV_CMD_DO_WINCH: "winch",
}
#: PX4's results for ArduPilot's commands: it refuses outputs by number, and does not answer for a winch.
NOT_OF_PX4: Mapping[int, MavResult | None] = {
    dialect.MAV_CMD_DO_SET_RELAY: MavResult.UNSUPPORTED,
    dialect.MAV_CMD_DO_SET_SERVO: MavResult.UNSUPPORTED,
    dialect.MAV_CMD_DO_WINCH: None,
}
