"""Whether the positions that come under one id are those of two axes: they alternate. Pure.

CANSimple has no question that would be answered twice, and no serial number. But two axes that stand apart
send two places in turn, farther from each other than any speed explains. A single frame that does not fit is
a foreign one, or a damaged one, and proves nothing. Two axes at one place cannot be told apart.
"""

from __future__ import annotations

from collections import deque

#: So many returns to a place within so many seconds prove two axes.
PROOF, WITHIN = 6, 1.0
#: Places that are nearer, in turns of the motor, may be one axis.
APART = 0.05


class Alternation:
    """Positions in turns, velocities in turns/s, times in s."""

    def __init__(self) -> None:
        self._last: deque[tuple[float, float, float]] = deque(maxlen=3)
        self._returns: deque[float] = deque(maxlen=PROOF)

    def on_position(self, position: float, velocity: float, now: float) -> None:
        """One more position."""
        self._last.append((position, velocity, now))
        if len(self._last) < 3:
            return
        (first, _, begun), (between, _, _), (last, _, _) = self._last
        way = max(abs(speed) for _, speed, _ in self._last) * (now - begun)
        there, back = abs(between - first), abs(last - between)
        if min(there, back) > APART + 2.0 * way and abs(last - first) < 0.25 * there:
            self._returns.append(now)

    def is_proved(self, now: float) -> bool:
        """Whether two axes were heard lately."""
        return len(self._returns) == PROOF and now - self._returns[0] <= WITHIN

    @property
    def last_return(self) -> float:
        """When the last position came that did not fit; minus infinity for never."""
        return self._returns[-1] if self._returns else float("-inf")
