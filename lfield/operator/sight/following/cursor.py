"""How far a watcher has read a host's stream: what it asks for after a cut, what it has heard. Pure."""

from __future__ import annotations

from msgspec.structs import replace

from lfield.wire.events import Thinned
from lfield.wire.watching import Events, Watch

#: The life of no host: whoever asks with it is told all of this one that there still is.
_NO_LIFE = 1

#: What states are called that a host has no more.
STATE = "state"

#: Seconds before a host is called again: after a link that held, at most, and at most when it was silent.
#: With the time after which a silent link is given up, it is followed again within 10 s after the path works.
SOONEST, LATEST, LATEST_UNHEARD = 0.25, 5.0, 2.0


class Cursor:
    """One host. `since`: its states after that number are wanted; None: what happens from now on."""

    def __init__(self, since: int | None = None, telemetry: float = 0.0) -> None:
        self._since, self._telemetry = since, telemetry
        self.incarnation = self.number = 0
        self._failures = 0
        self._missed = False

    def watch(self, incarnation: int) -> Watch:
        """What to ask a host for that is in that life."""
        if self.incarnation:
            return Watch(self.incarnation, self.number, self._telemetry)
        if self._since is not None:
            return Watch(incarnation, self._since, self._telemetry)
        return Watch(_NO_LIFE if self._missed else 0, 0, self._telemetry)

    def took(self, batch: Events) -> Events:
        """The batch without what was heard before; the states whose numbers are missing are the lost ones.

        Of a life that was not heard of before all counts that is told, and what came before is not lost to
        whoever begins with now: of that the host knows what is lost.
        """
        self._failures = 0
        same = batch.incarnation == self.incarnation
        known = self.number if same else batch.after
        states = {e.number for e in batch.events if not isinstance(e.what, Thinned)}
        fresh = [e for e in batch.events if isinstance(e.what, Thinned) or e.number > known]
        last = max((event.number for event in batch.events), default=0)
        self.incarnation, self.number = batch.incarnation, max(known, batch.after, last)
        lost = dict(batch.lost)
        if same:
            lost.pop(STATE, None)
            if (missing := self.number - known - sum(number > known for number in states)) > 0:
                lost[STATE] = missing
        return replace(batch, events=fresh, lost=lost)

    def nobody(self) -> None:
        """Nobody is there: a host that is there later began after this watcher."""
        self._missed = True

    def failed(self, *, unheard: bool = False) -> float:
        """A link has not come about, or has gone, or its host is `unheard`: seconds until the next try."""
        self._failures += 1
        return float(min(LATEST_UNHEARD if unheard else LATEST, SOONEST * 2 ** (min(self._failures, 10) - 1)))
