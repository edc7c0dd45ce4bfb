"""Whether the autopilot follows the target that it was sent: what it tells of it is compared. Pure.

POSITION_TARGET_GLOBAL_INT and POSITION_TARGET_LOCAL_NED tell where an autopilot in the mode for setpoints is
going. Any station may send it somewhere else: an ArduCopter follows the last setpoint, whoever sent it, and
tells nobody (gauntlet-a).
"""

from __future__ import annotations

import math
from collections import deque

from lfield_mavlink.geo import Vector

#: Metres over ground and in height between two targets that are not the same.
NEAR, LEVEL = 2.0, 3.0
#: Seconds for which a target may still be followed that another has replaced: packets are late and lost.
LATE = 3.0
#: Seconds in which the first of a series of targets must have been seen.
SEEN = 2.5


class TargetMonitor:
    """The targets of one vehicle in its local frame: those that were sent, and what it tells."""

    def __init__(self, *, level: bool = True) -> None:
        self._level = level
        self._sent: deque[tuple[float, Vector]] = deque()
        # Targets of before, until one of these has been seen: what its fence forbids it ignores.
        self._earlier: list[Vector] = []
        self._began = math.inf
        self._seen = False
        self._strange: tuple[float, Vector] | None = None

    def clear(self) -> None:
        """What it follows from now on is no target that was sent; it may still tell the last ones."""
        self._earlier = [place for _, place in self._sent] or self._earlier
        self._sent.clear()
        self._began, self._seen, self._strange = math.inf, False, None

    def on_sent(self, place: Vector, now: float, rests_at: Vector | None) -> None:
        """A position was sent; `rests_at` is where it stops when it has not taken in any yet."""
        if not self._sent:
            self._began = now
            if rests_at is not None:
                self._sent.append((now, rests_at))
        if self._sent and self._sent[-1][1] == place:
            self._sent.pop()
        self._sent.append((now, place))
        while self._seen and len(self._sent) > 1 and self._sent[0][0] < now - LATE:
            self._sent.popleft()

    def on_told(self, place: Vector, now: float) -> None:
        """The autopilot tells its target; a height that is not a number is not told."""
        if not self._sent:
            return
        if self._is_sent(place):
            # Of a goal that is ignored it tells nothing: only the last one shows that they are followed.
            self._seen = self._seen or self._is_near(place, self._sent[-1][1])
        elif (self._seen or now - self._began > SEEN) and self._strange is None:
            self._strange = now, place

    def on_guided(self, now: float) -> float | None:
        """It is still in the mode for setpoints: metres between its target and the one that was sent.

        None while it is the one that was sent, or nothing is known. A target of another mode may be told
        before that mode is.
        """
        if self._strange is None or now <= self._strange[0] or not self._sent:
            return None
        return math.dist(self._strange[1][:2], self._sent[-1][1][:2])

    def _is_sent(self, place: Vector) -> bool:
        earlier = () if self._seen else self._earlier
        return any(self._is_near(place, sent) for sent in (*(each for _, each in self._sent), *earlier))

    def _is_near(self, place: Vector, sent: Vector) -> bool:
        level = self._level and math.isfinite(place[2])
        return math.dist(place[:2], sent[:2]) <= NEAR and (not level or abs(place[2] - sent[2]) <= LEVEL)


class DepartureMonitor:
    """Whether a vehicle goes away from a goal that it was closing in on."""

    #: m/s away, the seconds for which, and the metres farther than before.
    SPEED, LASTS, AWAY = 0.5, 0.6, 3.0

    def __init__(self) -> None:
        self._best = self._last = math.inf
        self._last_at = self._away_at = math.inf

    def is_leaving(self, left: float, now: float) -> bool:
        """A sample of the distance to the goal in metres."""
        took, changed = now - self._last_at, left - self._last
        if took > 0.0 or self._last == math.inf:
            leaves = took > 0.0 and changed > self.SPEED * took
            self._away_at = min(self._away_at, now) if leaves else math.inf
            self._last, self._last_at = left, now
        self._best = min(self._best, left)
        return now - self._away_at >= self.LASTS and left > self._best + self.AWAY
