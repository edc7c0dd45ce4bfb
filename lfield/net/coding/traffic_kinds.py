"""The kinds of traffic of a link: for counting, and for the order of sending on a slow path."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

from lfield.wire.coordinator_messages import (
    CallsEnded,
    CancelCalls,
    Locate,
    Located,
    Terminated,
    TerminatedAck,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
    WatchCalls,
)
from lfield.wire.events import TELEMETRY
from lfield.wire.messages import HandshakeRefused, RelayedMessage, WholeTransferRequest
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, OrderChallenge, Pause
from lfield.wire.order_messages import RelayedAnswer, RelayedOrder
from lfield.wire.reservation_messages import ReleaseReservation, RenewReservation
from lfield.wire.service_messages import BundlePiece, PieceRequest, PieceStored
from lfield.wire.subscription_messages import EventAck, EventBatch, Subscribe

if TYPE_CHECKING:
    from lfield.wire.messages import Message


class TrafficKind(IntEnum):
    """In order of priority.

    Stops with their answers precede all other traffic. Messages about coordinators and their reservations are
    of the same kind as the coordinators, because they must not overtake them. The last message of a link is
    of this kind too; all other messages between hosts are control.
    """

    STOP = 0
    CONTROL = 1
    HOP = 2
    EVENTS = 3
    TELEMETRY = 4
    UPDATE = 5


#: Orders to stop and pause, with their answers.
STOP_MESSAGES = (EmergencyStop, EmergencyStopResult, Pause, OrderChallenge, RelayedOrder, RelayedAnswer)
_HOP = (
    TransferAccepted,
    TransferRefused,
    TransferQuery,
    Terminated,
    TerminatedAck,
    Locate,
    Located,
    RelayedMessage,
    WholeTransferRequest,
    WatchCalls,
    CallsEnded,
    CancelCalls,
    RenewReservation,
    ReleaseReservation,
    HandshakeRefused,
)
_KINDS: dict[type, TrafficKind] = {
    **dict.fromkeys(STOP_MESSAGES, TrafficKind.STOP),
    **dict.fromkeys(_HOP, TrafficKind.HOP),
    **dict.fromkeys((Subscribe, EventBatch, EventAck), TrafficKind.EVENTS),
    **dict.fromkeys((BundlePiece, PieceRequest, PieceStored), TrafficKind.UPDATE),
}


def kind_of(message: Message) -> TrafficKind:
    """The kind of a message; a batch of events with telemetry counts as telemetry."""
    kind = _KINDS.get(type(message), TrafficKind.CONTROL)
    if isinstance(message, EventBatch) and message.events and message.events[-1].kind in TELEMETRY:
        return TrafficKind.TELEMETRY
    return kind


class TrafficBytes:
    """Bytes of the frames of a link, sent and received, by kind; without TLS and headers of TCP and IP.

    The bytes are also counted in `total`, which is for several links.
    """

    def __init__(self, total: TrafficBytes | None = None) -> None:
        self.counts = [0] * len(TrafficKind)
        self._total = total

    def add(self, kind: TrafficKind, size: int) -> None:
        """Count a frame, or a correction of its size."""
        self.counts[kind] += size
        if self._total is not None:
            self._total.add(kind, size)

    @property
    def subscription_bytes(self) -> int:
        """Bytes of events and telemetry."""
        return self.counts[TrafficKind.EVENTS] + self.counts[TrafficKind.TELEMETRY]

    def by_name(self) -> dict[str, int]:
        """The kinds that occurred, by name in lower case."""
        return {kind.name.lower(): self.counts[kind] for kind in TrafficKind if self.counts[kind]}
