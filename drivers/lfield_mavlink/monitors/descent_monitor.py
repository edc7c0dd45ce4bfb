"""Detects falls and crashes of a flying vehicle from telemetry. Pure: samples and times in, findings out.

Thresholds are from recordings. In normal flight ArduCopter and PX4 descend at most 2.0 m/s and tilt at most
31 degrees; with one motor at 60 % an ArduCopter tilted 29 degrees, lost 1 m in 1.1 s at 1.5 m/s, and hit the
ground at 2.7 m/s 4.2 s after the fault (gauntlet-b). After a forced disarm it fell 1.1 m/s within 0.1 s.
"""

from __future__ import annotations

import math
import re
from collections import deque

from msgspec import Struct

#: A fall: metres below the minimum height of a motion, and descent in m/s there.
LOST, SINKS = 1.0, 1.0
#: A fall in any case: descent in m/s, or a share of the autopilot's own descent speed, and more.
FASTEST, SHARE, MORE = 2.6, 1.4, 0.5
#: A descent may be this share of the commanded speed or of the autopilot's own; m/s of that if unknown. So
#: many metres beyond it are a fall.
DESCENDS, UNKNOWN, BEYOND = 1.15, 2.0, 0.6
#: Seconds for which a commanded descent still counts, since a vehicle needs time to brake.
COMMANDED = 1.5
#: Seconds of a fast descent; seconds of being too low with a slow one. In flights without a fault a vehicle
#: was at most 0.4 m too low, and then it climbed.
LASTS, LASTS_LOW = 0.25, 0.5
#: Climb in m/s that counts as a recovery; descent in m/s that may be an error of the estimator, for a
#: commanded velocity without a height to compare with.
CLIMBS, BIAS = 0.1, 0.15
#: Metres of change in height without a speed: home or the estimate has moved, not the vehicle.
JUMPS = 1.0
#: Deceleration at the end of a commanded descent, m/s2.
BRAKES = 1.0
#: Tilt in radians, and its duration in seconds.
TILTS, TILTS_FOR = math.radians(60.0), 0.4
#: An impact: descent in m/s before it (or a share of the autopilot's own landing speed, and more), minimum
#: deceleration in m/s2, and maximum height above home in metres; above it, only rest confirms an impact.
HITS, TOUCHES, HARDER, STOPS, LOW = 2.0, 1.15, 0.25, 6.0, 2.5
#: Longest time between two samples for impacts and falls, in seconds.
GAP = 1.0
#: Descent in m/s without motors that is not a touch-down.
DROPS = 1.5
#: Seconds without a fall after which the vehicle has recovered.
RECOVERS = 1.0
#: Seconds of silence up to which a restart of the clock is not a power cycle by a person on the ground.
SILENT = 10.0

#: Texts of a fall, and of a crash. ArduCopter: thrust_loss_check and crash_check; PX4: its failure detector.
_FALLS = re.compile(
    r"potential thrust loss|motor failure|attitude failure|critical failure detected|flight termination", re.I
)
_CRASHES = re.compile(r"^crash|crash: disarming", re.I)
#: Maximum number of messages (heartbeats, extended states) after a text of a crash that show the motors on.
STALE_MESSAGES = 4
#: Texts that only prevent arming.
_BEFORE = re.compile(r"^(preflight|prearm|arm)\b", re.I)


class Finding(Struct, frozen=True):
    """A fall or crash, in words; after a crash an inspection is required."""

    text: str
    crashed: bool = False


class Expected(Struct, frozen=True):
    """Expected heights of a motion: metres above home, m/s.

    `goal` is its height, infinity for a motion that must not descend, None for one that descends.
    `by_velocity`: the descent speed is commanded repeatedly.
    """

    goal: float | None = None
    by_velocity: bool = False


#: A landing, a return, or a mission.
DESCENT = Expected()


class DescentMonitor:
    """Monitors one vehicle; `falling` and `crashed` are the reasons, '' without one."""

    def __init__(self) -> None:
        self.falling = self.crashed = ""
        #: Messages that may still show the motors on after the vehicle has reported to switch them off.
        self._disarms = 0
        self._expected, self._fastest = DESCENT, FASTEST
        # The autopilot's own descent and landing speeds; commanded descent speeds.
        self._descends, self._lands = UNKNOWN, 0.0
        self._commanded: deque[tuple[float, float]] = deque()
        # Metres of descent beyond what is permitted.
        self._excess = 0.0
        # The minimum height of this motion (None before a sample), and the maximum reached.
        self._floor: float | None = None
        self._highest = -math.inf
        self._last: tuple[float, float, float] | None = None
        # The times since which the vehicle descends too fast, is too low, tilts too far, and has recovered.
        self._sinks_at = self._low_at = self._tilts_at = self._recovering_at = math.inf
        self._tilt = 0.0
        self._pending_impact: Finding | None = None
        self._impact_at = math.inf
        self._armed = self._aloft = False
        # The drop of the vehicle when its motors went off, until a landing is certain.
        self._motors_off_at = -math.inf

    # -- expected motion --------------------------------------------------------------------------------

    def expect(self, expected: Expected) -> None:
        """Starts to monitor a motion with its expected heights."""
        if expected != self._expected:
            self._expected, self._floor, self._highest = expected, None, -math.inf
            self._sinks_at = self._low_at = math.inf
            self._excess = 0.0

    def on_velocity(self, sink: float, now: float) -> None:
        """Handles a commanded velocity, in m/s downwards."""
        self.expect(Expected(by_velocity=True))
        self._commanded.append((now, max(0.0, sink)))
        while self._commanded[0][0] < now - COMMANDED:
            self._commanded.popleft()

    def may_descend(self, speed: float, landing: float) -> None:
        """Sets the autopilot's own descent and landing speeds in m/s, from its parameters; 0 if unknown."""
        self._fastest = max(FASTEST, SHARE * speed + MORE)
        self._descends, self._lands = max(speed, landing) or UNKNOWN, landing

    def clear(self) -> None:
        """Clears the findings after an inspection of the vehicle."""
        self.falling = self.crashed = ""
        self._pending_impact, self._disarms = None, 0

    @property
    def is_undecided(self) -> bool:
        """Whether the motors seem to have gone off in the air and the result is not known yet.

        Also whether the autopilot has reported to disarm after a crash, and its heartbeat does not show that
        yet.
        """
        return self._motors_off_at > -math.inf or self._disarms > 0

    # -- telemetry --------------------------------------------------------------------------------------

    def on_armed(self, armed: bool, *, landed: bool | None, now: float) -> Finding | None:
        """Handles the arming state and a reported landing."""
        was_armed, self._armed = self._armed, armed
        self._disarms = max(0, self._disarms - 1) if armed else 0
        if armed:
            self._aloft = landed is False or (self._aloft and landed is None)
            if self._aloft:
                self._motors_off_at = -math.inf
        elif was_armed and self._aloft:
            # ArduPilot reports a landing whenever its motors are off: only a drop distinguishes a fall.
            self._aloft, self._motors_off_at = False, now
        if not self._aloft:
            # A vehicle at rest does not fall.
            self.falling = self.crashed
        if not armed and now - self._motors_off_at > RECOVERS + GAP:
            self._motors_off_at = -math.inf
        return self._confirmed_impact(landed, now)

    def on_motion(self, height: float, sink: float, now: float, *, is_ours: bool) -> Finding | None:
        """Handles a sample: metres above home, m/s downwards; `is_ours`: this program commands the motion."""
        last, self._last = self._last, (now, height, sink)
        finding = self._drop(height, sink) or self._impact(last, height, sink, now)
        if finding is not None or not (is_ours and self._armed and self._aloft):
            self._sinks_at = self._low_at = math.inf
            return finding
        self._check_height_jump(last, height, sink, now)
        self._move_floor(height, sink)
        self._integrate_excess(height, sink, now, 0.0 if last is None else now - last[0])
        fall_reason, low_reason = self._fall_reason(height, sink, now), self._low_reason(height, sink)
        self._sinks_at = min(self._sinks_at, now) if fall_reason else math.inf
        self._low_at = min(self._low_at, now) if low_reason else math.inf
        if not (fall_reason or low_reason):
            self._recover(sink, now)
            return None
        self._recovering_at = math.inf
        if now - self._sinks_at >= LASTS:
            return self._falls(fall_reason)
        return self._falls(low_reason) if now - self._low_at >= LASTS_LOW else None

    def on_attitude(self, roll: float, pitch: float, now: float, *, is_ours: bool) -> Finding | None:
        """Handles a sample of the attitude, in radians."""
        self._tilt = math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))
        if not self._armed or self._tilt < TILTS:
            self._tilts_at = math.inf
            return None
        self._tilts_at = min(self._tilts_at, now)
        if now - self._tilts_at < TILTS_FOR:
            return None
        description = f"it is tilted by {math.degrees(self._tilt):.0f} degrees"
        last = self._last
        if last is not None and last[1] <= LOW and abs(last[2]) < 0.5:
            return self._crash(f"{description} on the ground, with its motors on")
        return self._falls(description) if is_ours else None

    def on_text(self, text: str) -> Finding | None:
        """Handles a text of the autopilot."""
        if not self._armed and not self._motors_off_at > -math.inf:
            return None
        if _CRASHES.search(text):
            self._disarms = STALE_MESSAGES if self._armed and "disarm" in text.lower() else 0
            return self._crash(f"the autopilot says: {text}")
        if _FALLS.search(text) and not _BEFORE.search(text):
            return self._falls(f"the autopilot says: {text}")
        return None

    def on_restart(self, silent: float) -> Finding | None:
        """Handles a restart of the vehicle's clock after so many seconds without a message."""
        if not (self._armed and self._aloft) or silent > SILENT:
            return None
        self._aloft = False
        return self._crash("its autopilot restarted in the air")

    # -- decisions --------------------------------------------------------------------------------------

    def _check_height_jump(
        self, last: tuple[float, float, float] | None, height: float, sink: float, now: float
    ) -> None:
        """Starts with a new floor after a jump of the height reference."""
        if last is None or now - last[0] > GAP:
            return
        sunk = 0.5 * (last[2] + sink) * (now - last[0])
        if abs(last[1] - sunk - height) > JUMPS:
            self._floor, self._highest = None, -math.inf

    def _move_floor(self, height: float, sink: float) -> None:
        """Raises the floor of a climb with the vehicle up to its goal; an initial descent may be braked."""
        goal = self._expected.goal
        if goal is None:
            return
        if self._floor is None:
            self._floor = height - max(0.0, sink) ** 2 / (2.0 * BRAKES)
        self._highest = max(self._highest, height)
        self._floor = min(goal, max(self._floor, self._highest if sink < SINKS else self._floor))

    def _permitted_descent(self, height: float, now: float) -> float:
        """The permitted descent in m/s."""
        if self._expected.by_velocity:
            return DESCENDS * max(
                (sink for at, sink in self._commanded if at >= now - COMMANDED), default=0.0
            )
        goal = self._expected.goal
        leads_down = goal is None or goal < height - LOST or self._floor is None or self._floor < goal - LOST
        return DESCENDS * self._descends if leads_down else math.inf

    def _integrate_excess(self, height: float, sink: float, now: float, elapsed: float) -> None:
        """Integrates the excessive descent, which is a fall if it continues."""
        permitted = self._permitted_descent(height, now) + (BIAS if self._expected.by_velocity else 0.0)
        self._excess = max(0.0, self._excess + (sink - permitted) * min(elapsed, GAP))

    def _fall_reason(self, height: float, sink: float, now: float) -> str:
        commanded = max((speed for at, speed in self._commanded if at >= now - COMMANDED), default=0.0)
        margin = SINKS if self._expected.by_velocity else MORE
        is_excessive = self._excess > BEYOND and sink > self._permitted_descent(height, now) + margin
        if is_excessive or sink > max(self._fastest, SHARE * commanded + MORE):
            return f"it sinks at {sink:.1f} m/s, {height:.1f} m above home"
        return self._low_reason(height, sink) if sink > SINKS else ""

    def _low_reason(self, height: float, sink: float) -> str:
        """The reason why the vehicle is too low and does not climb, at any speed; '' if it is not."""
        if sink < -CLIMBS:
            return ""
        low = 0.0 if self._floor is None else self._floor - height
        if self._expected.by_velocity:
            low = self._excess
        return f"it falls: {low:.1f} m too low and sinking at {max(0.0, sink):.1f} m/s" if low > LOST else ""

    def _recover(self, sink: float, now: float) -> None:
        if not self.falling or sink > SINKS / 2.0 or self._tilt >= TILTS:
            self._recovering_at = math.inf
            return
        self._recovering_at = min(self._recovering_at, now)
        if now - self._recovering_at >= RECOVERS:
            self.falling = ""

    def _drop(self, height: float, sink: float) -> Finding | None:
        """The crash of a vehicle that falls because its motors went off in the air, if any."""
        if self._motors_off_at == -math.inf or sink < DROPS:
            return None
        self._motors_off_at = -math.inf
        return self._crash(f"its motors went off in the air, {height:.1f} m above home, and it fell")

    def _impact(
        self, last: tuple[float, float, float] | None, height: float, sink: float, now: float
    ) -> Finding | None:
        """Whether a descent ended more abruptly than by braking."""
        if last is None:
            return None
        at, last_height, last_sink = last
        elapsed = now - at
        impact_speed = max(HITS, TOUCHES * self._lands + HARDER)
        if not 0.0 < elapsed <= GAP or last_sink < impact_speed or sink > last_sink / 2.0:
            return None
        stop_deceleration = last_sink**2 / (2.0 * max(last_height, 0.05)) if last_height <= LOW else 0.0
        if max((last_sink - sink) / elapsed, stop_deceleration) < STOPS:
            return None
        description = f"it hit the ground at {last_sink:.1f} m/s"
        if height <= LOW:
            return self._crash(description)
        # The vehicle may be on a hill, or have braked: wait until it is at rest.
        self._pending_impact, self._impact_at = Finding(description, crashed=True), now
        return None

    def _confirmed_impact(self, landed: bool | None, now: float) -> Finding | None:
        impact = self._pending_impact
        if impact is None:
            return None
        if now - self._impact_at > 3.0 * RECOVERS:
            self._pending_impact = None
        elif (landed or not self._armed) and self._last is not None and abs(self._last[2]) < 0.5:
            self._pending_impact = None
            return self._crash(impact.text)
        return None

    def _falls(self, text: str) -> Finding | None:
        if self.falling or self.crashed:
            return None
        self.falling, self._recovering_at = text, math.inf
        return Finding(text)

    def _crash(self, text: str) -> Finding | None:
        if self.crashed:
            return None
        self.falling = self.crashed = text
        return Finding(text, crashed=True)
