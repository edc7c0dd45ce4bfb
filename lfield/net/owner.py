"""The host that links belong to, as the links see it, and how they complain to it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from lfield.net.transport import Link
    from lfield.wire.coordinators import Transfer
    from lfield.wire.messages import Control, Hello

#: How many different complaints are remembered, so as not to be repeated.
MOST_COMPLAINTS = 100
#: So many lines about what others send are logged in so many seconds: they may send ever new names.
MOST_LINES, PERIOD = 20, 60.0
SUPPRESSED = f"too many invalid messages of others: log lines about them are suppressed for {PERIOD:g} s"


class Owner(Protocol):
    """The host the links belong to."""

    def hello(self) -> Hello:
        """What this host says of itself now."""

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""

    def unlinked(self, host: str, *, quietly: bool) -> None:
        """A host cannot be talked to any more; `quietly`, since this host did not want to."""

    def wanted(self) -> Collection[str]:
        """The hosts to have links with now."""

    def received(self, host: str, message: Control, link: Link) -> None:
        """A message came; `host` is '' when an observer sent it."""

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came."""

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""

    def note(self, text: str) -> None:
        """A line for the log."""


class Complaints:
    """What is wrong with links, each said once: a caller that is refused calls again every second.

    At most MOST_LINES lines come in PERIOD, and one that says how many are left out; `now` is the clock, in
    seconds.
    """

    def __init__(self, note: Callable[[str], None], now: Callable[[], float]) -> None:
        self._note, self._now = note, now
        self._said: set[str] = set()
        self._since, self._lines, self._left_out = -math.inf, 0, 0

    def say(self, text: str) -> None:
        """A line for the log, unless it is there, or too many are."""
        if text in self._said:
            return
        now = self._now()
        if now - self._since >= PERIOD:
            if self._left_out:
                self._note(f"{self._left_out} log lines about invalid messages of others were suppressed")
            self._since, self._lines, self._left_out = now, 0, 0
        self._lines += 1
        if self._lines > MOST_LINES:
            if not self._left_out:
                self._note(SUPPRESSED)
            self._left_out += 1
            return
        if len(self._said) >= MOST_COMPLAINTS:
            self._said.clear()
        self._said.add(text)
        self._note(text)


class Refusals:
    """The hosts with which no link can be made, since one of the two refuses the other's greeting.

    `hosts` are those of the deployment. `on_refused` is called with the host, the reason, and the digest of
    the bundle that it runs, b"" where that is not known, whenever one of these is new; the reason is '' when
    the host does not answer any more, or has been linked.
    """

    def __init__(self, hosts: Collection[str]) -> None:
        self._hosts = hosts
        self._last: dict[str, tuple[str, bytes]] = {}
        self.on_refused: Callable[[str, str, bytes], None] = lambda host, reason, bundle: None

    def report(self, host: str, reason: str, bundle: bytes = b"") -> None:
        """A link with a host was refused, by this side or the other; '' as the reason: it is no longer."""
        if host not in self._hosts or self._last.get(host, ("", b"")) == (reason, bundle):
            return
        self._last[host] = reason, bundle
        self.on_refused(host, reason, bundle)
