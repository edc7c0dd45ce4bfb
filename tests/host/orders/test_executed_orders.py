"""Which orders are executed: each once, and none that may be old."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from lfield.host.order_history.executed_orders import MAX_ORDERS, ExecutedOrders
from lfield.wire.order_messages import HOLDS, UNKNOWN_EPOCH, Epochs, OrderKind

KINDS: tuple[OrderKind, ...] = ("stop", "lift", "pause", "resume")


def executed(seed: int = 1) -> ExecutedOrders:
    return ExecutedOrders(random.Random(seed).randbytes)


def give(orders: ExecutedOrders, kind: OrderKind, id: bytes, epoch: bytes | None = None) -> str:
    found = orders.standing_of(kind, id, orders.epochs.of(kind) if epoch is None else epoch)
    if found == "new":
        orders.mark_executed(kind, id)
    return found


def test_a_stop_keeps_the_hold_epoch_and_changes_the_end_epoch():
    orders = executed()
    before = orders.epochs
    assert give(orders, "stop", b"1" * 16) == "new"
    assert orders.epochs.hold == before.hold
    assert orders.epochs.end != before.end
    assert give(orders, "lift", b"2" * 16, before.end) == "old"
    assert give(orders, "stop", b"3" * 16, before.hold) == "new"
    assert give(orders, "lift", b"2" * 16) == "new"
    assert orders.epochs.hold != before.hold
    assert give(orders, "pause", b"4" * 16, before.hold) == "old"


def test_a_repeated_order_is_confirmed_with_its_present_effect():
    orders = executed()
    give(orders, "stop", b"1" * 16)
    give(orders, "pause", b"2" * 16)
    assert give(orders, "stop", b"1" * 16, bytes(8)) == "holds"
    give(orders, "lift", b"3" * 16)
    assert [give(orders, "stop", b"1" * 16), give(orders, "pause", b"2" * 16)] == ["ended", "holds"]
    assert give(orders, "lift", b"3" * 16, bytes(8)) == "done"


def test_the_unknown_epoch_is_never_drawn_and_never_executed():
    class Nothing:
        def __init__(self) -> None:
            self.left = [bytes(8), bytes(8), b"a" * 8, b"b" * 8]

        def draw(self, size: int) -> bytes:
            return self.left.pop(0)

    orders = ExecutedOrders(Nothing().draw)
    assert UNKNOWN_EPOCH not in (orders.epochs.hold, orders.epochs.end)
    assert [give(orders, kind, b"1" * 16, UNKNOWN_EPOCH) for kind in KINDS] == ["unknown"] * 4


def test_a_lock_out_is_not_ended_by_an_earlier_lift():
    orders = executed()
    before = orders.epochs
    orders.on_lock_out()
    assert give(orders, "lift", b"1" * 16, before.end) == "old"
    assert give(orders, "stop", b"2" * 16, before.hold) == "new"


@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 5), st.integers(0, 30)), max_size=40),
    st.integers(0, 1000),
)
def test_no_order_is_executed_after_an_order_that_ends_its_epoch(orders_given, seed):
    """Orders name any epoch that a desk has ever received: a hold given before an end has no effect after it,
    and an end has no effect on later holds."""
    orders = executed(seed)
    received: list[Epochs] = [orders.epochs]
    known: set[bytes] = set()
    last_end = last_hold = 0
    for kind, id, at in orders_given:
        named = min(at, len(received) - 1)
        found = give(orders, kind, bytes([id, KINDS.index(kind)]) * 8, received[named].of(kind))
        if found == "new":
            assert named >= (last_end if kind in HOLDS else last_hold)
            known.add(bytes([id, KINDS.index(kind)]) * 8)
            received.append(orders.epochs)
            if kind in HOLDS:
                last_hold = len(received) - 1
            else:
                last_end = len(received) - 1
        else:
            assert orders.epochs == received[-1]


def test_two_ends_of_one_epoch_are_both_executed():
    orders = executed()
    give(orders, "stop", b"1" * 16)
    give(orders, "pause", b"2" * 16)
    epoch = orders.epochs.end
    assert [
        give(orders, kind, bytes([number]) * 16, epoch) for number, kind in ((3, "lift"), (4, "resume"))
    ] == ["new", "new"]


def test_remembered_ids_are_bounded_and_dropped_ones_stay_harmless():
    orders = executed()
    first = orders.epochs
    for number in range(MAX_ORDERS + 10):
        give(orders, "stop", number.to_bytes(16))
    assert give(orders, "stop", bytes(15) + b"\x00", first.hold) == "new", "it holds already"
    give(orders, "lift", b"x" * 16)
    assert give(orders, "stop", bytes(15) + b"\x01", first.hold) == "old"
