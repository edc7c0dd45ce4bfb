"""How late this computer is, and how late it may be: what decides. Samples in, figures and sentences out.

A guard takes its host for dead when the last beat that it has read is older than `silence`. Between two beats
lie BEAT, what the host's loop and its turn are late, and what the guard is late to read: both run on one
computer, and with the same load both can be late at once. So a computer that is late by L keeps a silence of

    BEAT + 2 L        guards wait for a processor as their host does
    BEAT + 1.5 L      guards have real-time priority: what is over L is in reserve, for a second tells not all

What is over that is refused at the start, and warned of on the way, by the same rule. So a computer that is
once late by 20 ms keeps the smallest silence that can be written, 0.1 s; one that is late by 0.12 s does not.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from lfield.guard.messages import host_silent

#: Seconds between two signs of life.
BEAT = 0.05
#: By what the lateness of a host counts: guards may be late too, unless the system lets them come first.
WAITING, PROMPT = 2.0, 1.5
#: The longest silence that a binding may have, in seconds.
LONGEST_SILENCE = 10.0
#: Seconds that the figure of `lfield ps` looks back, and between two warnings of the same lateness.
MINUTE = 60.0
#: By how much worse a lateness is worth a warning of its own within the minute.
WORSE = 1.5
#: Seconds that the lateness behind a silence lies back at most when its guard tells of it.
BEHIND = 2.0


@dataclass(frozen=True, slots=True)
class Limit:
    """What a `silence` asks of a computer; `prompt`: its guards have real-time priority. In seconds."""

    silence: float
    prompt: bool = False

    @property
    def allowed(self) -> float:
        """How late the host may be."""
        return (self.silence - BEAT) / self._counts

    @property
    def _counts(self) -> float:
        return PROMPT if self.prompt else WAITING

    def kept_when(self, late: float) -> float:
        """The shortest silence that a computer keeps which is late by so much, in tenths of a second."""
        # What is a tenth already but for its last bits stays one.
        return max(1, math.ceil(round((BEAT + self._counts * late) * 10, 6))) / 10

    def told(self, late: float) -> str:
        """What was measured, for whoever starts a host."""
        if late <= self.allowed:
            return f"this computer was late by {shown(late)}: it keeps a silence of {self.silence:g} s"
        kept = self.kept_when(late)
        could = f"could keep {kept:g} s" if kept <= LONGEST_SILENCE else "could keep none"
        return (
            f"this computer cannot keep 'silence: {self.silence:g}': it was late by {shown(late)} and {could}"
        )

    def cure(self, late: float) -> str:
        """What to do about a lateness that is not allowed."""
        ways = ["free the computer"]
        if not self.prompt:
            ways.append("let its guards have real-time priority (LimitRTPRIO=1, see 'lfield doctor')")
        kept = self.kept_when(late)
        if kept <= LONGEST_SILENCE:
            ways.append(f"write 'silence: {kept:g}' if the vehicles may go on alone for so long")
        return " or ".join([", ".join(ways[:-1]), ways[-1]] if len(ways) > 1 else ways)


class Lateness:
    """What is known of a computer's lateness while its host runs."""

    def __init__(self, limit: Limit) -> None:
        self.limit = limit
        #: The longest ever.
        self.longest = 0.0
        # When each came and how long it was: of those within the minute only what nothing later exceeds.
        self._recent: deque[tuple[float, float]] = deque()
        self._warned_at, self._warned_of = -math.inf, 0.0

    def sample(self, scheduled: float, actual: float) -> str:
        """What should have been at one time was at another; a warning for the log, or ''."""
        late = max(0.0, actual - scheduled)
        self.longest = max(self.longest, late)
        while self._recent and self._recent[-1][1] <= late:
            self._recent.pop()
        self._recent.append((actual, late))
        while self._recent[0][0] < actual - MINUTE:
            self._recent.popleft()
        return self._warning(late, actual)

    def since(self, when: float) -> float:
        """The longest of those that came at `when` or later, 0 for none. At most a minute is known."""
        return next((late for came, late in self._recent if came >= when), 0.0)

    def last_minute(self, now: float) -> float:
        """The longest of the last minute."""
        return self.since(now - MINUTE)

    def answers_for(self, now: float, due: float) -> str:
        """Why a guard has taken this host for dead whose next beat is `due`: it is never the vehicle."""
        late = max(self.since(now - self.limit.silence - BEHIND), now - due)
        if late > self.limit.allowed:
            return f"this computer was late by {shown(late)}"
        return "this computer was late to wake its guard"

    def _warning(self, late: float, now: float) -> str:
        if now - self._warned_at >= MINUTE:
            self._warned_of = 0.0
        if late <= self.limit.allowed or late < WORSE * self._warned_of:
            return ""
        self._warned_at, self._warned_of = now, late
        return (
            f"this computer was late by {shown(late)} (longest so far: {shown(self.longest)}): free it; "
            f"at {shown(self.limit.silence - BEAT)} guards take this host for dead and make its devices safe"
        )


class Pulse:
    """The beats for one guard: each is late by what it comes after the one before it and BEAT."""

    def __init__(self, lateness: Lateness) -> None:
        self._lateness = lateness
        self._due = math.inf

    def beat(self, now: float) -> str:
        """A beat goes out; a warning for the log, or ''."""
        due, self._due = self._due, now + BEAT
        return self._lateness.sample(due, now)

    def pause(self) -> None:
        """None is due before the next one has come."""
        self._due = math.inf

    def explained(self, reason: str, now: float) -> str:
        """Why a guard has made a device safe; if this host was silent, with whose fault it was."""
        if reason != host_silent(self._lateness.limit.silence):
            return reason
        return f"{reason}, since {self._lateness.answers_for(now, self._due)}"


def shown(seconds: float) -> str:
    """A lateness for people."""
    return f"{seconds * 1000:.0f} ms" if seconds < 0.1 else f"{seconds:.2f} s"
