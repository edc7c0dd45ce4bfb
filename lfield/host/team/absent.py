"""For how long a coordinator waits for a host that cannot be talked to: not at all for one that is lost.

A host that was linked and is away has until `unreachable_after` counts out, from the end of its link and not
from the call. Who calls when half of that is over does not begin to wait: the host is known to be lost, until
it is linked again. One that nobody has ever met may just be starting, so it gets all the time. Pure.
"""

from __future__ import annotations

from lfield.clock import Clock
from lfield.host.effects import Nearby
from lfield.mobility.hearsay import Hearsay

#: The part of `unreachable_after` after which a host that is away is lost to who would call it.
LOST_AFTER = 0.5
#: Seconds without anything from a linked host after which nobody is sent there who need not go.
SILENT_FOR = 2.0


class Absent:
    """What one host knows of others that it cannot talk to; `unreachable_after` is in seconds."""

    def __init__(self, nearby: Nearby, hearsay: Hearsay, clock: Clock, unreachable_after: float) -> None:
        self._nearby, self._hearsay, self._clock = nearby, hearsay, clock
        self._unreachable_after = unreachable_after

    def is_linked(self, host: str) -> bool:
        """Whether a host can be talked to: then it is neither away nor lost."""
        return self._hearsay.is_linked(host)

    def is_silent(self, host: str) -> bool:
        """Whether nothing has come for a while over a link that is asked for signs of life every second."""
        heard = self._nearby.last_heard(host)
        asked = self._hearsay.is_linked(host) and host in self._hearsay.near
        return asked and heard is not None and self._clock.monotonic() - heard > SILENT_FOR

    def away(self, host: str) -> float:
        """For how many seconds a host that was linked has not been; 0 for one that was never met, or is."""
        return 0.0 if self._nearby.last_heard(host) is None else self._missing(host)

    def lost(self, host: str) -> str:
        """Why nobody need wait for a host, '' when it may be reached in time."""
        if self._hearsay.is_linked(host):
            return ""
        if host in self._hearsay.gone:
            return f"{host} could not be reached: it has ended"
        is_met, missing = self._nearby.last_heard(host) is not None, self._missing(host)
        if missing and missing >= (LOST_AFTER if is_met else 1.0) * self._unreachable_after:
            seconds = f"{missing:.{0 if missing >= 10 else 1}f} s"
            return f"{host} could not be reached: there has been no link for {seconds}; is it up?"
        return ""

    def _missing(self, host: str) -> float:
        """For how many seconds a host that is wanted has had no link; 0 for one that has, or is unwanted."""
        since = self._nearby.away.get(host)
        if since is None or self._hearsay.is_linked(host):
            return 0.0
        return max(0.0, self._clock.monotonic() - since)
