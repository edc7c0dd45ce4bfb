"""Components beside the autopilot, with component ids and heartbeats of their own: camera, gimbal device.

https://mavlink.io/en/services/camera.html and https://mavlink.io/en/services/gimbal_v2.html. A component
handles messages that are addressed to it; the autopilot passes them on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.equipment.payload import MAVLINK_CAMERA, MAVLINK_GIMBAL
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import MavCommand
from lfield_sim.mavlink.telemetry import camera_messages, equipment_messages

#: Seconds between two heartbeats, and between two attitudes of a gimbal.
BEAT, ATTITUDE = 1.0, 0.2
#: Pictures whose CAMERA_IMAGE_CAPTURED can be requested again.
REMEMBERED = 1000
#: A result, and the messages that follow it.
Answer = tuple[MavResult, list[Any]]


class Component:
    """One component: `commands` by MAV_CMD, `requests` by message id, answered with one message."""

    number = 0
    mav_type = dialect.MAV_TYPE_GENERIC

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        self.autopilot, self.place = autopilot, place
        self.commands: dict[int, Callable[[MavCommand], Answer]] = {
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request
        }
        self.requests: dict[int, Callable[[MavCommand], Any | None]] = {}
        self._beat_at = 0.0

    def answer(self, command: MavCommand) -> Answer:
        """The result of a command, and the messages that follow it."""
        handler = self.commands.get(command.number)
        return handler(command) if handler else (MavResult.UNSUPPORTED, [])

    def advance(self, now: float) -> list[Any]:
        """Messages for every peer."""
        if now < self._beat_at:
            return []
        self._beat_at = now + BEAT
        return [dialect.MAVLink_heartbeat_message(
            self.mav_type, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
        )]  # fmt: skip

    def _request(self, command: MavCommand) -> Answer:
        make = self.requests.get(command.whole(1))
        message = make(command) if make else None
        return (MavResult.DENIED, []) if message is None else (MavResult.ACCEPTED, [message])


class GimbalDevice(Component):
    """A gimbal with MAVLink, controlled by the manager in the autopilot."""

    number = dialect.MAV_COMP_ID_GIMBAL
    mav_type = dialect.MAV_TYPE_GIMBAL

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._attitude_at = 0.0
        self.requests = {
            dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION: lambda _: self._information(),
            dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: lambda _: self._attitude(),
        }

    def advance(self, now: float) -> list[Any]:
        """The heartbeat and the attitude of the gimbal."""
        messages = super().advance(now)
        if now >= self._attitude_at:
            self._attitude_at = now + ATTITUDE
            messages.append(self._attitude())
        return messages

    def _information(self) -> Any:
        return equipment_messages.gimbal_device_information(self.autopilot, 0)

    def _attitude(self) -> Any:
        # The id in a message of the device itself is 0.
        return equipment_messages.gimbal_device_attitude_status(self.autopilot, 0)


class CameraComponent(Component):
    """A camera with the camera protocol."""

    number = dialect.MAV_COMP_ID_CAMERA
    mav_type = dialect.MAV_TYPE_CAMERA

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._images: dict[int, Any] = {}
        self._state: tuple[object, ...] = ()
        camera = autopilot.payload.camera
        self.commands |= {
            dialect.MAV_CMD_IMAGE_START_CAPTURE: self._shoot,
            dialect.MAV_CMD_IMAGE_STOP_CAPTURE: lambda _: (camera.stop_shooting(), []),
            dialect.MAV_CMD_VIDEO_START_CAPTURE: lambda _: (camera.record(autopilot.now), []),
            dialect.MAV_CMD_VIDEO_STOP_CAPTURE: lambda _: (camera.stop_recording(), []),
            dialect.MAV_CMD_SET_CAMERA_MODE: lambda command: (camera.set_mode(command.whole(2)), []),
        }
        self.requests = {
            dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION: lambda _: camera_messages.information(autopilot),
            dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS: lambda _: camera_messages.settings(autopilot),
            dialect.MAVLINK_MSG_ID_STORAGE_INFORMATION: lambda _: camera_messages.storage(autopilot),
            dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: lambda _: camera_messages.capture_status(autopilot),
            dialect.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED: lambda command: self._images.get(command.whole(2)),
        }

    def advance(self, now: float) -> list[Any]:
        """The heartbeat of the camera, the pictures that were taken, and its state when that changes."""
        camera, messages = self.autopilot.payload.camera, super().advance(now)
        first = camera.pictures - len(camera.shot)
        for index in range(first, camera.pictures):
            image = camera_messages.image_captured(
                self.autopilot, self.place, index, stored=camera.shot.popleft()
            )
            self._images[index] = image
            self._images.pop(index - REMEMBERED, None)
            messages.append(image)
        state = (camera.is_shooting, camera.interval, camera.recording_since, camera.mode)
        if state != self._state:
            self._state = state
            messages.append(camera_messages.capture_status(self.autopilot))
        return messages

    def _shoot(self, command: MavCommand) -> Answer:
        interval, count = command.value(2), command.whole(3)
        if not (math.isfinite(interval) and interval >= 0.0):
            return MavResult.DENIED, []
        camera = self.autopilot.payload.camera
        return camera.shoot(self.autopilot.now, interval, count, command.whole(4)), []


def components_of(autopilot: Autopilot, place: GeoOrigin) -> dict[int, Component]:
    """The components of a vehicle by id."""
    kinds: dict[str, type[Component]] = {MAVLINK_CAMERA: CameraComponent, MAVLINK_GIMBAL: GimbalDevice}
    fitted = autopilot.payload.fitted
    found = [kind(autopilot, place) for name, kind in kinds.items() if name in fitted]
    return {component.number: component for component in found}
