"""The part of the figure of poor radio in virtual time: stops as datagrams.

The cores of desk and hosts run on the model of the emulated radio, as in
tests/host/orders/test_delay_of_stops.py: without processes, processor time and signatures.
"""

from __future__ import annotations

from collections.abc import Iterator

from harness.checkout import Checkout
from harness.figure import Row
from harness.samples import Tick, chosen
from radio_stops import AT_REST, IDLE, stops, unsigned

#: Other traffic of the radio: bytes/s of the links of each host; True if the desk receives the telemetry of
#: every vehicle.
LOADS = {
    "links at rest": (IDLE, False),
    "links with leases": (AT_REST, False),
    "links with leases, watch open": (AT_REST, True),
}
#: Stops of a simulated team before the next team has another seed.
AGAIN = 10


def virtual(checkout: Checkout, samples: int, tick: Tick, cell: str) -> Iterator[Row]:
    """A stop of teams of one and of five hosts, from a desk with addresses, until all have confirmed."""
    for hosts in map(int, chosen("HOSTS", ("1", "5"))):
        case = f"stop of {hosts}, {cell}, virtual time"
        for load, (links, watched) in LOADS.items():
            tick(f"{case}, {load}")
            count = max(samples, AGAIN)
            with unsigned():
                # A single host has no links.
                noise = links if hosts > 1 else 0.0
                found, size = stops(cell, hosts, count, at_rest=noise, watched=watched, again=AGAIN)
            yield Row(case, f"lfield, {load}", samples=found)
            yield Row("", "sent and received for it", "kB", [size / 1000])
