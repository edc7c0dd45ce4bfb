"""DO_MOTOR_TEST (209) of ArduPilot: a motor turns for a while, and the vehicle reports armed meanwhile.

On an armed vehicle on the ground, the command disarms, and until a restart every arming is accepted without
effect. PX4 does not support the command.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand
from lfield_sim.mavlink.services.service import VehicleService

#: Maximum duration of a motor test in seconds.
LONGEST = 600.0


class MotorTest(VehicleService):
    """The motor test of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._until: float | None = None
        self.commands = {dialect.MAV_CMD_DO_MOTOR_TEST: self._test}

    def advance(self, now: float) -> list[Any]:
        """Ends a test whose time is over."""
        if self._until is not None and now >= self._until:
            self._until = None
            self.autopilot.armed = False
            self.autopilot.say("finished motor test")
        return []

    def reboot(self) -> None:
        """Stops the test."""
        self._until = None

    def _test(self, command: MavCommand) -> CommandAnswer:
        """Starts a test; param4 is its duration in seconds."""
        pilot = self.autopilot
        if pilot.flavour.submodes:
            return MavResult.UNSUPPORTED, []
        if pilot.vehicle.airborne:
            pilot.say("Motor Test: vehicle not landed")
            return MavResult.FAILED, []
        if not pilot.flies and (unfit := pilot.unfit):
            for reason in unfit.reasons or ():
                pilot.say(f"Arm: {reason}")
            return MavResult.FAILED, []
        pilot.say("starting motor test")
        if pilot.armed and self._until is None:
            pilot.say("Motor Test: cancelled")
            pilot.say("finished motor test")
            pilot.armed, pilot.ignores_arm = False, True
            return MavResult.ACCEPTED, []
        pilot.armed, pilot.armed_at = True, pilot.now
        self._until = pilot.now + min(max(command.value(4), 0.0), LONGEST)
        return MavResult.ACCEPTED, []
