"""Replay protection of stop and pause orders: each order is executed once, and an order that may be old is
never executed. Sans-IO.

No clock is involved. A host has two random nonces, its `Epochs`, and an order names one of them:

    | order          | names  | which changes with                                           |
    |----------------|--------|--------------------------------------------------------------|
    | stop, pause    | `hold` | each incarnation of the host, each executed lift             |
    | lift, resume   | `end`  | each incarnation, each executed stop or pause, each lock-out |

A replayed stop that was lifted names an epoch that is over, and a lift cannot end a stop that was ordered
after it. An order with another epoch is not executed: the sender is challenged to name the present one. Ids
may be forgotten: within the same epoch nothing has ended the stop or pause of such an order.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from typing import Literal, cast

from lfield.journal.records import EmergencyStopFlag, PauseFlag, Record
from lfield.wire.order_messages import EPOCH_SIZE, HOLDS, UNKNOWN_EPOCH, Epochs, OrderKind

#: The stop or pause that a lift or resume order ends.
OrderEffect = Literal["stop", "pause"]
#: The state of an order, or the required action.
OrderStanding = Literal["new", "holds", "ended", "done", "old", "unknown"]
#: The number of remembered ids of executed orders.
MAX_ORDERS = 128


def effect_of(kind: OrderKind) -> OrderEffect:
    """The stop or pause that an order begins or ends."""
    return "stop" if kind in ("stop", "lift") else "pause"


class ExecutedOrders:
    """The orders that one host has executed. `random_bytes(n)` returns n random bytes.

    `restored` are the ids of the last orders before this incarnation, each with a flag that says whether it
    is still in force.
    """

    def __init__(
        self,
        random_bytes: Callable[[int], bytes],
        restored: Mapping[bytes, tuple[OrderKind, bool]] | None = None,
    ):
        self._random_bytes = random_bytes
        self.epochs = Epochs(self._new_epoch(), self._new_epoch())
        self._orders: OrderedDict[bytes, tuple[OrderKind, bool]] = OrderedDict(restored or {})

    @staticmethod
    def restored_orders(records: Iterable[Record]) -> dict[bytes, tuple[OrderKind, bool]]:
        """The ids of the last orders in the records of a journal, each with a flag that says whether it is
        still in force.
        """
        found: dict[bytes, tuple[OrderKind, bool]] = {}
        for record in records:
            if isinstance(record, EmergencyStopFlag) and record.order:
                found[record.order] = ("stop", True) if record.reason else ("lift", False)
            elif isinstance(record, PauseFlag) and record.order:
                found[record.order] = ("pause", True) if record.on else ("resume", False)
        return found

    def standing_of(self, kind: OrderKind, id: bytes, epoch: bytes) -> OrderStanding:
        """Classify a received order.

        `new`: execute it. `holds`, `ended` and `done`: it was executed, and is only confirmed again; `holds`
        is a stop or pause in force, `ended` one that has ended, `done` a lift. `old`: the order names an
        epoch that is over; `unknown`: it names no epoch.
        """
        known = self._orders.get(id)
        if known is not None:
            found, holds = known
            return ("holds" if holds else "ended") if found in HOLDS else "done"
        if epoch == self.epochs.of(kind):
            return "new"
        return "unknown" if epoch == UNKNOWN_EPOCH else "old"

    def mark_executed(self, kind: OrderKind, id: bytes) -> None:
        """Record an executed order: it is never executed again."""
        if kind in HOLDS:
            self.epochs = Epochs(self.epochs.hold, self._new_epoch())
        else:
            # `end` stays: two lifts given at the same time, of a stop and of a pause, are both executed.
            self.epochs = Epochs(self._new_epoch(), self.epochs.end)
            for other, (was, holds) in self._orders.items():
                if holds and effect_of(was) == effect_of(kind):
                    self._orders[other] = (was, False)
        self._orders[id] = (kind, kind in HOLDS)
        if len(self._orders) > MAX_ORDERS:
            self._orders.popitem(last=False)

    def on_executed(self, kind: str, id: bytes) -> None:
        """Record an executed order as of `mark_executed`; a lock-out if `kind` is ''."""
        if kind:
            self.mark_executed(cast(OrderKind, kind), id)
        else:
            self.on_lock_out()

    def on_lock_out(self) -> None:
        """A device is locked out, which acts like a stop: no earlier order lifts it."""
        self.epochs = Epochs(self.epochs.hold, self._new_epoch())

    def _new_epoch(self) -> bytes:
        drawn = self._random_bytes(EPOCH_SIZE)
        # No order may name this epoch by chance.
        return drawn if drawn != UNKNOWN_EPOCH else self._new_epoch()
