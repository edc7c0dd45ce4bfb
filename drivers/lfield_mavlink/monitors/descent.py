"""Falls and crashes of a vehicle that flies, from its telemetry. Pure: samples and times in, findings out.

The bounds are those of the recordings. In normal flight ArduCopter and PX4 sink at most 2.0 m/s and tilt at
most 31 degrees; with one motor at 60 % an ArduCopter tilted 29 degrees, lost 1 m in 1.1 s, sank 1.5 m/s by
then, and hit the ground at 2.7 m/s 4.2 s after the fault (gauntlet-b). After a forced disarm it fell 1.1 m/s
within 0.1 s.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass

#: Metres below the lowest height that a motion may have, and m/s downwards there, that are a fall.
LOST, SINKS = 1.0, 1.0
#: m/s downwards that are a fall in any case: so much, or a share of the autopilot's own speed of descent.
FASTEST, SHARE, MORE = 2.6, 1.4, 0.5
#: A descent may be this share of the speed that was commanded, or is the autopilot's own; m/s of that where
#: it is not known. So many metres beyond it are a fall.
DESCENDS, UNKNOWN, BEYOND = 1.15, 2.0, 0.6
#: Seconds for which a commanded speed downwards still counts: a vehicle brakes.
COMMANDED = 1.5
#: Seconds for which it must sink so fast, and for which it must be too low when it sinks more slowly or stays
#: there. In flights without a fault nothing was lower than 0.4 m below its floor, and then it climbed.
LASTS, LASTS_LOW = 0.25, 0.5
#: m/s upwards with which it makes up for what it has lost, and m/s downwards that may be an error of the
#: estimator: a velocity has no height to be held against, only the sum of what it sinks.
CLIMBS, BIAS = 0.1, 0.15
#: Metres by which its height changes without a speed when home or the estimate has moved, not the vehicle.
JUMPS = 1.0
#: m/s2 with which a vehicle ends a descent that it was commanded.
BRAKES = 1.0
#: Radians from upright, and the seconds for which it must tilt so far.
TILTS, TILTS_FOR = math.radians(60.0), 0.4
#: An impact: m/s downwards before (or a share of the autopilot's own speed of landing, and more), m/s2 at
#: least with which that ended, and metres above home at most; higher it must be seen to stand.
HITS, TOUCHES, HARDER, STOPS, LOW = 2.0, 1.15, 0.25, 6.0, 2.5
#: Seconds between two samples in which an impact is looked for, and a fall is added up.
GAP = 1.0
#: m/s downwards without motors that are no touch-down.
DROPS = 1.5
#: Seconds without a fall, after which it flies on.
RECOVERS = 1.0
#: Seconds in which its clock may have begun anew without a person who switched it off on the ground.
SILENT = 10.0

#: Texts of a fall, and of a crash. ArduCopter: thrust_loss_check and crash_check; PX4: its failure detector.
_FALLS = re.compile(
    r"potential thrust loss|motor failure|attitude failure|critical failure detected|flight termination", re.I
)
#: So many messages may show the motors on after that text: heartbeats and extended states in turn.
SHOWN = 4
_CRASHES = re.compile(r"^crash|crash: disarming", re.I)
#: What only keeps it from being armed.
_BEFORE = re.compile(r"^(preflight|prearm|arm)\b", re.I)


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found, in words; after a crash it must not fly until a person has seen it."""

    words: str
    crashed: bool = False


@dataclass(frozen=True, slots=True)
class Expected:
    """What a motion may do with the height: metres above home, m/s.

    `goal` is the height that it leads to, infinity for one that only must not sink, None for one that leads
    down. `by_velocity` says that its speed downwards is commanded again and again.
    """

    goal: float | None = None
    by_velocity: bool = False


#: Of a landing, a return, or a mission.
DESCENT = Expected()


class DescentMonitor:
    """Watches one vehicle; `falling` and `crashed` say why, '' while it is neither."""

    def __init__(self) -> None:
        self.falling = self.crashed = ""
        #: How many more messages may show motors on that the vehicle has said to switch off.
        self._disarms = 0
        self._expected, self._fastest = DESCENT, FASTEST
        # The autopilot's own speeds of descent and of landing; the speeds downwards that were commanded.
        self._descends, self._lands = UNKNOWN, 0.0
        self._commanded: deque[tuple[float, float]] = deque()
        # Metres that it has sunk beyond what it may.
        self._excess = 0.0
        # The lowest height that this motion may have (None before a sample), and the highest that it has had.
        self._floor: float | None = None
        self._top = -math.inf
        self._last: tuple[float, float, float] | None = None
        # Since when it sinks too fast, is too low, tilts too far, and is well again.
        self._sinks_at = self._low_at = self._tilts_at = self._well_at = math.inf
        self._tilt = 0.0
        self._hit: Finding | None = None
        self._stands_at = math.inf
        self._armed = self._aloft = False
        # How it dropped when its motors went off, until it is known to have landed.
        self._off_at = -math.inf

    # -- what it is to do -------------------------------------------------------------------------------

    def expect(self, expected: Expected) -> None:
        """A motion begins, which may do this with the height."""
        if expected != self._expected:
            self._expected, self._floor, self._top = expected, None, -math.inf
            self._sinks_at = self._low_at = math.inf
            self._excess = 0.0

    def on_velocity(self, sink: float, now: float) -> None:
        """A velocity is commanded, in m/s downwards."""
        self.expect(Expected(by_velocity=True))
        self._commanded.append((now, max(0.0, sink)))
        while self._commanded[0][0] < now - COMMANDED:
            self._commanded.popleft()

    def may_descend(self, speed: float, landing: float) -> None:
        """Its own speeds of descent and of landing in m/s, as its parameters have them; 0: not known."""
        self._fastest = max(FASTEST, SHARE * speed + MORE)
        self._descends, self._lands = max(speed, landing) or UNKNOWN, landing

    def clear(self) -> None:
        """A person has seen to it."""
        self.falling = self.crashed = ""
        self._hit, self._disarms = None, 0

    @property
    def undecided(self) -> bool:
        """Whether its motors went off in the air, as it seems, and it is not known yet what became of it.

        Also whether it says that it disarms after a crash, and its heartbeat does not show that yet.
        """
        return self._off_at > -math.inf or self._disarms > 0

    # -- telemetry --------------------------------------------------------------------------------------

    def on_armed(self, armed: bool, *, landed: bool | None, now: float) -> Finding | None:
        """Whether its motors are on, and whether it says that it stands."""
        before, self._armed = self._armed, armed
        self._disarms = max(0, self._disarms - 1) if armed else 0
        if armed:
            self._aloft = landed is False or (self._aloft and landed is None)
            if self._aloft:
                self._off_at = -math.inf
        elif before and self._aloft:
            # ArduPilot says that it has landed whenever its motors are off: only a drop tells.
            self._aloft, self._off_at = False, now
        if not self._aloft:
            # What stands falls no more.
            self.falling = self.crashed
        if not armed and now - self._off_at > RECOVERS + GAP:
            self._off_at = -math.inf
        return self._stood(landed, now)

    def on_motion(self, height: float, sink: float, now: float, *, judged: bool) -> Finding | None:
        """A sample: metres above home, m/s downwards; `judged` is whether its motion is the program's."""
        last, self._last = self._last, (now, height, sink)
        found = self._dropped(height, sink) or self._impact(last, height, sink, now)
        if found is not None or not (judged and self._armed and self._aloft):
            self._sinks_at = self._low_at = math.inf
            return found
        self._look_for_jump(last, height, sink, now)
        self._move_floor(height, sink)
        self._add_up(height, sink, now, 0.0 if last is None else now - last[0])
        fast, low = self._why_falling(height, sink, now), self._why_low(height, sink)
        self._sinks_at = min(self._sinks_at, now) if fast else math.inf
        self._low_at = min(self._low_at, now) if low else math.inf
        if not (fast or low):
            self._recover(sink, now)
            return None
        self._well_at = math.inf
        if now - self._sinks_at >= LASTS:
            return self._falls(fast)
        return self._falls(low) if now - self._low_at >= LASTS_LOW else None

    def on_attitude(self, roll: float, pitch: float, now: float, *, judged: bool) -> Finding | None:
        """A sample, in radians."""
        self._tilt = math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))
        if not self._armed or self._tilt < TILTS:
            self._tilts_at = math.inf
            return None
        self._tilts_at = min(self._tilts_at, now)
        if now - self._tilts_at < TILTS_FOR:
            return None
        words = f"it is tilted by {math.degrees(self._tilt):.0f} degrees"
        last = self._last
        if last is not None and last[1] <= LOW and abs(last[2]) < 0.5:
            return self._crash(f"{words} on the ground, with its motors on")
        return self._falls(words) if judged else None

    def on_text(self, text: str) -> Finding | None:
        """What the autopilot says."""
        if not self._armed and not self._off_at > -math.inf:
            return None
        if _CRASHES.search(text):
            self._disarms = SHOWN if self._armed and "disarm" in text.lower() else 0
            return self._crash(f"the autopilot says: {text}")
        if _FALLS.search(text) and not _BEFORE.search(text):
            return self._falls(f"the autopilot says: {text}")
        return None

    def on_restart(self, silent: float) -> Finding | None:
        """Its clock has begun anew, after so many seconds without a word of it."""
        if not (self._armed and self._aloft) or silent > SILENT:
            return None
        self._aloft = False
        return self._crash("its autopilot restarted in the air")

    # -- decisions --------------------------------------------------------------------------------------

    def _look_for_jump(
        self, last: tuple[float, float, float] | None, height: float, sink: float, now: float
    ) -> None:
        """Begin with a new floor where the height has another reference."""
        if last is None or now - last[0] > GAP:
            return
        sunk = 0.5 * (last[2] + sink) * (now - last[0])
        if abs(last[1] - sunk - height) > JUMPS:
            self._floor, self._top = None, -math.inf

    def _move_floor(self, height: float, sink: float) -> None:
        """The floor of a climb rises with it, up to its goal; what sinks at first may brake."""
        goal = self._expected.goal
        if goal is None:
            return
        if self._floor is None:
            self._floor = height - max(0.0, sink) ** 2 / (2.0 * BRAKES)
        self._top = max(self._top, height)
        self._floor = min(goal, max(self._floor, self._top if sink < SINKS else self._floor))

    def _may_sink(self, height: float, now: float) -> float:
        """m/s at which it may go down now."""
        if self._expected.by_velocity:
            return DESCENDS * max(
                (sink for at, sink in self._commanded if at >= now - COMMANDED), default=0.0
            )
        goal = self._expected.goal
        leads_down = goal is None or goal < height - LOST or self._floor is None or self._floor < goal - LOST
        return DESCENDS * self._descends if leads_down else math.inf

    def _add_up(self, height: float, sink: float, now: float, took: float) -> None:
        """Add up by how much it sinks faster than it may; what does not leave off is a fall."""
        may = self._may_sink(height, now) + (BIAS if self._expected.by_velocity else 0.0)
        self._excess = max(0.0, self._excess + (sink - may) * min(took, GAP))

    def _why_falling(self, height: float, sink: float, now: float) -> str:
        commanded = max((each for at, each in self._commanded if at >= now - COMMANDED), default=0.0)
        more = SINKS if self._expected.by_velocity else MORE
        beyond = self._excess > BEYOND and sink > self._may_sink(height, now) + more
        if beyond or sink > max(self._fastest, SHARE * commanded + MORE):
            return f"it sinks at {sink:.1f} m/s, {height:.1f} m above home"
        return self._why_low(height, sink) if sink > SINKS else ""

    def _why_low(self, height: float, sink: float) -> str:
        """Whether it has lost height, at whatever speed, and does not make up for it."""
        if sink < -CLIMBS:
            return ""
        low = 0.0 if self._floor is None else self._floor - height
        if self._expected.by_velocity:
            low = self._excess
        return f"it falls: {low:.1f} m too low and sinking at {max(0.0, sink):.1f} m/s" if low > LOST else ""

    def _recover(self, sink: float, now: float) -> None:
        if not self.falling or sink > SINKS / 2.0 or self._tilt >= TILTS:
            self._well_at = math.inf
            return
        self._well_at = min(self._well_at, now)
        if now - self._well_at >= RECOVERS:
            self.falling = ""

    def _dropped(self, height: float, sink: float) -> Finding | None:
        """Whether its motors went off in the air: then it falls."""
        if self._off_at == -math.inf or sink < DROPS:
            return None
        self._off_at = -math.inf
        return self._crash(f"its motors went off in the air, {height:.1f} m above home, and it fell")

    def _impact(
        self, last: tuple[float, float, float] | None, height: float, sink: float, now: float
    ) -> Finding | None:
        """Whether a descent ended more suddenly than a vehicle brakes."""
        if last is None:
            return None
        at, was, fell = last
        took = now - at
        hits = max(HITS, TOUCHES * self._lands + HARDER)
        if not 0.0 < took <= GAP or fell < hits or sink > fell / 2.0:
            return None
        needed = fell**2 / (2.0 * max(was, 0.05)) if was <= LOW else 0.0
        if max((fell - sink) / took, needed) < STOPS:
            return None
        words = f"it hit the ground at {fell:.1f} m/s"
        if height <= LOW:
            return self._crash(words)
        # On a hill, say: it stands there, or it has only braked.
        self._hit, self._stands_at = Finding(words, crashed=True), now
        return None

    def _stood(self, landed: bool | None, now: float) -> Finding | None:
        hit = self._hit
        if hit is None:
            return None
        if now - self._stands_at > 3.0 * RECOVERS:
            self._hit = None
        elif (landed or not self._armed) and self._last is not None and abs(self._last[2]) < 0.5:
            self._hit = None
            return self._crash(hit.words)
        return None

    def _falls(self, words: str) -> Finding | None:
        if self.falling or self.crashed:
            return None
        self.falling, self._well_at = words, math.inf
        return Finding(words)

    def _crash(self, words: str) -> Finding | None:
        if self.crashed:
            return None
        self.falling = self.crashed = words
        return Finding(words, crashed=True)
