"""Detects a lost position by the fix of the receivers and the estimator's flags. Pure.

An ArduCopter without GNSS continues for 8 s with unchanged mode, position and health; only the fix is gone
(gauntlet-a). Its estimator reports it after 6 s (EKF_STATUS_REPORT), PX4's within 5 s (ESTIMATOR_STATUS). A
vehicle that never had a fix navigates by other means and is not monitored.

With two receivers the position is lost when neither has a fix: GPS_RAW_INT is the first, GPS2_RAW the second.
A gap of a second is not a loss. Indoor or camera navigation reports no fix, or never a three-dimensional one:
motions continue.
"""

from __future__ import annotations

import math

#: The least fix with a position: three-dimensional.
FIX = 3
#: Seconds without a fix that are a loss. At six reports a second a gap of one second ends before, and a loss
#: is detected within 2 s even if reports are 0.5 s late.
LASTS = 1.25
#: Seconds for which a receiver's report is valid.
OLD = 4.0
#: EKF_STATUS_REPORT and ESTIMATOR_STATUS: absolute horizontal position. PX4 sets the bit of a constant
#: position at rest.
POSITION = 0x10


class PositionMonitor:
    """The receivers of one vehicle by number, and its estimator."""

    def __init__(self) -> None:
        self._fixes: dict[int, tuple[int, float]] = {}
        # The time when a receiver last had a fix, infinity before the first.
        self._fixed_at = math.inf
        self._estimated = self._estimate_lost = False

    def on_fix(self, receiver: int, fix: int, now: float) -> None:
        """Handles the GPS_FIX_TYPE of a receiver."""
        self._fixes[receiver] = fix, now
        if fix >= FIX:
            self._fixed_at = now

    def on_estimate(self, flags: int) -> None:
        """Handles the flags of the estimator."""
        has_position = bool(flags & POSITION)
        self._estimate_lost = self._estimated and not has_position
        self._estimated = self._estimated or has_position

    def restart(self) -> None:
        """Discards earlier fixes when the autopilot restarted, or is on the ground."""
        self._fixed_at = math.inf
        self._estimated = self._estimate_lost = False

    def lost(self, now: float) -> str:
        """The reason of a lost position; '' while it is known, or was never reported.

        Reports older than OLD seconds are ignored.
        """
        recent = [fix for fix, at in self._fixes.values() if now - at <= OLD]
        if now - self._fixed_at >= LASTS and recent and max(recent) < FIX:
            return f"its GNSS fix is lost (GPS_FIX_TYPE {max(recent)})"
        return "its estimator has lost the position" if self._estimate_lost else ""
