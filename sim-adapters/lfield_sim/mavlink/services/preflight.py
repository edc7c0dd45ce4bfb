"""Calibrations and pre-arm checks as seen by clients: results, texts and arming restrictions.

No sensor is calibrated. ArduPilot answers at the end of a calibration, PX4 at its start, followed by texts
about its progress. A calibration that needs manual motion (ArduPilot's accelerometer, PX4's magnetometer and
accelerometer) does not end by itself; the same applies to PX4's barometer, as in its simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import CommandAnswer, DelayedResult, MavCommand
from lfield_sim.mavlink.services.service import VehicleService

#: PREFLIGHT_CALIBRATION: 1-based parameters, and values of the fifth.
GYRO, MAGNETOMETER, PRESSURE, RADIO, ACCELEROMETER = 1, 2, 3, 4, 5
WHOLE, LEVEL, SIMPLE = 1, 2, 4
#: MAV_CMD_RUN_PREARM_CHECKS, DO_START_MAG_CAL and DO_CANCEL_MAG_CAL.
PREARM_CHECKS, MAG_CAL, CANCEL_MAG_CAL = 401, 42424, 42426
#: Seconds of ArduPilot's gyro calibration: copter, rover.
GYRO_TIME, GYRO_TIME_ROVER = 0.5, 2.1
#: PX4's progress: seconds between texts, and the steps in percent of gyro and level.
STEP_TIME = 0.1
STEPS = {"gyro": range(0, 101, 10), "level": range(0, 101, 20)}
#: PX4's texts for a magnetometer that waits to be turned, with seconds after the start.
TURNING: Sequence[tuple[float, str]] = (
    (0.05, "[cal] pending: back front left right up down"),
    (0.1, "[cal] hold vehicle still on a pending side"),
    (1.9, "[cal] detected rest position, hold still..."),
    (2.4, "[cal] down orientation detected"),
    (2.45, "[cal] down orientation detected"),
    (2.5, "[cal] Rotate vehicle"),
)
RADIO_RUNS = "RC calibrating"
REBOOT_NEEDED = "Compass calibrated requires reboot"


class PreflightService(VehicleService):
    """The calibrations and checks of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._running = ""
        self._to_say: list[tuple[float, str]] = []
        self.commands = {
            dialect.MAV_CMD_PREFLIGHT_CALIBRATION: self._calibrate,
            PREARM_CHECKS: self._check,
            MAG_CAL: self._turn_compass,
            CANCEL_MAG_CAL: self._turn_compass,
        }

    def advance(self, now: float) -> list[Any]:
        """The texts that are due; a calibration of PX4 ends with its last text."""
        while self._to_say and now >= self._to_say[0][0]:
            _, text = self._to_say.pop(0)
            self.autopilot.say(text)
            if "calibration done" in text:
                self._end()
        return []

    def reboot(self) -> None:
        """Ends a running calibration."""
        self._to_say.clear()
        self._end()

    def _end(self) -> None:
        self._running, self.autopilot.calibrating = "", False

    def _say_later(self, seconds: float, text: str) -> None:
        self._to_say.append((self.autopilot.now + seconds, text))

    # -- checks ---------------------------------------------------------------------------------------

    def _check(self, _: MavCommand) -> CommandAnswer:
        pilot = self.autopilot
        unfit = pilot.unfit
        reasons = (unfit.reasons or ()) if unfit else ()
        for reason in () if pilot.flavour.submodes else reasons:
            pilot.say(f"PreArm: {reason}")
        return MavResult.ACCEPTED, []

    def _turn_compass(self, command: MavCommand) -> CommandAnswer:
        """Runs ArduPilot's compass calibration: once started, it requires a restart, even if cancelled."""
        pilot = self.autopilot
        if pilot.flavour.submodes:
            return MavResult.UNSUPPORTED, []
        if command.number == CANCEL_MAG_CAL and not pilot.ailing:
            pilot.ailing = REBOOT_NEEDED
            self._say_later(1.6, f"PreArm: {REBOOT_NEEDED}")
        return MavResult.ACCEPTED, []

    # -- calibrations ---------------------------------------------------------------------------------

    def _calibrate(self, command: MavCommand) -> CommandAnswer:
        which = next((n for n in range(1, 8) if command.value(n) != 0.0), 0)
        if self.autopilot.flavour.submodes:
            return self._calibrate_px4(which, command.whole(ACCELEROMETER))
        return self._calibrate_ardupilot(which, command.whole(ACCELEROMETER))

    def _calibrate_ardupilot(self, which: int, kind: int) -> CommandAnswer:
        pilot = self.autopilot
        if pilot.armed:
            pilot.say("Disarm to allow calibration")
            return MavResult.FAILED, []
        busy = GYRO_TIME if pilot.flies else GYRO_TIME_ROVER
        if which == GYRO or (which == ACCELEROMETER and kind == WHOLE and not self._running):
            pilot.say("Initialising ArduPilot")
            if which == ACCELEROMETER:
                self._running = "accel"
                text = "Place vehicle level and press any key."
                self._say_later(busy + 0.06, text)
            return DelayedResult(MavResult.ACCEPTED, busy), []
        if which == ACCELEROMETER and kind in (WHOLE, LEVEL, SIMPLE):
            return (MavResult.TEMPORARILY_REJECTED if self._running else MavResult.ACCEPTED), []
        if which == RADIO and pilot.flies and not pilot.ailing:
            pilot.ailing = RADIO_RUNS
            self._say_later(1.1, f"PreArm: {RADIO_RUNS}")
        elif pilot.ailing == RADIO_RUNS:
            pilot.ailing = ""
        if which == PRESSURE:
            pilot.say("Updating barometer calibration")
            pilot.say("Barometer calibration complete")
            return MavResult.ACCEPTED, []
        return MavResult.UNSUPPORTED, []

    def _calibrate_px4(self, which: int, kind: int) -> CommandAnswer:
        if which == 0:
            return self._cancel()
        if self._running or self.autopilot.armed:
            return MavResult.TEMPORARILY_REJECTED, []
        if which == ACCELEROMETER and kind == SIMPLE:
            return MavResult.ACCEPTED, []
        name = {GYRO: "gyro", MAGNETOMETER: "mag", PRESSURE: "baro", ACCELEROMETER: "accel"}.get(which, "")
        if which == ACCELEROMETER and kind == LEVEL:
            name = "level"
        if not name:
            return MavResult.UNSUPPORTED, []
        self._start_calibration(name)
        return MavResult.ACCEPTED, []

    def _start_calibration(self, name: str) -> None:
        self._running, self.autopilot.calibrating = name, True
        self.autopilot.say(f"[cal] calibration started: 2 {name}")
        steps = STEPS.get(name, ())
        for number, percent in enumerate(steps):
            self._say_later(0.05 + number * STEP_TIME, f"[cal] progress <{percent}>")
        if steps:
            self._say_later(0.06 + len(steps) * STEP_TIME, f"[cal] calibration done: {name}")
        elif name != "baro":
            for seconds, text in TURNING:
                self._say_later(seconds, text)

    def _cancel(self) -> CommandAnswer:
        """Cancels the calibration of a magnetometer; the barometer's continues."""
        if self._running == "baro":
            return MavResult.TEMPORARILY_REJECTED, []
        if self._running:
            self._to_say.clear()
            self._end()
            self.autopilot.say("[cal] calibration cancelled")
        return MavResult.ACCEPTED, []
