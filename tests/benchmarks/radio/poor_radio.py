"""lfield on poor radio, compared with other protocols: hops, stops, outages, bytes at rest.

All parts except `virtual` run in network namespaces on an emulated radio (tests/radio/emulator), which needs
root. Several teams, each on its own radio, are measured at a time; their samples are combined.

    make bench ONLY=radio                                     2,000 samples of each, several hours
    make bench ONLY=radio ROUNDS=100                          100 samples of each
    PARTS=virtual make bench ONLY=radio                       stops in virtual time, two minutes, without root
    PARTS=stops CELLS='20 %,200 ms + 5 %' HOSTS=1 WAYS='command,page' make bench ONLY=radio ROUNDS=100
"""

from __future__ import annotations

import platform
import socket
from collections.abc import Callable, Iterator

from emulator.cells import CELLS
from emulator.tun import missing
from harness.checkout import Checkout
from harness.figure import Figure, Row
from harness.samples import Tick, chosen, sentence
from radio.radio_parts import hops, idle, outages, stops
from radio.radio_virtual import virtual

SAMPLES = 2000
#: A perfect radio, and the radios with a bound for stops.
STOP_CELLS = ("perfect", "20 %", "57.6 kbit/s + 100 ms + 5 %", "200 ms + 5 %")
#: TCP options and their numbers (linux/tcp.h).
OPTIONS = {
    "TCP_THIN_LINEAR_TIMEOUTS": 16,
    "TCP_RTO_MAX_MS": 44,
    "TCP_RTO_MIN_US": 45,
    "TCP_DELACK_MAX_US": 46,
}
#: A function that yields the rows of a cell.
Part = Callable[[Checkout, int, Tick, str], Iterator[Row]]
PARTS: dict[str, tuple[Part, tuple[str, ...]]] = {
    "hops": (hops, tuple(CELLS)),
    "stops": (stops, STOP_CELLS),
    "outages": (outages, ("50 ms",)),
    "idle": (idle, ("50 ms", "57.6 kbit/s + 100 ms + 5 %")),
    "virtual": (virtual, STOP_CELLS),
}


def rows(checkout: Checkout, samples: int, tick: Tick) -> Iterator[Row]:
    """The rows of all parts, or of those that $PARTS and $CELLS name."""
    reason = missing()
    for name in chosen("PARTS", tuple(PARTS)):
        part, cells = PARTS[name]
        if reason and part is not virtual:
            yield Row(name, "", error=reason)
            continue
        for cell in chosen("CELLS", cells):
            try:
                yield from part(checkout, samples, tick, cell)
            except Exception as error:
                yield Row(f"{name}, {cell}", "", error=sentence(error))


def kernel() -> str:
    """The TCP options of this kernel."""
    with socket.socket() as tried:
        return ", ".join(f"{name} {_has(tried, number)}" for name, number in OPTIONS.items())


def _has(tried: socket.socket, number: int) -> str:
    try:
        tried.getsockopt(socket.IPPROTO_TCP, number)
    except OSError:
        return "no"
    return "yes"


FIGURE = Figure(
    f"Poor radio; {platform.system()} {platform.release()}: {kernel()}",
    {},
    rounds=SAMPLES,
    own_rows=rows,
    one_size="the cells differ by the radio, not by a size",
    notes=(
        "round trips; loss of each direction; 57.6 kbit/s are one half-duplex channel for a whole team",
        "hops: two hops of a coordinator, against a request and an answer of 600 bytes",
        "stops: until every device has confirmed, as the desk sees it; pressed again where that fails",
        "outages: from the path's return until the next two hops, or the next answer, are complete;",
        "another address: from the change of the client's, or of the host where the coordinator starts",
        "virtual time: stops as datagrams on the model of the radio, without the computer's own delay",
        "bytes are those of IP packets of both directions, lost ones included",
    ),
)
