"""Limits on the calls of persons: how many run, how many start per second, how many ids are kept. Sans-IO."""

from __future__ import annotations

#: The most calls that run at the same time, of one caller and of all.
RUNNING_OF_ONE, RUNNING = 8, 64
#: Calls per second in the long run, and at once, of one caller and of all.
RATE_OF_ONE, RATE = 20.0, 100.0
#: Seconds of calls that may be made at once.
BURST = 2.0
#: Callers that are counted separately; beyond that the caller that is idle longest is removed.
MAX_CALLERS = 256


class TokenBucket:
    """Admits `rate` calls per second, and `BURST` seconds of them at once."""

    def __init__(self, rate: float, now: float) -> None:
        self._rate, self._tokens, self.used_at = rate, rate * BURST, now

    def try_acquire(self, now: float) -> bool:
        """Whether one more call may start."""
        self._tokens = min(self._rate * BURST, self._tokens + (now - self.used_at) * self._rate)
        self.used_at = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class CallLimits:
    """The limits of one host."""

    def __init__(self, now: float) -> None:
        self._all = TokenBucket(RATE, now)
        self._callers: dict[str, TokenBucket] = {}

    def refusal(self, caller: str, running: int, own: int, now: float) -> str:
        """The reason why a caller may not start a call; `running` calls exist, `own` of them are the
        caller's.
        """
        if own >= RUNNING_OF_ONE:
            return f"{caller} has {own} calls running on this host, the most of one caller"
        if running >= RUNNING:
            return f"{running} calls of persons are running on this host, the most of all callers"
        # The caller's own rate is checked first: a caller above it uses no tokens of the shared rate.
        if not self._bucket(caller, now).try_acquire(now):
            return f"{caller} calls more than {RATE_OF_ONE:g} portals per second of this host"
        if not self._all.try_acquire(now):
            return f"persons call more than {RATE:g} portals per second of this host"
        return ""

    def _bucket(self, caller: str, now: float) -> TokenBucket:
        if caller not in self._callers:
            if len(self._callers) >= MAX_CALLERS:
                del self._callers[min(self._callers, key=lambda name: self._callers[name].used_at)]
            self._callers[caller] = TokenBucket(RATE_OF_ONE, now)
        return self._callers[caller]
