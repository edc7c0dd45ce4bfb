"""Whether a vehicle still knows where it is: by the fix of its receivers and what its estimator says. Pure.

An ArduCopter without GPS goes on for 8 s as if nothing had happened: mode, position and health are as before,
only the fix is gone (gauntlet-a). Its estimator says so after 6 s (EKF_STATUS_REPORT), PX4's within 5 s
(ESTIMATOR_STATUS). What has never had a fix knows its place by other means, and is not judged.

A vehicle with two receivers is lost when neither has a fix: GPS_RAW_INT is of the first, GPS2_RAW of the
second. A fix that is away for a second is no loss. What is indoors from its start, or flies by a
camera, tells no fix at all, or one that never was three-dimensional: its motions go on.
"""

from __future__ import annotations

import math

#: The least fix that gives a place: three-dimensional.
FIX = 3
#: Seconds since the last word of a fix that are a loss. With six words a second one that is away for a
#: second is back by then, and a loss is thrown within 2 s also where words come 0.5 s late.
LASTS = 1.25
#: Seconds for which a receiver's word counts.
OLD = 4.0
#: EKF_STATUS_REPORT and ESTIMATOR_STATUS: an absolute horizontal position. PX4 has the bit of a constant one
#: whenever it stands.
POSITION = 0x10


class PositionMonitor:
    """The receivers of one vehicle by number, and its estimator."""

    def __init__(self) -> None:
        self._fixes: dict[int, tuple[int, float]] = {}
        # When a receiver had a fix last, infinity before any had one.
        self._fixed_at = math.inf
        self._estimated = self._estimate_lost = False

    def on_fix(self, receiver: int, fix: int, now: float) -> None:
        """A receiver tells its GPS_FIX_TYPE."""
        self._fixes[receiver] = fix, now
        if fix >= FIX:
            self._fixed_at = now

    def on_estimate(self, flags: int) -> None:
        """The estimator tells its flags."""
        knows = bool(flags & POSITION)
        self._estimate_lost = self._estimated and not knows
        self._estimated = self._estimated or knows

    def restart(self) -> None:
        """The autopilot was switched on anew, or is on the ground: nothing is lost that was not found."""
        self._fixed_at = math.inf
        self._estimated = self._estimate_lost = False

    def lost(self, now: float) -> str:
        """Why it does not know where it is, in words; '' while it does, or never told.

        What a receiver has not said for OLD seconds does not count.
        """
        fresh = [fix for fix, at in self._fixes.values() if now - at <= OLD]
        if now - self._fixed_at >= LASTS and fresh and max(fresh) < FIX:
            return f"its GPS has no fix any more (GPS_FIX_TYPE {max(fresh)})"
        return "its estimator has no position any more" if self._estimate_lost else ""
