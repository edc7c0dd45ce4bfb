"""One read of six servos at once: the Dynamixel driver's bus beside the vendor's library, on the same fake.

Both run in this process; the guard's pipe, which costs every command the same, is left out.
"""

from __future__ import annotations

import dynamixel_sdk
from guards.exchanges import EXCHANGES, async_batches, batches
from harness.checkout import Checkout
from harness.figure import Figure
from harness.processes import Processes
from harness.samples import Contender

from lfield import event_loop
from lfield_dynamixel.bus.half_duplex_bus import Bus
from lfield_dynamixel.bus.servo_chain import Chain, Node
from lfield_dynamixel.driver import serial_port

SERVOS = tuple(range(1, 7))
#: The range from present current to present position of the X series.
START, SIZE = 126, 10
CASE = "six servos, fast sync read"


def _fake(checkout: Checkout, processes: Processes) -> str:
    servos = [word for number in SERVOS for word in ("--servo", f"{number}:XM430-W350")]
    return checkout.fake(processes, "dynamixel", *servos, "--baud", "4000000")


def vendor(checkout: Checkout, processes: Processes) -> Contender:
    """The SDK."""
    endpoint = _fake(checkout, processes)
    return lambda: {CASE: _vendor_reads(endpoint)}


def _vendor_reads(endpoint: str) -> list[float]:
    path, baud = endpoint.removeprefix("serial:").rsplit(":", 1)
    port = dynamixel_sdk.PortHandler(path)
    port.openPort()
    port.setBaudRate(int(baud))
    reader = dynamixel_sdk.GroupSyncRead(port, dynamixel_sdk.PacketHandler(2.0), START, SIZE)
    for number in SERVOS:
        reader.addParam(number)

    def exchange() -> None:
        # On a busy computer its deadline is sometimes too short; the time of that counts.
        while reader.fastSyncRead() != dynamixel_sdk.COMM_SUCCESS:
            pass

    try:
        return batches(exchange)
    finally:
        port.closePort()


def driver(checkout: Checkout, processes: Processes) -> Contender:
    """The driver's bus."""
    endpoint = _fake(checkout, processes)
    return lambda: {CASE: event_loop.run(_driver_reads(endpoint))}


async def _driver_reads(endpoint: str) -> list[float]:
    bus = Bus(lambda owner: serial_port(endpoint, owner, print), print, lambda: None)
    bus.open()
    chain, nodes = Chain(bus), [Node(number) for number in SERVOS]

    async def exchange() -> None:
        found = await chain.sync_read(nodes, START, SIZE)
        if len(found) < len(SERVOS):
            raise RuntimeError("a servo did not answer")

    try:
        return await async_batches(exchange)
    finally:
        bus.close()


FIGURE = Figure(
    "Dynamixel: seconds of an exchange; ratio to dynamixel_sdk",
    {"dynamixel_sdk": vendor, "lfield_dynamixel": driver},
    base=("dynamixel_sdk",),
    rounds=5,
    one_size="one exchange with one servo",
    targets={"lfield_dynamixel": "1.11x"},
    notes=(f"a sample is the mean of {EXCHANGES} exchanges",),
)
