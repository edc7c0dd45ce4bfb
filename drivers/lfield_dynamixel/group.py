"""Servos that move together: the device type `DynamixelGroup`."""

from __future__ import annotations

import math

from lfield_dynamixel.bus import COMMAND
from lfield_dynamixel.members import Seen
from lfield_dynamixel.movers import Movers
from lfield_dynamixel.servo import POSITION_MODES


class DynamixelGroup(Movers):
    """Several servos; arrays are in the order of the ids in the binding."""

    def _tell(self, seen: Seen) -> None:
        def each(quantity: str) -> list[float]:
            return [getattr(seen[n], quantity) if n in seen else math.nan for n in self.servos]

        self.publish(
            positions=each("position"),
            velocities=each("velocity"),
            currents=each("current"),
            temperatures=each("temperature"),
            missing=[number for number in self.servos if number not in seen],
            moving=any(value.moving for value in seen.values()),
        )

    async def do_move_to(self, angles: list[float]) -> None:
        """All turn and arrive together."""
        await self.travel("moveTo", self._by_id("moveTo", angles))

    async def do_set_positions(self, angles: list[float]) -> None:
        """A setpoint for all in one packet, which nobody confirms; a member that is missing is an error."""
        wanted = self._by_id("setPositions", angles)
        self.check_angles("setPositions", wanted)
        self.check_ready("setPositions", POSITION_MODES)
        start = {number: value for number, (_, value) in self._seen.items()}
        await self._send(self.goals(wanted, start), COMMAND)

    def _by_id(self, what: str, angles: list[float]) -> dict[int, float]:
        if len(angles) != len(self.servos):
            raise self.error(f"{what} needs {len(self.servos)} angles, one for each id, not {len(angles)}")
        return dict(zip(self.servos, angles, strict=True))
