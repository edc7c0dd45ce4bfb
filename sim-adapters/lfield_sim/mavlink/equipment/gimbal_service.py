"""Gimbal manager of an autopilot, with regions of interest, and the older mount command.

https://mavlink.io/en/services/gimbal_v2.html. ArduPilot accepts commands of every station, PX4 only
those of its primary controller. Without a gimbal PX4 does not answer commands.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.equipment.gimbal import NO_SENDER, Sender
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin, angles
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand
from lfield_sim.mavlink.services.service import MessageBuilder, VehicleService
from lfield_sim.mavlink.telemetry import equipment_messages
from lfield_sim.mavlink.telemetry.equipment_messages import device_of


class GimbalService(VehicleService):
    """Commands and messages of the gimbal of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._px4 = autopilot.flavour.submodes
        self._has_gimbal = autopilot.payload.has_gimbal
        self.commands = {
            dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: self._pitch_yaw,
            dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: self._configure,
            dialect.MAV_CMD_DO_MOUNT_CONTROL: self._mount,
        }
        if self._has_gimbal:
            self._add_gimbal(autopilot)
        else:
            self.requests = {dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self._no_information}

    def _add_gimbal(self, autopilot: Autopilot) -> None:
        device = device_of(autopilot)
        self.commands = {
            **self.commands,
            dialect.MAV_CMD_DO_SET_ROI_LOCATION: self._watch,
            dialect.MAV_CMD_DO_SET_ROI_NONE: self._watch,
        }
        messages: dict[int, MessageBuilder] = {
            dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: partial(
                equipment_messages.gimbal_manager_information, autopilot
            ),
            dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: partial(
                equipment_messages.gimbal_manager_status, autopilot
            ),
        }
        self.handles = {dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE: self._on_set_attitude}
        if not self._px4:
            kind = dialect.MAVLINK_MSG_ID_MOUNT_STATUS
            messages[kind] = partial(equipment_messages.mount_status, autopilot)
        if device == 1:
            messages |= {
                dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION: partial(
                    equipment_messages.gimbal_device_information, autopilot, device
                ),
                dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: partial(
                    equipment_messages.gimbal_device_attitude_status, autopilot, device
                ),
            }
        self.messages = messages

    def _no_information(self) -> list[Any] | None:
        """No information: ArduPilot accepts the request and sends no message."""
        return None if self._px4 else []

    # -- commands -------------------------------------------------------------------------------------

    def _missing(self) -> CommandAnswer:
        return (None if self._px4 else MavResult.FAILED), []

    def _accepts(self, source: Sender) -> bool:
        """Whether the manager accepts commands of a sender; items of missions have none."""
        return not self._px4 or source in (NO_SENDER, self.autopilot.payload.gimbal.primary)

    def _is_own_device(self, device: int) -> bool:
        return device in (0, device_of(self.autopilot))

    def _pitch_yaw(self, command: MavCommand) -> CommandAnswer:
        """Angles in degrees, or rates in deg/s; NaN keeps an angle."""
        if not self._has_gimbal:
            return self._missing()
        if not self._accepts(command.source):
            return MavResult.DENIED, []
        if not self._is_own_device(command.whole(7)):
            return MavResult.FAILED, []
        gimbal = self.autopilot.payload.gimbal
        pitch, yaw, pitch_rate, yaw_rate = map(_radians, map(command.optional, range(1, 5)))
        if pitch is not None or yaw is not None:
            flags = command.whole(5)
            gimbal.point(pitch, yaw, locked=bool(flags & dialect.GIMBAL_MANAGER_FLAGS_YAW_LOCK))
        elif pitch_rate is not None and yaw_rate is not None:
            gimbal.turn(pitch_rate, yaw_rate)
        else:
            return MavResult.FAILED, []
        return MavResult.ACCEPTED, []

    def _configure(self, command: MavCommand) -> CommandAnswer:
        if not self._has_gimbal:
            return self._missing()
        primary = command.whole(1), command.whole(2)
        # ArduPilot has one controller.
        secondary = (command.whole(3), command.whole(4)) if self._px4 else (-1, -1)
        gimbal = self.autopilot.payload.gimbal
        result = gimbal.configure(command.source, primary, secondary)
        status = equipment_messages.gimbal_manager_status(self.autopilot)
        return result, [] if gimbal.is_secret else [status]

    def _watch(self, command: MavCommand) -> CommandAnswer:
        """Sets a region of interest, or ends it."""
        if not self._is_own_device(command.whole(1)):
            return MavResult.FAILED, []
        target = None
        if command.number == dialect.MAV_CMD_DO_SET_ROI_LOCATION:
            target = command.place(self.place, self.autopilot.vehicle.place, self.autopilot.home)
            if target is None:
                return MavResult.DENIED, []
        self.autopilot.payload.gimbal.watch(target)
        return MavResult.ACCEPTED, []

    def _mount(self, command: MavCommand) -> CommandAnswer:
        if not self._has_gimbal or self._px4:
            return self._missing()
        if command.whole(7) != dialect.MAV_MOUNT_MODE_MAVLINK_TARGETING:
            return MavResult.DENIED, []
        self.autopilot.payload.gimbal.point(_radians(command.optional(1)), _radians(command.optional(3)))
        return MavResult.ACCEPTED, []

    # -- messages -------------------------------------------------------------------------------------

    def _on_set_attitude(self, message: Any) -> list[Any]:
        """GIMBAL_MANAGER_SET_ATTITUDE 282: an attitude, or rates where the attitude is NaN."""
        source = message.get_srcSystem(), message.get_srcComponent()
        if not (self._accepts(source) and self._is_own_device(message.gimbal_device_id)):
            return []
        gimbal = self.autopilot.payload.gimbal
        rates = message.angular_velocity_y, message.angular_velocity_z
        if all(map(math.isfinite, message.q)):
            _, pitch, yaw = angles(*message.q)
            gimbal.point(pitch, yaw, locked=bool(message.flags & dialect.GIMBAL_MANAGER_FLAGS_YAW_LOCK))
        elif all(map(math.isfinite, rates)):
            gimbal.turn(*rates)
        return []


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)
