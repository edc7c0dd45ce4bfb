"""Echo round trips per second through the doors of the fake: `python tests/can/can_fake_echo.py`."""

from __future__ import annotations

import contextlib
import time

import can
from can_fake_bench import running, serial, tcp

ROUNDS = 1000


def receive(bus: can.BusABC, identifier: int) -> None:
    """Wait for a frame."""
    while True:
        message = bus.recv(5.0)
        if message is not None and message.arbitration_id == identifier:
            return


def echoes(a: can.BusABC, b: can.BusABC) -> float:
    """Round trips per second of frames with 8 bytes; one thread plays both ends."""
    there, back = (can.Message(arbitration_id=n, data=bytes(8), is_extended_id=False) for n in (1, 2))
    start = time.perf_counter()
    for _ in range(ROUNDS):
        a.send(there)
        receive(b, 1)
        b.send(back)
        receive(a, 2)
    return ROUNDS / (time.perf_counter() - start)


def main() -> None:
    """Print the figures, each with a fake of its own."""
    socketcand, slcan = ("socketcand:127.0.0.1:0", tcp), ("slcan-pty", serial)
    for one, other in ((socketcand, socketcand), (socketcand, slcan), (slcan, slcan)):
        with contextlib.ExitStack() as stack:
            _, words = stack.enter_context(running("--listen", one[0], "--listen", other[0]))
            a, b = (
                stack.enter_context(can.Bus(**place(word)))
                for (_, place), word in zip((one, other), words[1:], strict=True)
            )
            a.recv(0.2), b.recv(0.2)
            print(f"{one[0]} <-> {other[0]}: {echoes(a, b):.0f}/s")


if __name__ == "__main__":
    main()
