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


def test_a_stop_leaves_the_epoch_of_stops_and_changes_that_of_ends():
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


def test_what_was_executed_is_only_confirmed_and_says_whether_it_holds():
    orders = executed()
    give(orders, "stop", b"1" * 16)
    give(orders, "pause", b"2" * 16)
    assert give(orders, "stop", b"1" * 16, bytes(8)) == "holds"
    give(orders, "lift", b"3" * 16)
    assert [give(orders, "stop", b"1" * 16), give(orders, "pause", b"2" * 16)] == ["ended", "holds"]
    assert give(orders, "lift", b"3" * 16, bytes(8)) == "done"


def test_an_order_that_names_nothing_is_not_executed_and_no_host_draws_that():
    class Nothing:
        def __init__(self) -> None:
            self.left = [bytes(8), bytes(8), b"a" * 8, b"b" * 8]

        def draw(self, size: int) -> bytes:
            return self.left.pop(0)

    orders = ExecutedOrders(Nothing().draw)
    assert UNKNOWN_EPOCH not in (orders.epochs.hold, orders.epochs.end)
    assert [give(orders, kind, b"1" * 16, UNKNOWN_EPOCH) for kind in KINDS] == ["unknown"] * 4


def test_a_lock_out_is_ended_by_no_order_that_was_given_before():
    orders = executed()
    before = orders.epochs
    orders.on_lock_out()
    assert give(orders, "lift", b"1" * 16, before.end) == "old"
    assert give(orders, "stop", b"2" * 16, before.hold) == "new"


@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 5), st.integers(0, 30)), max_size=40),
    st.integers(0, 1000),
)
def test_after_an_end_no_earlier_order_is_executed(orders_given, seed):
    """Orders name any epoch that a desk has ever heard: what precedes an end does nothing after it, and an
    end does nothing to what came after it was given."""
    orders = executed(seed)
    heard: list[Epochs] = [orders.epochs]
    known: set[bytes] = set()
    last_end = last_hold = 0
    for kind, id, at in orders_given:
        named = min(at, len(heard) - 1)
        found = give(orders, kind, bytes([id, KINDS.index(kind)]) * 8, heard[named].of(kind))
        if found == "new":
            assert named >= (last_end if kind in HOLDS else last_hold)
            known.add(bytes([id, KINDS.index(kind)]) * 8)
            heard.append(orders.epochs)
            if kind in HOLDS:
                last_hold = len(heard) - 1
            else:
                last_end = len(heard) - 1
        else:
            assert orders.epochs == heard[-1]


def test_two_ends_that_are_given_at_one_time_are_both_executed():
    orders = executed()
    give(orders, "stop", b"1" * 16)
    give(orders, "pause", b"2" * 16)
    told = orders.epochs.end
    assert [
        give(orders, kind, bytes([number]) * 16, told) for number, kind in ((3, "lift"), (4, "resume"))
    ] == ["new", "new"]


def test_the_ids_that_are_remembered_are_bounded_and_forgetting_does_no_harm():
    orders = executed()
    first = orders.epochs
    for number in range(MAX_ORDERS + 10):
        give(orders, "stop", number.to_bytes(16))
    assert give(orders, "stop", bytes(15) + b"\x00", first.hold) == "new", "it holds already"
    give(orders, "lift", b"x" * 16)
    assert give(orders, "stop", bytes(15) + b"\x01", first.hold) == "old"
