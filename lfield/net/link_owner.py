"""The interface of a host to its links, with rate-limited logging and records of refused hosts."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lfield.errors import KeysError, WireError
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from lfield.authority.admission_policy import AdmissionPolicy
    from lfield.hybrid_clock import HybridClock
    from lfield.net.transport import Link
    from lfield.wire.coordinator_messages import Transfer
    from lfield.wire.messages import Control, Hello

#: Maximum number of remembered log lines, which are not repeated.
MAX_DISTINCT_LINES = 100
#: Maximum number of log lines per period about received data, which may contain new names each time.
MAX_LINES, PERIOD = 20, 60.0


def apply_revocations(admission: AdmissionPolicy, data: bytes, note: Callable[[LogLine], None]) -> bool:
    """Apply a certificate revocation list of a peer; returns whether it was new. Raises WireError."""
    try:
        lines = admission.on_revocation_list(data)
    except KeysError as error:
        raise WireError(str(error)) from None
    for line in lines:
        note(line)
    return bool(lines)


class LinkOwner(Protocol):
    """The host that owns the links; `hybrid_clock` gives the timestamps of heartbeats."""

    hybrid_clock: HybridClock

    def hello(self) -> Hello:
        """The present Hello of this host."""

    def on_linked(self, hello: Hello) -> None:
        """A link with a host was established."""

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        """A link with a host was closed; `quietly` when this host closed it because it was unneeded."""

    def desired_hosts(self) -> Collection[str]:
        """The hosts that need links with this host now."""

    def on_message(self, host: str, message: Control, link: Link) -> None:
        """A message arrived; `host` is '' for an observer."""

    def on_transfer(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator arrived."""

    def on_oversize(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator with an oversized block arrived; the block was discarded."""

    def on_link_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """See `RefusedHosts`."""

    def note(self, line: LogLine) -> None:
        """Write a log line."""


class RateLimitedLog:
    """Rate-limited log of link errors, each line once: a refused peer dials again every second.

    At most MAX_LINES lines per PERIOD, and a line with the number of suppressed lines; `now` is the clock,
    in seconds.
    """

    def __init__(self, note: Callable[[LogLine], None], now: Callable[[], float]) -> None:
        self._note, self._now = note, now
        self._written: set[str] = set()
        self._since, self._lines, self._suppressed = -math.inf, 0, 0

    def write(self, text: LogLine) -> None:
        """Write a line, unless it is repeated or the limit is reached."""
        if text in self._written:
            return
        now = self._now()
        if now - self._since >= PERIOD:
            if self._suppressed:
                self._note(log_messages.LINES_DROPPED.line(count=self._suppressed))
            self._since, self._lines, self._suppressed = now, 0, 0
        self._lines += 1
        if self._lines > MAX_LINES:
            if not self._suppressed:
                self._note(log_messages.LINES_SUPPRESSED.line(period=PERIOD))
            self._suppressed += 1
            return
        if len(self._written) >= MAX_DISTINCT_LINES:
            self._written.clear()
        self._written.add(text)
        self._note(text)


class TeamAddresses(NamedTuple):
    """The hosts of the deployment with their numbers, and their addresses; `own_number` is that of this host.

    `neighbours` are the hosts that need a link with this host, as this host needs one with them. With live
    values, which age between two heartbeats, the heartbeats of idle links are as frequent as those of busy
    ones.
    """

    hosts: Mapping[str, int]
    addresses: Sequence[str]
    own_number: int
    neighbours: Collection[str]
    has_live_values: bool = False


class InitialContact:
    """First contacts with the other hosts: a handshake, or a failed attempt to dial.

    `hosts` are the hosts of the deployment with their numbers; `own_number` is that of this host.
    """

    def __init__(self, hosts: Mapping[str, int], own_number: int) -> None:
        self._hosts, self._own_number = hosts, own_number
        self._contacted = set[str]()
        self._completed = asyncio.Event()
        if len(hosts) == 1:
            self._completed.set()

    @property
    def missing(self) -> list[str]:
        """The hosts without a contact so far."""
        others = (host for host, number in self._hosts.items() if number != self._own_number)
        return sorted(host for host in others if host not in self._contacted)

    def on_contact(self, host: str) -> None:
        """A host has completed a handshake, or an attempt to dial it has failed."""
        self._contacted.add(host)
        if len(self._contacted) >= len(self._hosts) - 1:
            self._completed.set()

    async def wait(self, bound: float) -> None:
        """Return when no host is missing, at most after `bound` seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(bound):
                await self._completed.wait()


class RefusedHosts:
    """Hosts whose links are refused by one of the two sides.

    `hosts` are the hosts of the deployment. `on_refused` is called on each change with the host, the reason,
    and the digest of the bundle of the host (b"" if unknown); the reason is '' when the host no longer
    answers, or was linked.
    """

    def __init__(
        self,
        hosts: Collection[str],
        on_refused: Callable[[str, str, bytes], None] = lambda host, reason, bundle: None,
    ) -> None:
        self._hosts, self._on_refused = hosts, on_refused
        self._last: dict[str, tuple[str, bytes]] = {}

    def report(self, host: str, reason: str, bundle: bytes = b"") -> None:
        """Record a refusal by either side; the reason '' clears it."""
        if host not in self._hosts or self._last.get(host, ("", b"")) == (reason, bundle):
            return
        self._last[host] = reason, bundle
        self._on_refused(host, reason, bundle)
