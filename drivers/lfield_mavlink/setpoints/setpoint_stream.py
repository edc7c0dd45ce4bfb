"""The setpoint stream of one vehicle: PX4 leaves OFFBOARD when it stops."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.driver import Clock
from lfield_mavlink.geodesy import Vector
from lfield_mavlink.setpoints.trajectory import Target, Trajectory

#: Seconds between two setpoints of a stream; PX4 needs more than 2 per second.
PERIOD = 0.05


class SetpointStream:
    """Repeats one setpoint until a deadline, or follows a trajectory until it is stopped.

    `send` sends a setpoint, `motion` returns the vehicle's position (None: unknown) and velocity, and
    `is_needed` whether a trajectory still applies; otherwise the stream stops.
    """

    def __init__(
        self,
        clock: Clock,
        send: Callable[[Target], None],
        motion: Callable[[], tuple[Vector | None, Vector]] = lambda: (None, (0.0, 0.0, 0.0)),
        is_needed: Callable[[], bool] = lambda: True,
    ) -> None:
        self._clock, self._send, self._motion, self._is_needed = clock, send, motion, is_needed
        self._timer: asyncio.TimerHandle | None = None
        self._last: tuple[Target, float] | None = None
        #: The trajectory, None without one.
        self.trajectory: Trajectory | None = None

    def start(self, target: Target, until: float) -> None:
        """Sends a setpoint now and until `until` (on the clock), replacing the previous one."""
        self.stop()
        self._last = target, until
        self._continue()

    def follow(self, trajectory: Trajectory) -> None:
        """Follows a trajectory from now on, replacing the previous setpoint without a gap."""
        self.trajectory, self._last = trajectory, None
        if self._timer is None:
            self._continue()

    def stop(self) -> None:
        """Stops sending."""
        self.trajectory = self._last = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @property
    def is_running(self) -> bool:
        """Whether setpoints are being sent."""
        return self._timer is not None

    def _continue(self) -> None:
        self._timer = None
        now = self._clock.monotonic()
        if self.trajectory is not None:
            if not self._is_needed():
                self.stop()
                return
            self._send(self.trajectory.target(now, *self._motion()))
        elif self._last is not None:
            target, until = self._last
            if now >= until:
                return
            self._send(target)
            if now + PERIOD >= until:
                return
        self._timer = asyncio.get_running_loop().call_later(PERIOD, self._continue)
