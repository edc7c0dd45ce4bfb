"""Log lines of a link that is lost and opened again. Pure: reasons and times in, lines out."""

from __future__ import annotations

import math

from lfield.text import log_messages

#: Seconds after which a reason that has not changed is logged again.
REPEAT_INTERVAL = 30.0


class Attempts:
    """Attempts to reopen one link; `name` is its endpoint.

    Methods return a log line, '' for none.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._count = 0
        self._lost_at = math.inf
        self._logged: set[str] = set()
        self._said_at = -math.inf

    def lost(self, reason: str, now: float) -> str:
        """The link has failed."""
        if self._lost_at == math.inf:
            self._lost_at, self._count = now, 0
        return self._line(reason, log_messages.ENDPOINT_LOST.line(endpoint=self._name, reason=reason), now)

    def failed(self, reason: str, now: float) -> str:
        """An attempt to open it has failed."""
        self._count += 1
        line = log_messages.ENDPOINT_UNOPENED.line(endpoint=self._name, reason=reason, count=self._count)
        return self._line(reason, line, now)

    def opened(self, where: str, now: float) -> str:
        """An attempt has succeeded; `where` is the address that answered, if known."""
        if self._lost_at == math.inf:
            return ""
        self._count += 1
        line = log_messages.ENDPOINT_REOPENED.line(
            endpoint=self._name, address=where, attempts=self._count, seconds=now - self._lost_at
        )
        return self._line(f"opened {where}", line, now)

    def works(self) -> None:
        """Data has arrived: the next loss is a new one."""
        if self._lost_at != math.inf:
            self._lost_at = math.inf
            self._logged.clear()

    def _line(self, reason: str, line: str, now: float) -> str:
        """The line, unless a line with the same reason was logged within REPEAT_INTERVAL."""
        if now - self._said_at >= REPEAT_INTERVAL:
            self._logged.clear()
            self._said_at = now
        if reason in self._logged:
            return ""
        self._logged.add(reason)
        return line
