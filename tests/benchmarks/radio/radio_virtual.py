"""The part of the figure of poor radio that takes no real time: stops as datagrams, in virtual time.

It has the pure desk and the pure hosts of lfield on the model of the emulated radio, as
tests/host/orders/test_delay_of_stops.py has them: without processes, processor time and signatures.
"""

from __future__ import annotations

from collections.abc import Iterator

from harness.checkout import Checkout
from harness.figure import Row
from harness.samples import Tick, chosen
from radio_stops import AT_REST, stops, unsigned

#: What else the radio carries: the links of hosts at rest, and beside them the telemetry of every vehicle.
LOADS = {"links at rest": False, "watch open": True}
#: Stops of a world, before the next one has another seed.
AGAIN = 10


def virtual(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """A stop of teams of one and of five hosts, from a desk that knows them, until all have confirmed."""
    for hosts in map(int, chosen("HOSTS", ("1", "5"))):
        case = f"stop of {hosts}, {cell}, virtual time"
        for load, watched in LOADS.items():
            tick(f"{case}, {load}")
            count = max(samples, AGAIN)
            with unsigned():
                # One host has no links.
                noise = AT_REST if hosts > 1 else 0.0
                found, size = stops(cell, hosts, count, at_rest=noise, watched=watched, again=AGAIN)
            yield Row(case, f"lfield, {load}", samples=found)
            yield Row("", "sent and received for it", "kB", [size / 1000])
