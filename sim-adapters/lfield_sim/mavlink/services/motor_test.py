"""DO_MOTOR_TEST (209), ArduPilot's: a motor turns for a while, and the vehicle shows as armed meanwhile.

Sent to an armed vehicle on the ground it disarms that, and until a restart every arming is accepted and comes
to nothing. PX4 does not know the command.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import Result
from lfield_sim.mavlink.command import Answer, Command
from lfield_sim.mavlink.geo import Place
from lfield_sim.mavlink.services.service import Service

#: A motor is never tested for longer than this, in seconds.
LONGEST = 600.0


class MotorTest(Service):
    """The motor test of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: Place) -> None:
        super().__init__(autopilot, place)
        self._until: float | None = None
        self.commands = {dialect.MAV_CMD_DO_MOTOR_TEST: self._test}

    def advance(self, now: float) -> list[Any]:
        """End a test whose time is over."""
        if self._until is not None and now >= self._until:
            self._until = None
            self.autopilot.armed = False
            self.autopilot.say("finished motor test")
        return []

    def reboot(self) -> None:
        """Nothing turns any more."""
        self._until = None

    def _test(self, command: Command) -> Answer:
        """param4 are its seconds."""
        pilot = self.autopilot
        if pilot.flavour.submodes:
            return Result.UNSUPPORTED, []
        if pilot.vehicle.airborne:
            pilot.say("Motor Test: vehicle not landed")
            return Result.FAILED, []
        if not pilot.flies and (unfit := pilot.unfit):
            for reason in unfit.reasons or ():
                pilot.say(f"Arm: {reason}")
            return Result.FAILED, []
        pilot.say("starting motor test")
        if pilot.armed and self._until is None:
            pilot.say("Motor Test: cancelled")
            pilot.say("finished motor test")
            pilot.armed, pilot.deaf_to_arming = False, True
            return Result.ACCEPTED, []
        pilot.armed, pilot.armed_at = True, pilot.now
        self._until = pilot.now + min(max(command.value(4), 0.0), LONGEST)
        return Result.ACCEPTED, []
