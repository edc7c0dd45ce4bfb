"""Lower bound on the current time for a computer without a real-time clock. Sans-IO.

A Raspberry Pi has no battery: after a start its clock may be far behind, and a clock that is behind accepts
expired certificates. So the time is the maximum of:

- the **system clock**;
- the **last time in the journal** of this host;
- the **newest notBefore that the CA has signed**: it issues no certificate or list with a later one, so that
  time has passed. Therefore no certificate is "not yet valid";
- the **time in the handshakes of authenticated hosts**, if it is within the validity of that host's own
  certificate. Times from operators do not count: an observer must not be able to have others refused.

A time that is too late only refuses more, so a false time gives no access. A host of the team with a false
time can have others refused, up to the end of its own certificate; the warning names it. Times of peers are
neither stored nor forwarded, so a false time disappears with its host. Each time advances by the monotonic
clock.
"""

from __future__ import annotations

import math

from lfield.authority.identity import Identity
from lfield.authority.peer_verification import format_time
from lfield.clock import Clock
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: A system clock that is further behind, in seconds, causes a warning.
MIN_WARNING = 60.0


class TrustedClock:
    """The trusted time of one host, in seconds since 1970 UTC.

    `journal_time` is the latest time in its journal, 0 if there is none.
    """

    def __init__(self, clock: Clock, journal_time: float = 0.0) -> None:
        self._clock = clock
        # The offset of the time from the monotonic clock, and its source.
        self._signed = (journal_time - clock.monotonic(), "the journal of this host has that time")
        self._from_peers = (-math.inf, "")
        #: The source of the time in the last warning.
        self._warning = ""

    def now(self) -> float:
        """The current time."""
        return max(self._clock.time(), self._clock.monotonic() + max(self._signed, self._from_peers)[0])

    def on_signature(self, at: float, subject: str) -> None:
        """Handle a notBefore that the CA has signed; `subject` is `the certificate of host bravo`."""
        self._signed = max(self._signed, (at - self._clock.monotonic(), f"{subject} began then"))

    def on_peer_time(self, at: float, identity: Identity) -> None:
        """Handle the time of an authenticated host."""
        if identity.kind == "host" and identity.valid_from <= at < identity.valid_until:
            self._from_peers = max(
                self._from_peers, (at - self._clock.monotonic(), f"{identity} has sent that time")
            )

    def for_handshake(self) -> float:
        """The time that is sent in handshakes: without the times of peers."""
        return max(self._clock.time(), self._clock.monotonic() + self._signed[0])

    def warning(self) -> LogLine | None:
        """The warning when the system clock is behind; None when it is not, or was reported.

        The warning is repeated only for a new source of the time.
        """
        behind = self.now() - self._clock.time()
        if behind < MIN_WARNING:
            return None
        evidence = max(self._signed, self._from_peers)[1]
        if evidence == self._warning:
            return None
        self._warning = evidence
        system_time, minimum_time = format_time(self._clock.time()), format_time(self.now())
        return log_messages.CLOCK_BEHIND.line(shown=system_time, least=minimum_time, evidence=evidence)
