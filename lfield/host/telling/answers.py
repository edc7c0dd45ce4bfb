"""Answers to arrivals wait a little: a coordinator that goes back at once brings that itself. Pure.

An answer is for the books of the sender only. Until it has come, the copy there is PREPARED: the coordinator
may be here. An answer is sent ANSWER_AFTER later, or earlier with whatever else the coordinators of this host
send to that host. A coordinator that goes back to the host from which it came replaces its answer, also
where its return has to be on the disk first; one that goes elsewhere may come to the sender from there, so
the answer is sent before it leaves.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import structs

from lfield.mobility.effects import Send
from lfield.wire.coordinators import Accepted, Transfer
from lfield.wire.fields import OLDEST

#: So many seconds at most an answer waits. That is short beside all that waits for it: leases, time limits in
#: seconds, and the time after which a copy is in doubt.
ANSWER_AFTER = 0.025


class Answers:
    """Those of one host that are not sent yet; `send` sends, `now` is in seconds of one clock."""

    def __init__(self, send: Callable[[Send], None], now: Callable[[], float]) -> None:
        self._send, self._now = send, now
        #: By the start of the coordinator, with the time when each is due; the first is due first.
        self._waiting: dict[tuple[str, int], tuple[float, Send]] = {}

    @property
    def due(self) -> float | None:
        """When `tick` has something to do next, None for never."""
        return next(iter(self._waiting.values()))[0] if self._waiting else None

    def put(self, answer: Send, accepted: Accepted) -> None:
        """A coordinator has arrived, and its sender need not hear of it at once."""
        start = accepted.agent, accepted.generation
        if before := self._waiting.pop(start, None):
            self._out(*before)
        self._waiting[start] = self._now() + ANSWER_AFTER, answer

    def tick(self, now: float) -> None:
        """Send those whose time has come."""
        while self._waiting:
            start, (due, answer) = next(iter(self._waiting.items()))
            if due > now:
                return
            del self._waiting[start]
            self._out(due, answer)

    def leaves(self, host: str, header: Transfer) -> None:
        """A coordinator is sent to a host now, behind the answers for that host."""
        mine = self._waiting.pop((header.agent, header.generation), None) if self._waiting else None
        if mine is not None and mine[1].host != host:
            self._out(*mine)
        self.flush(host)

    def flush(self, host: str = "") -> None:
        """Send what waits for a host to which something is sent now, or for all hosts."""
        if not self._waiting:
            return
        for start, (due, answer) in list(self._waiting.items()):
            if host in ("", answer.host):
                del self._waiting[start]
                self._out(due, answer)

    def _out(self, due: float, answer: Send) -> None:
        """Send an answer, which says for how long it was held: that is no part of how long a hop took."""
        held = min(OLDEST, max(0.0, self._now() - due + ANSWER_AFTER))
        self._send(Send(answer.host, structs.replace(answer.message, held=held)))
