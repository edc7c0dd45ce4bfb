"""Actuators of a vehicle: gripper, winch, servos, relays.

Each has its own channel, so that it works during a flight. The call waits for a message with the state if
there is one; otherwise the accepted command is all that is known, as the manifest says.
"""

from __future__ import annotations

import math
from typing import Any

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.progress import Progress
from lfield_mavlink.payload.state_reports import RELAYS, SERVOS, WINCH, StateReports
from lfield_mavlink.setpoints.motion_orders import ProgressPatience

#: Pulse of a servo in microseconds: centre, and range to each side.
PULSE_MIDDLE, PULSE_RANGE = 1500.0, 500.0
#: Tolerance of a winch in metres.
LINE_TOLERANCE = 0.1
#: Seconds for which a line may not move, and the longest winding.
STUCK_TIME, LONGEST_WINDING = 10.0, 3600.0


class Actuators:
    """Instructions of the actuators."""

    def __init__(self, vehicle: Contact, reports: StateReports) -> None:
        self._vehicle, self._reports = vehicle, reports
        vehicle.on(WINCH, self._on_winch)

    def _on_winch(self, message: Any) -> None:
        if math.isfinite(message.line_length):
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
        if abs(length) > LONGEST_WINDING * speed:
            raise self._vehicle.error(
                f"winch refused: {length:g} m at {speed:g} m/s take longer than {LONGEST_WINDING:g} s"
            )
        report = await self._reports.request(WINCH)
        relative = float(dialect.WINCH_RELATIVE_LENGTH_CONTROL)
        await self._vehicle.command(
            "winch", dialect.MAV_CMD_DO_WINCH, 1.0, relative, length, speed, once=True, component="winch"
        )
        if report is not None:
            await self._winding(report.line_length + length, speed)

    async def _winding(self, goal: float, speed: float) -> None:
        """Waits until so much line is out. Raises DeviceError for one that does not move, as at its end."""
        clock, patience = self._vehicle.clock, ProgressPatience(STUCK_TIME, closer=LINE_TOLERANCE)
        progress = Progress(patience, clock.monotonic())

        def is_out(report: Any) -> bool:
            remaining: float = abs(report.line_length - goal)
            if progress.is_over(remaining, False, clock.monotonic(), speed):
                problem = patience.message.format(seconds=patience.bound(False, speed), left=remaining)
                raise self._vehicle.error(f"winch failed: {problem}")
            return remaining <= LINE_TOLERANCE

        await self._reports.confirm("winch", WINCH, is_out, 2.0 * LONGEST_WINDING)

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
            values: list[float | None] = [None] * 6
            values[number - 1] = position
            await self._vehicle.command("setServo", dialect.MAV_CMD_DO_SET_ACTUATOR, *values, 0.0)
            return
        pulse = round(PULSE_MIDDLE + PULSE_RANGE * position)
        await self._vehicle.command("setServo", dialect.MAV_CMD_DO_SET_SERVO, float(number), float(pulse))
        await self._reports.confirm(
            "setServo",
            SERVOS,
            lambda report: getattr(report, f"servo{number}_raw") == pulse,
        )

    async def do_set_relay(self, number: int, on: bool) -> None:
        """Switches a relay, counted from 0."""
        if not 0 <= number <= 15:
            raise self._vehicle.error("setRelay requires a number from 0 to 15")
        await self._vehicle.command("setRelay", dialect.MAV_CMD_DO_SET_RELAY, float(number), float(on))
        await self._reports.confirm(
            "setRelay",
            RELAYS,
            lambda report: bool(report.on >> number & 1) == on,
        )
