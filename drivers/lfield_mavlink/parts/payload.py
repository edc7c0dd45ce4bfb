"""Payload of a vehicle: gripper, winch, servos, relays, camera, gimbal.

Each has its own channel, so that it works during a flight. The call waits for a message with the state if
there is one; otherwise the accepted command is all that is known, as the manifest says.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from lfield_mavlink.contact.contact import STATE_TIMEOUT, Contact
from lfield_mavlink.link.dialect import dialect

# Messages with the state of a payload.
WINCH, SERVOS = dialect.MAVLINK_MSG_ID_WINCH_STATUS, dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
RELAYS, GIMBAL = (
    dialect.MAVLINK_MSG_ID_RELAY_STATUS,
    dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
)
#: Pulse of a servo in microseconds: centre, and range to each side.
PULSE_MIDDLE, PULSE_RANGE = 1500.0, 500.0
#: Tolerance of a winch in metres and of a gimbal in radians.
LINE_TOLERANCE, GIMBAL_TOLERANCE = 0.1, math.radians(3.0)
#: Seconds within which a winch must finish.
WINDING = 10.0


class Payload:
    """Payload instructions."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        self._shown: dict[int, Any] = {}
        for kind in (WINCH, SERVOS, RELAYS, GIMBAL):
            vehicle.on(kind, self._on_shown)

    def _on_shown(self, message: Any) -> None:
        self._shown[message.get_msgId()] = message
        if message.get_msgId() == WINCH and math.isfinite(message.line_length):
            self._vehicle.publish(winchLine=message.line_length)

    # -- gripper --------------------------------------------------------------------------------------

    async def do_close_gripper(self) -> None:
        await self._vehicle.command(
            "closeGripper", dialect.MAV_CMD_DO_GRIPPER, 1.0, dialect.GRIPPER_ACTION_GRAB, component="gripper"
        )

    async def do_open_gripper(self) -> None:
        await self._vehicle.command(
            "openGripper",
            dialect.MAV_CMD_DO_GRIPPER,
            1.0,
            dialect.GRIPPER_ACTION_RELEASE,
            component="gripper",
        )

    # -- winch ----------------------------------------------------------------------------------------

    async def do_winch(self, length: float, speed: float) -> None:
        """Pays line out (above 0) or in (below 0), at a speed."""
        if not (math.isfinite(length) and math.isfinite(speed) and speed > 0.0):
            raise self._vehicle.error("winch requires a finite length and a speed above 0")
        before = await self._request(WINCH)
        relative = float(dialect.WINCH_RELATIVE_LENGTH_CONTROL)
        await self._vehicle.command(
            "winch", dialect.MAV_CMD_DO_WINCH, 1.0, relative, length, speed, once=True, component="winch"
        )
        if before is not None:
            goal, bound = before.line_length + length, abs(length) / speed + WINDING
            await self._shows(
                "winch", WINCH, lambda now: abs(now.line_length - goal) <= LINE_TOLERANCE, bound
            )

    async def do_stop_winch(self) -> None:
        """Holds the line: a speed of 0, since a relaxed winch releases it."""
        rate = float(dialect.WINCH_RATE_CONTROL)
        await self._vehicle.command(
            "stopWinch", dialect.MAV_CMD_DO_WINCH, 1.0, rate, 0.0, 0.0, component="winch"
        )

    # -- servos and relays ----------------------------------------------------------------------------

    async def do_set_servo(self, number: int, position: float) -> None:
        """Moves a servo to -1..1 of its range; ArduPilot counts outputs, PX4 the actuators of set 1."""
        if not (1 <= number <= 16 and abs(position) <= 1.0):
            raise self._vehicle.error("setServo requires a number from 1 to 16 and a position from -1 to 1")
        if self._vehicle.profile.px4:
            if number > 6:
                raise self._vehicle.error("setServo requires a number from 1 to 6 on PX4")
            others: list[float | None] = [None] * 6
            others[number - 1] = position
            await self._vehicle.command("setServo", dialect.MAV_CMD_DO_SET_ACTUATOR, *others, 0.0)
            return
        pulse = round(PULSE_MIDDLE + PULSE_RANGE * position)
        await self._vehicle.command("setServo", dialect.MAV_CMD_DO_SET_SERVO, float(number), float(pulse))
        await self._shows(
            "setServo",
            SERVOS,
            lambda now: getattr(now, f"servo{number}_raw") == pulse,
        )

    async def do_set_relay(self, number: int, on: bool) -> None:
        """Switches a relay, counted from 0."""
        if not 0 <= number <= 15:
            raise self._vehicle.error("setRelay requires a number from 0 to 15")
        await self._vehicle.command("setRelay", dialect.MAV_CMD_DO_SET_RELAY, float(number), float(on))
        await self._shows(
            "setRelay",
            RELAYS,
            lambda now: bool(now.on >> number & 1) == on,
        )

    # -- camera and gimbal ----------------------------------------------------------------------------

    async def do_trigger_camera(self) -> None:
        """Takes one picture by the camera protocol, or by the older command."""
        capture, older = dialect.MAV_CMD_IMAGE_START_CAPTURE, dialect.MAV_CMD_DO_DIGICAM_CONTROL
        camera = partial(self._vehicle.command, "triggerCamera", once=True, component="camera")
        if not await camera(capture, 0.0, 0.0, 1.0, optional=True):
            await camera(older, 0.0, 0.0, 0.0, 0.0, 1.0)

    async def do_point_gimbal(self, pitch: float, yaw: float) -> None:
        """Points the gimbal, in radians: pitch above the horizon, yaw clockwise from the nose."""
        if not (abs(pitch) <= math.pi and abs(yaw) <= math.pi):
            raise self._vehicle.error("pointGimbal requires angles from -pi to pi")
        degrees = (math.degrees(pitch), math.degrees(yaw))
        manager, mount = dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, dialect.MAV_CMD_DO_MOUNT_CONTROL
        values = (*degrees, None, None, 0.0, None, 0.0)
        gimbal = partial(self._vehicle.command, "pointGimbal", component="gimbal")
        if not await gimbal(manager, *values, optional=True):
            targeting = float(dialect.MAV_MOUNT_MODE_MAVLINK_TARGETING)
            older = (degrees[0], 0.0, degrees[1], 0.0, 0.0, 0.0, targeting)
            await gimbal(mount, *older)
        await self._shows("pointGimbal", GIMBAL, lambda now: _points(now.q, pitch, yaw))

    # -- what shows it --------------------------------------------------------------------------------

    async def _request(self, kind: int) -> Any | None:
        """Requests a message of this kind; None when the autopilot does not send it."""
        self._shown.pop(kind, None)
        answer = await self._vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, float(kind))
        if answer.result == dialect.MAV_RESULT_ACCEPTED:
            await self._vehicle.wait_for(lambda: kind in self._shown, 0.5)
        return self._shown.get(kind)

    async def _shows(
        self, what: str, kind: int, agrees: Callable[[Any], bool], bound: float = STATE_TIMEOUT
    ) -> None:
        """Waits until a message confirms it; returns at once if the autopilot does not send that message."""
        end = self._vehicle.clock.monotonic() + bound
        message = await self._request(kind)
        if message is None:
            return
        while message is None or not agrees(message):
            if self._vehicle.clock.monotonic() >= end:
                raise self._vehicle.error(f"{what} was accepted but did not happen within {bound:.1f} s")
            self._vehicle.check_link()
            await asyncio.sleep(0.1)
            message = await self._request(kind)


def _points(quaternion: Sequence[float], pitch: float, yaw: float) -> bool:
    """Whether a gimbal's attitude is this pitch and yaw, within GIMBAL_TOLERANCE."""
    w, x, y, z = quaternion
    if not all(map(math.isfinite, quaternion)):
        return False
    now_pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    now_yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    off = (now_pitch - pitch, math.remainder(now_yaw - yaw, math.tau))
    return max(map(abs, off)) <= GIMBAL_TOLERANCE
