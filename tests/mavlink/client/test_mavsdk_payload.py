"""Gimbals and cameras of the fake with MAVSDK's plugins, against a process, in real time."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import scenario
from mavsdk.asyncio.plugins.camera import CameraAsync
from mavsdk.asyncio.plugins.gimbal import GimbalAsync
from mavsdk.plugins.camera import CameraError, CameraResult, Mode
from mavsdk.plugins.gimbal import ControlMode, GimbalError, GimbalMode, GimbalResult, SendMode
from test_mavsdk_client import ALTITUDE, BOTH, LATITUDE, LONGITUDE, fly, until

pytestmark = [pytest.mark.process, pytest.mark.long]

#: ArduPilot's gimbal is connected to outputs, PX4's has a component id.
FITTED = {"ardupilot": "gimbal,mavlink_camera", "px4": "mavlink_gimbal,mavlink_camera"}
CAMERA = 100


def points(pitch, yaw):
    def check(attitude):
        angles = attitude.euler_angle_forward
        return abs(angles.pitch_deg - pitch) < 1.0 and abs(angles.yaw_deg - yaw) < 1.0

    return check


@pytest.mark.few(0)
@BOTH
def test_a_gimbal_is_found_controlled_and_pointed(flavour):
    async def steps(c):
        gimbal = GimbalAsync(c.system)
        found = await until(gimbal.subscribe_gimbal_list(), lambda listed: listed.gimbals)
        (item,) = found.gimbals
        assert (item.gimbal_manager_component_id, item.gimbal_device_id) == (
            1,
            {"ardupilot": 1, "px4": 154}[flavour],
        )
        assert item.model_name == "simulated gimbal"
        aim = item.gimbal_id, 0.0, -45.0, 30.0, GimbalMode.YAW_FOLLOW
        if flavour == "px4":
            with pytest.raises(GimbalError) as refused:
                await gimbal.set_angles(*aim, SendMode.ONCE)
            assert refused.value.result == GimbalResult.ERROR
        control = asyncio.create_task(
            until(gimbal.subscribe_control_status(), lambda s: s.control_mode == ControlMode.PRIMARY)
        )
        await asyncio.sleep(0)
        await gimbal.take_control(item.gimbal_id, ControlMode.PRIMARY)
        await control
        await gimbal.set_angles(*aim, SendMode.ONCE)
        await until(gimbal.subscribe_attitude(), points(-45.0, 30.0))
        await gimbal.set_angles(item.gimbal_id, 0.0, -10.0, 60.0, GimbalMode.YAW_LOCK, SendMode.STREAM)
        await until(gimbal.subscribe_attitude(), points(-10.0, 60.0))
        await gimbal.set_roi_location(item.gimbal_id, LATITUDE, LONGITUDE + 1e-3, ALTITUDE)
        # MAVSDK sends an altitude relative to home.
        await until(gimbal.subscribe_attitude(), lambda a: abs(a.euler_angle_forward.yaw_deg - 90.0) < 1.0)
        await gimbal.set_angular_rates(item.gimbal_id, 0.0, -20.0, 0.0, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
        await until(gimbal.subscribe_attitude(), lambda a: a.euler_angle_forward.pitch_deg < -40.0)
        await gimbal.release_control(item.gimbal_id)

    fly(steps, flavour, "--fitted", FITTED[flavour])


@pytest.mark.few(0)
@BOTH
def test_a_camera_takes_pictures_series_and_videos(flavour):
    async def steps(c):
        camera = CameraAsync(c.system)
        found = await until(camera.subscribe_camera_list(), lambda listed: listed.cameras)
        (item,) = found.cameras
        assert (item.component_id, item.model_name) == (CAMERA, "simulated camera")
        await camera.set_mode(CAMERA, Mode.PHOTO)
        third = asyncio.create_task(until(camera.subscribe_capture_info(), lambda image: image.index == 2))
        await asyncio.sleep(0)
        await camera.take_photo(CAMERA)
        await asyncio.sleep(0.5)
        await camera.start_photo_interval(CAMERA, 0.5)
        image = await third
        assert image.is_success
        assert image.position.latitude_deg == pytest.approx(LATITUDE, abs=1e-4)
        await camera.stop_photo_interval(CAMERA)
        await camera.set_mode(CAMERA, Mode.VIDEO)
        with pytest.raises(CameraError) as refused:
            await camera.take_photo(CAMERA)
        assert refused.value.result == CameraResult.DENIED
        await camera.start_video(CAMERA)
        update = await until(camera.subscribe_storage(), lambda update: update.storage.video_on)
        assert 0.0 < update.storage.available_storage_mib < update.storage.total_storage_mib
        await camera.stop_video(CAMERA)

    fly(steps, flavour, "--fitted", FITTED[flavour])


@pytest.mark.few(0)
@scenario(fly, "px4", "--fitted", FITTED["px4"], "--fault", "card=1")
async def test_a_full_card_refuses_pictures(c, /):
    camera = CameraAsync(c.system)
    await until(camera.subscribe_camera_list(), lambda listed: listed.cameras)
    with pytest.raises(CameraError) as refused:
        await camera.take_photo(CAMERA)
    assert refused.value.result == CameraResult.ERROR
