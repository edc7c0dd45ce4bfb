"""Delayed acknowledgements of arrivals: a coordinator that returns at once acknowledges its own arrival.
Sans-IO.

An acknowledgement only completes the sender's records. Until it arrives, the sender's copy is PREPARED: the
coordinator may be here. The acknowledgement is sent after ACK_DELAY, or earlier together with other messages
to that host about coordinators. A coordinator that returns to the host from which it came replaces its
acknowledgement, also if the return must be on disk first; a coordinator that moves elsewhere may reach the
sender from there, so the acknowledgement is sent before it leaves.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import structs

from lfield.host.context import Part
from lfield.hybrid_clock import HybridClock
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import Transfer, TransferAccepted
from lfield.wire.fields import MAX_DURATION

#: Maximum delay of an acknowledgement in seconds: short in comparison with all times that depend on it
#: (leases, time limits, and the time after which a copy is in doubt).
ACK_DELAY = 0.025


class DelayedAcks(Part):
    """The pending acknowledgements of one host; `send` sends one, `now` is in seconds of one clock."""

    def __init__(
        self, send: Callable[[Send], None], now: Callable[[], float], hybrid_clock: HybridClock
    ) -> None:
        self._send, self._now, self._hybrid_clock = send, now, hybrid_clock
        #: The acknowledgements by the start of the coordinator, each with the time when it is due, in the
        #: order of these times.
        self._waiting: dict[tuple[str, int], tuple[float, Send]] = {}
        self.due = None

    def add(self, answer: Send, accepted: TransferAccepted) -> None:
        """A coordinator has arrived; delay the acknowledgement."""
        start = accepted.agent, accepted.generation
        before = self._waiting.pop(start, None)
        if before is not None:
            self._send_now(*before)
        self._waiting[start] = due = self._now() + ACK_DELAY, answer
        if self.due is None:
            self.due = due[0]
        elif before is not None:
            self._update_due()

    def on_tick(self, now: float) -> None:
        """Send the acknowledgements that are due."""
        while self.due is not None and self.due <= now:
            start, (due, answer) = next(iter(self._waiting.items()))
            del self._waiting[start]
            self._update_due()
            self._send_now(due, answer)

    def on_sending(self, host: str, header: Transfer) -> None:
        """A coordinator is sent to a host now, after the acknowledgements for that host."""
        if not self._waiting:
            return
        own_ack = self._waiting.pop((header.agent, header.generation), None)
        if own_ack is not None and own_ack[1].host != host:
            self._send_now(*own_ack)
        if self._waiting:
            self.flush(host)
        else:
            self.due = None

    def flush(self, host: str = "") -> None:
        """Send the acknowledgements for a host to which another message is sent now, or for all hosts."""
        for start, (due, answer) in list(self._waiting.items()):
            if host in ("", answer.host):
                del self._waiting[start]
                self._send_now(due, answer)
        self._update_due()

    def _update_due(self) -> None:
        self.due = next(iter(self._waiting.values()))[0] if self._waiting else None

    def _send_now(self, due: float, answer: Send) -> None:
        """Send an acknowledgement with the duration of its delay, which the sender subtracts from the
        duration of the hop.
        """
        now = self._now()
        hold_time, stamp = min(MAX_DURATION, max(0.0, now - due + ACK_DELAY)), self._hybrid_clock.tick(now)
        self._send(Send(answer.host, structs.replace(answer.message, held=hold_time, stamp=stamp)))
