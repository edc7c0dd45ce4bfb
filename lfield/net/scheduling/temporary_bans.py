"""Temporary bans of flooding members, with exponential back-off. Sans-IO."""

from __future__ import annotations

#: Seconds of the first ban, and the maximum: a member that stopped flooding is linked again within ten.
FIRST_BAN, LONGEST_BAN = 1.0, 8.0
#: Seconds without a ban after which the back-off restarts.
RESET_AFTER = 60.0


class TemporaryBans:
    """Banned hosts by name. The duration doubles with each repetition."""

    def __init__(self) -> None:
        #: The time when each ban ends, and its duration.
        self._until: dict[str, tuple[float, float]] = {}

    def ban(self, host: str, now: float) -> float:
        """Ban a host from now on. Returns the seconds."""
        until, last = self._until.get(host, (now, 0.0))
        seconds = FIRST_BAN if now - until > RESET_AFTER else min(LONGEST_BAN, max(FIRST_BAN, 2 * last))
        self._until[host] = now + seconds, seconds
        return seconds

    def remaining(self, host: str, now: float) -> float:
        """Remaining seconds of a ban; 0 for none."""
        return max(0.0, self._until.get(host, (now, 0.0))[0] - now)
