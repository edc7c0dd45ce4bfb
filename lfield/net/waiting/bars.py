"""For how long a member that sent too much is not accepted again: a pure rule."""

from __future__ import annotations

#: Seconds after the first time, and the longest: whoever has stopped is linked again within ten.
FIRST_BAR, LONGEST_BAR = 1.0, 8.0
#: After so many seconds without another time, the next is a first one.
FORGOTTEN_AFTER = 60.0


class Bars:
    """Hosts by name. The time doubles with each repetition."""

    def __init__(self) -> None:
        #: When each may come again, and for how long it was barred.
        self._until: dict[str, tuple[float, float]] = {}

    def bar(self, host: str, now: float) -> float:
        """Bar a host from now on; for how many seconds."""
        until, last = self._until.get(host, (now, 0.0))
        seconds = FIRST_BAR if now - until > FORGOTTEN_AFTER else min(LONGEST_BAR, max(FIRST_BAR, 2 * last))
        self._until[host] = now + seconds, seconds
        return seconds

    def left(self, host: str, now: float) -> float:
        """For how many seconds a host is barred yet; 0 when it is not."""
        return max(0.0, self._until.get(host, (now, 0.0))[0] - now)
