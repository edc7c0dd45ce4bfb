"""The estimator with failed sensors: drift without GNSS, and the texts for a glitch.

From gauntlet-a, gauntlet-b and facts-3 (2, 3, 4, 20): without GNSS an autopilot continues for some seconds
and always reports a position. Pure: `step` advances time.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from lfield_sim.autopilot.body.goals import ZERO, Vector


class BlindRule(NamedTuple):
    """Behaviour of an autopilot without GNSS.

    lasts       seconds for which the autopilot trusts its estimate
    drift       eastward drift in m/s afterwards
    regains     seconds with GNSS until the autopilot trusts its estimate again
    regained    text for that
    refusal     text for a {mode} that needs a position
    """

    lasts: float
    drift: float = 0.0
    regains: float = 0.0
    regained: str = ""
    refusal: str = ""


#: Seconds from a glitch to each text of an ArduCopter, and from its end to the last one.
GLITCH_TEXTS = (
    (0.4, "EKF3 lane switch 1"),
    (0.4, "EKF primary changed:1"),
    (1.3, "GPS Glitch or Compass error"),
)
GLITCH_ENDS, GLITCH_CLEARED = 6.0, "Glitch cleared"
#: Metres of a glitch that are detected.
GLITCH = 10.0
#: Seconds until a failed compass shows in the sensor health.
COMPASS_SHOWS = 1.5


class Estimator(Struct):
    """The estimator of one vehicle: duration without GNSS, and position error."""

    rule: BlindRule
    blind: float = 0.0
    offset: Vector = ZERO
    drift: Vector = ZERO
    is_lost: bool = False
    compass_ill: float = 0.0
    _glitched: float = 0.0
    _cleared: float = 0.0
    _gnss_time: float = 0.0

    def step(
        self, dt: float, *, gps_lost: bool, glitch: float, compass_failed: bool, reports_glitches: bool
    ) -> list[str]:
        """Advances time by `dt` seconds; returns the texts that are due."""
        self.compass_ill = self.compass_ill + dt if compass_failed else 0.0
        texts = self._update_position(dt, gps_lost=gps_lost)
        return texts + (self._glitch(dt, glitch) if reports_glitches else [])

    def _update_position(self, dt: float, *, gps_lost: bool) -> list[str]:
        if gps_lost:
            self.blind, self._gnss_time = self.blind + dt, 0.0
            self.is_lost = self.is_lost or self.blind > self.rule.lasts
            self.drift = (0.0, self.rule.drift, 0.0) if self.is_lost else ZERO
            north, east, down = (o + d * dt for o, d in zip(self.offset, self.drift, strict=True))
            self.offset = (north, east, down)
            return []
        self.blind, self._gnss_time = 0.0, self._gnss_time + dt
        self.offset = self.drift = ZERO
        if self.is_lost and self._gnss_time >= self.rule.regains:
            self.is_lost = False
            return [self.rule.regained] if self.rule.regained else []
        return []

    def _glitch(self, dt: float, glitch: float) -> list[str]:
        if abs(glitch) >= GLITCH:
            before, self._glitched = self._glitched, self._glitched + dt
            self._cleared = GLITCH_ENDS
            return [text for at, text in GLITCH_TEXTS if before < at <= self._glitched]
        self._glitched = 0.0
        before, self._cleared = self._cleared, max(0.0, self._cleared - dt)
        return [GLITCH_CLEARED] if before > 0.0 == self._cleared else []

    @property
    def has_compass(self) -> bool:
        """Whether the sensor health still includes the compass."""
        return self.compass_ill < COMPASS_SHOWS
