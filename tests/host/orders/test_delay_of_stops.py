"""The delay of a stop over poor radio, in virtual time: that of the protocol without that of computers.

Signatures are neither made nor checked here: they would take most of the time of the test, and are not
measured. `test_order_datagrams` has them.
"""

from __future__ import annotations

import pytest
from emulator.cells import CELLS
from radio_stops import AT_REST, DESK, EXECUTES, RadioDesk, RadioWorld, stops, unsigned

from lfield.wire.order_messages import OrderConfirmed, SignedAnswer, decode_answer, decode_datagram


@pytest.fixture(autouse=True)
def _unsigned():
    with unsigned():
        yield


def percentile(samples, percent):
    return samples[len(samples) * percent // 100]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("cell", "hosts", "at_rest", "within", "most"),
    [
        ("20 %", 1, 0.0, 0.3, 1200),
        ("20 %", 5, 0.0, 0.4, 7000),
        ("57.6 kbit/s + 100 ms + 5 %", 1, 0.0, 0.5, 1000),
        ("57.6 kbit/s + 100 ms + 5 %", 5, 0.0, 0.8, 5000),
        ("57.6 kbit/s + 100 ms + 5 %", 5, AT_REST, 1.5, 5000),
        ("200 ms + 5 %", 1, 0.0, 0.6, 1000),
        ("200 ms + 5 %", 5, 0.0, 0.8, 5000),
    ],
)
def test_99_of_100_stops_are_confirmed_within_the_bound(cell, hosts, at_rest, within, most):
    elapsed, size = stops(cell, hosts, 50 if at_rest else 200, at_rest=at_rest)
    assert percentile(elapsed, 99) <= within
    assert size <= most


@pytest.mark.few(0)
def test_a_full_slow_radio_is_not_flooded_by_stops():
    elapsed, size = stops("57.6 kbit/s + 100 ms + 5 %", 5, 20, at_rest=1000.0)
    assert elapsed[-1] <= 4.0
    assert size <= 9000


@pytest.mark.parametrize(
    ("cell", "hosts", "within"), [("20 %", 1, 0.8), ("57.6 kbit/s + 100 ms + 5 %", 5, 4.0)]
)
def test_a_desk_without_earlier_contacts_confirms_within_the_bound(cell, hosts, within):
    found = []
    for seed in range(30):
        desk = RadioDesk(RadioWorld(CELLS[cell], hosts, seed, executes=EXECUTES))
        found.append(max(desk.stop()))
    assert max(found) <= within


def confirmations(world):
    """The number of confirmations that each host has sent."""
    counts = {}
    for source, _, data in world.sent:
        datagram = decode_datagram(data)
        if isinstance(datagram, SignedAnswer) and isinstance(decode_answer(datagram.answer), OrderConfirmed):
            counts[source] = counts.get(source, 0) + 1
    return counts


def test_a_confirmation_is_sent_twice_then_only_on_request():
    world = RadioWorld(CELLS["50 ms"], 1, 1, executes=EXECUTES, keeps=True)
    desk = RadioDesk(world)
    list(desk.stop())
    desk.lifted()
    world.sent.clear()
    list(desk.stop())
    world.run(10.0)
    orders = sum(source == DESK for source, _, _ in world.sent)
    assert orders == 2
    assert confirmations(world) == {"h0": 2}


def test_the_execution_time_of_devices_does_not_count_as_round_trip():
    world = RadioWorld(CELLS["50 ms"], 3, 1, executes=0.6)
    desk = RadioDesk(world)
    list(desk.stop())
    assert all(0.05 <= trip <= 0.06 for trip in desk.trips.values())
    assert len(desk.trips) == 3
