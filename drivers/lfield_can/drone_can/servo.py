"""A servo of a DroneCAN node: uavcan.equipment.actuator.ArrayCommand, confirmed by its Status."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from typing import Any

from lfield.driver import DeviceError
from lfield_can import log_messages
from lfield_can.drone_can.messages import ACTUATOR_COMMAND, ACTUATOR_STATUS, POSITION, Values, encode
from lfield_can.drone_can.node_device import DroneCanDevice
from lfield_can.timing import MoveProgress, PeriodicTask

#: Keys from here on are actuators, not frames.
ACTUATOR = 1 << 33
#: Seconds until a safe state has failed, and for a servo to stop.
SAFE_TIMEOUT, HALT_TIMEOUT = 5.0, 5.0
#: Seconds without progress after which a move has failed, and the least progress in rad.
STUCK_TIME, MIN_PROGRESS = 2.0, 1e-3
#: Rounding of a bound, in rad: positions have 11 bits.
ROUNDING = 1e-3


class DroneCanServo(DroneCanDevice):
    """One servo. Its position is sent every `period` as long as the guard works: while a setpoint lives, and
    in a safe state. When the host is silent and the servo at rest, nothing is sent.
    """

    reported = ACTUATOR_STATUS

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._goal: float | None = None
        self._stream = PeriodicTask(self.clock)
        self._is_quiet = False

    def commands(self) -> frozenset[int]:
        """The actuator, which every node with this index would follow."""
        return frozenset({self.binding.option("index") | ACTUATOR})

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops the stream of positions, which would keep the servo from its own failsafe."""
        self._is_quiet = is_quiet
        if is_quiet:
            self._stream.stop()
        elif self._goal is not None:
            self._stream.resume()

    def close(self) -> None:
        """The driver ends."""
        self._stream.stop()

    def measured(self, values: Values) -> Mapping[str, object]:
        """The telemetry of a servo. Force is a torque; a load of 127 is unknown."""
        names = {"position": "position", "speed": "speed", "force": "torque"}
        telemetry = {name: values[key] for key, name in names.items() if key in values}
        return {**telemetry, **({"load": values["power"] / 100.0} if values["power"] <= 100 else {})}

    async def on_recovery(self) -> None:
        """Commands the safe state: the motion of the servo during the loss is unknown."""
        try:
            await self.make_safe()
        except DeviceError as error:
            self.note(log_messages.NOT_SAFE.line(reason=error.reason))

    # -- safe states --------------------------------------------------------------------------------------

    async def _make_safe(self, state: str) -> None:
        start = self.clock.monotonic()
        if state == "rest":
            goal: float = self.binding.option("rest")
            self._command(goal, math.inf)
        else:
            goal = self._hold()
        if not await self.changes.wait_for(
            lambda: self._is_at(goal) and self.clock.monotonic() - start > self.silence, SAFE_TIMEOUT
        ):
            if self.silence > self.max_silence:
                raise self.contact_error()
            raise self.error(f"the safe state {state} is not confirmed ({self._state_text()})")

    def _moving(self) -> str:
        if self.silence > self.max_silence:
            return f"no message for {self.silence:.1f} s"
        return "" if self._is_still else self._state_text()

    @property
    def _is_still(self) -> bool:
        slowest: float = self.binding.option("standstill")
        return abs(self.values.get("speed", math.inf)) <= slowest

    def _is_at(self, goal: float) -> bool:
        tolerance: float = self.binding.option("tolerance")
        return self._is_still and abs(self.values.get("position", math.inf) - goal) <= tolerance

    def _state_text(self) -> str:
        position, speed = self.values.get("position", math.nan), self.values.get("speed", math.nan)
        return f"at {position:.3f} rad, turning at {speed:.2g} rad/s"

    # -- instructions -------------------------------------------------------------------------------------

    async def do_set_position(self, position: float) -> None:
        """Sends a position setpoint."""
        self._check("setPosition", position)
        self._command(position, self.binding.ttl)

    async def do_move_to(self, position: float) -> None:
        """Moves the servo; done when it is at rest at its goal."""
        self._check("moveTo", position)
        self._command(position, math.inf)
        progress = MoveProgress(self.clock, STUCK_TIME, MIN_PROGRESS)
        while not self._is_at(position):
            if self.silence > self.max_silence:
                self._hold()  # raises DeviceError
            distance = abs(position - self.values.get("position", math.inf))
            if failure := progress.failure(distance):
                self._hold()  # Without it the motion continues when the obstacle is gone.
                raise self.error(failure)
            await self.changes.wait_change(0.1)

    async def do_halt(self) -> None:
        """Holds the present position; done when the servo is at rest."""
        self._hold()
        await asyncio.sleep(0.0)
        if not await self.changes.wait_for(lambda: self._is_still, HALT_TIMEOUT):
            raise self.error(f"halt: it is still moving after {HALT_TIMEOUT:g} s ({self._state_text()})")

    def _check(self, instruction: str, position: float) -> None:
        lowest, highest = self.binding.option("lowest"), self.binding.option("highest")
        if not lowest - ROUNDING <= position <= highest + ROUNDING:
            raise self.error(f"{instruction}({position:g}) is outside {lowest:g} to {highest:g} rad")
        if self.silence > self.max_silence:
            raise self.contact_error()
        if self.has_conflict:
            raise self.error(f"{instruction} refused: two nodes have id {self.node}; give each its own")

    def _hold(self) -> float:
        """Commands the present position of the servo, and returns it.

        An older position would move the servo back. Then no frame is sent, so that its own failsafe acts, and
        DeviceError is raised.
        """
        position = self.values.get("position")
        if position is None or self.silence > self.max_silence:
            self._stream.stop()
            self._goal = None
            raise self.contact_error() if position is not None else self.error("its position is unknown")
        self._command(position, math.inf)
        return position

    def _command(self, goal: float, duration: float) -> None:
        """Sends a position now and every period, for `duration` seconds."""
        self._goal = goal
        self._send()
        self._stream.start(self.binding.option("period"), self._send, duration=duration)
        if self._is_quiet:
            self._stream.stop()

    def _send(self) -> None:
        assert self._goal is not None
        values = {"index": self.binding.option("index"), "command_type": POSITION, "value": self._goal}
        self.network.broadcast(ACTUATOR_COMMAND, encode(ACTUATOR_COMMAND, values))
