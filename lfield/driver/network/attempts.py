"""What the log says of a link that is lost and opened again. Pure: reasons and times in, lines out."""

from __future__ import annotations

import math

#: Seconds after which a reason that has not changed is logged again.
SAY_AGAIN = 30.0


class Attempts:
    """The attempts to open one link again; `name` is its endpoint. Methods return a line, '' for none."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._count = 0
        self._lost_at = math.inf
        self._said: set[str] = set()
        self._said_at = -math.inf

    def lost(self, reason: str, now: float) -> str:
        """It does not work any more."""
        if self._lost_at == math.inf:
            self._lost_at, self._count = now, 0
        return self._line(reason, f"{self._name} is lost: {reason}", now)

    def failed(self, reason: str, now: float) -> str:
        """An attempt to open it has failed."""
        self._count += 1
        line = f"{self._name} is not open yet: {reason} (attempt {self._count})"
        return self._line(reason, line, now)

    def opened(self, where: str, now: float) -> str:
        """An attempt has succeeded; `where` names the address that answered, if there is one."""
        if self._lost_at == math.inf:
            return ""
        self._count += 1
        line = f"{self._name} is open again"
        if where:
            tries = "1 attempt" if self._count == 1 else f"{self._count} attempts"
            line += f": {where}, after {tries} and {now - self._lost_at:.0f} s"
        return self._line(f"opened {where}", line, now)

    def works(self) -> None:
        """Something came over it: the next loss is a new one."""
        if self._lost_at != math.inf:
            self._lost_at = math.inf
            self._said.clear()

    def _line(self, reason: str, line: str, now: float) -> str:
        """The line, unless one for the same reason was logged within SAY_AGAIN."""
        if now - self._said_at >= SAY_AGAIN:
            self._said.clear()
            self._said_at = now
        if reason in self._said:
            return ""
        self._said.add(reason)
        return line
