"""What time it is, as far as a computer can believe it that may have begun in 1970. Pure: given a clock.

A Raspberry Pi has no battery: it begins where it stopped, or long ago, until something sets its clock. A
clock that is behind takes certificates that have ended. So it is the latest of these:

- **this computer's clock**;
- **what it was when this host ran before**, from its journal;
- **what the authority has signed**: it makes no certificate and no list that begins later on, so when one
  begins it was that time already. Therefore no certificate is "not yet valid" to whoever has seen it here;
- **what the team says**: the time in the greeting of a host, if it lies within that host's own certificate.
  One that says more says that it has ended itself, and proves nothing. What persons say of the time counts
  for nothing: whoever may look must not be able to have others refused.

A time that is too late only ever refuses more, so nobody gets in by lying; a host of the team that lies can
have others refused, up to the end of its own certificate, and `line` names it. What the team says is neither
kept nor passed on: after a restart a computer hears it again from whomever it links with, and a lie is gone
with the liar, when two hosts would otherwise go on telling it to each other. Time goes on from each of these
by the clock that never goes back.
"""

from __future__ import annotations

import math

from lfield.authority.identity import Identity
from lfield.authority.judge import when
from lfield.clock import Clock

#: So many seconds a clock may be behind before anybody is told.
NOTABLE = 60.0


class BelievedTime:
    """The believed time of one host, in seconds since 1970 UTC.

    `kept` is the latest time that its journal knows of, 0 where there is none.
    """

    def __init__(self, clock: Clock, kept: float = 0.0) -> None:
        self._clock = clock
        # How far the time is ahead of the clock that never goes back, and who says so.
        self._proven = (kept - clock.monotonic(), "it was so late already when this host ran before")
        self._told = (-math.inf, "")
        #: By whom the clock was behind when that was last told.
        self._line = ""

    def now(self) -> float:
        """What time it is."""
        return max(self._clock.time(), self._clock.monotonic() + max(self._proven, self._told)[0])

    def proven(self, at: float, what: str) -> None:
        """The authority has signed something that begins at this time: `the certificate of host bravo`."""
        self._proven = max(self._proven, (at - self._clock.monotonic(), f"{what} began then"))

    def told(self, at: float, who: Identity) -> None:
        """Somebody who was judged well says that it is so late."""
        if who.kind == "host" and who.begins <= at < who.ends:
            self._told = max(self._told, (at - self._clock.monotonic(), f"{who} says so"))

    def to_say(self) -> float:
        """What to tell the team in greetings: without what others have told."""
        return max(self._clock.time(), self._clock.monotonic() + self._proven[0])

    def line(self) -> str:
        """What to tell when the clock is behind what is believed; '' when it is not, or that was told.

        It names the time, which goes on: only a new reason makes it news.
        """
        behind = self.now() - self._clock.time()
        if behind < NOTABLE:
            return ""
        why = max(self._proven, self._told)[1]
        if why == self._line:
            return ""
        self._line = why
        return (
            f"the clock of this computer says {when(self._clock.time())}; it is taken to be "
            f"{when(self.now())}, since {why}; set the clock"
        )
