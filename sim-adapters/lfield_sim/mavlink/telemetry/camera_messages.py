"""Messages of a camera with the camera protocol: https://mavlink.io/en/services/camera.html."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import GeoOrigin, quaternion
from lfield_sim.mavlink.telemetry.equipment_messages import device_of
from lfield_sim.mavlink.telemetry.motion_messages import millis

ABILITIES = (
    dialect.CAMERA_CAP_FLAGS_CAPTURE_VIDEO
    | dialect.CAMERA_CAP_FLAGS_CAPTURE_IMAGE
    | dialect.CAMERA_CAP_FLAGS_HAS_MODES
)
#: Focal length and sensor in millimetres, resolution in pixels.
LENS, SENSOR, PIXELS = 8.8, (13.2, 8.8), (5472, 3648)


def information(autopilot: Autopilot) -> Any:
    """CAMERA_INFORMATION 259."""
    vendor, model = (list(name.ljust(32, b"\0")) for name in (b"lfield", b"simulated camera"))
    gimbal = device_of(autopilot) if autopilot.payload.has_gimbal else 0
    return dialect.MAVLink_camera_information_message(
        millis(autopilot), vendor, model, 1, LENS, *SENSOR, *PIXELS, 0, ABILITIES, 0, b"", gimbal
    )


def settings(autopilot: Autopilot) -> Any:
    """CAMERA_SETTINGS 260: its mode."""
    return dialect.MAVLink_camera_settings_message(millis(autopilot), autopilot.payload.camera.mode)


def storage(autopilot: Autopilot) -> Any:
    """STORAGE_INFORMATION 261, in MiB."""
    camera = autopilot.payload.camera
    return dialect.MAVLink_storage_information_message(
        millis(autopilot), 1, 1, dialect.STORAGE_STATUS_READY, camera.card, camera.used, camera.free,
        100.0, 60.0, dialect.STORAGE_TYPE_SD,
    )  # fmt: skip


def capture_status(autopilot: Autopilot) -> Any:
    """CAMERA_CAPTURE_STATUS 262: 1 is a picture, 2 a pause of a series, 3 a picture of it."""
    camera = autopilot.payload.camera
    status = (2 if camera.interval else 1) if camera.is_shooting else 0
    since = camera.recording_since
    recorded = 0 if since is None else round((autopilot.now - since) * 1000)
    return dialect.MAVLink_camera_capture_status_message(
        millis(autopilot), status, int(since is not None), camera.interval, recorded, camera.free,
        camera.pictures,
    )  # fmt: skip


def image_captured(autopilot: Autopilot, place: GeoOrigin, index: int, *, stored: bool) -> Any:
    """CAMERA_IMAGE_CAPTURED 263."""
    vehicle = autopilot.vehicle
    north, east, down = vehicle.place
    rotation = quaternion(vehicle.roll, vehicle.pitch, vehicle.yaw)
    height, above = round((place.altitude - down) * 1000), round(-down * 1000)
    url = f"DCIM/{index:08d}.JPG".encode()
    return dialect.MAVLink_camera_image_captured_message(
        millis(autopilot), 0, 0, *place.at(north, east), height, above, rotation, index, int(stored), url
    )
