"""The stream of setpoints to one vehicle: PX4 leaves OFFBOARD when none comes for a while."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.driver import Clock
from lfield_mavlink.geo import Vector
from lfield_mavlink.setpoints.trajectory import Target, Trajectory

#: Seconds between two setpoints of a stream; PX4 needs more than 2 per second.
PERIOD = 0.05


class SetpointStream:
    """Repeats one setpoint until a time and never past it, or follows a trajectory until it is stopped.

    `send` sends a setpoint, `motion` tells where the vehicle is (None: not known) and its velocity, and
    `is_wanted` whether a trajectory is still to be followed; once it is not, the stream stops by itself.
    """

    def __init__(
        self,
        clock: Clock,
        send: Callable[[Target], None],
        motion: Callable[[], tuple[Vector | None, Vector]] = lambda: (None, (0.0, 0.0, 0.0)),
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._clock, self._send, self._motion, self._is_wanted = clock, send, motion, is_wanted
        self._timer: asyncio.TimerHandle | None = None
        self._last: tuple[Target, float] | None = None
        #: What is followed, None while nothing is.
        self.trajectory: Trajectory | None = None

    def start(self, target: Target, until: float) -> None:
        """Send a setpoint now and on until `until` (on the clock), in place of what was sent before."""
        self.stop()
        self._last = target, until
        self._continue()

    def follow(self, trajectory: Trajectory) -> None:
        """Follow a trajectory from now on, in place of what was sent before and without a gap."""
        self.trajectory, self._last = trajectory, None
        if self._timer is None:
            self._continue()

    def stop(self) -> None:
        """Send no more."""
        self.trajectory = self._last = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @property
    def runs(self) -> bool:
        """Whether setpoints are being sent."""
        return self._timer is not None

    def _continue(self) -> None:
        self._timer = None
        now = self._clock.monotonic()
        if self.trajectory is not None:
            if not self._is_wanted():
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
