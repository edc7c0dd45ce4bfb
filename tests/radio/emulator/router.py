"""The process between the robots: packets from and to their TUN devices, through the model of the radio.

`python -m emulator.router` reads one JSON object a line from stdin and answers each with one line. The
first line has the seed and, for each robot, its name, its addresses and the id of a process in its network
namespace. The router ends at the end of stdin.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from emulator.cells import Cell, Link
from emulator.packets import Header, read_header
from emulator.radio_model import Air
from emulator.tun import open_tun

#: Packets that are read from one device before the next device is read.
_MAX_READS = 64
_LARGEST = 1 << 16
#: In a count: packets, bytes, packets lost, packets with payload, bytes of payload.
FIELDS = 5


class Router:
    """The devices, the model and the counts."""

    def __init__(self, seed: int, robots: list[dict[str, Any]]) -> None:
        self._names = [robot["name"] for robot in robots]
        self._tuns = [open_tun(robot["pid"]) for robot in robots]
        self._at = {packed(a): n for n, robot in enumerate(robots) for a in robot["addresses"]}
        self._air = Air(self._names, seed)
        self._counts: dict[tuple[str, str, int, int], list[int]] = {}
        self._orders: Mapping[str, Callable[..., object]] = {
            "cell": lambda cell: self._air.set_cell(Cell.from_json(cell)),
            "link": lambda link, one, other: self._air.set_link(Link(**link), *self._numbers(one, other)),
            "cut": self._cut,
            "mend": self._air.mend,
            "move": self._move,
            "counts": lambda: [[*flow, *count] for flow, count in self._counts.items()],
            "reset": self._counts.clear,
        }

    def serve(self) -> None:
        """Serve requests and packets until the end of stdin."""
        control = sys.stdin.fileno()
        numbers = {tun: number for number, tun in enumerate(self._tuns)}
        unread = b""
        while True:
            event = self._air.next_event()
            timeout = None if event is None else max(0.0, event - time.monotonic())
            for descriptor in select.select([control, *numbers], (), (), timeout)[0]:
                if descriptor != control:
                    self._read(numbers[descriptor])
                    continue
                data = os.read(control, _LARGEST)
                if not data:
                    return
                *lines, unread = (unread + data).split(b"\n")
                for line in lines:
                    self._answer(json.loads(line))
            for to, packet in self._air.advance(time.monotonic()):
                self._write(to, packet)
            for (source, to), packet in self._air.pop_lost():
                if header := read_header(packet):
                    self._count(self._names[source], self._names[to], header)[2] += 1

    def _read(self, source: int) -> None:
        for _ in range(_MAX_READS):
            try:
                packet = os.read(self._tuns[source], _LARGEST)
            except BlockingIOError:
                return
            header = read_header(packet)
            if header is None:
                continue
            to = self._at.get(header.to)
            count = self._count(self._names[source], "" if to is None else self._names[to], header)
            count[0] += 1
            count[1] += header.size
            count[2] += to is None
            count[3] += header.payload > 0
            count[4] += header.payload
            if to is not None:
                self._air.send(time.monotonic(), source, to, packet)

    def _write(self, to: int, packet: bytes) -> None:
        try:
            os.write(self._tuns[to], packet)
        except OSError:
            # The device is down, or its queue is full: the packet is lost, as on a real interface.
            return

    def _count(self, source: str, to: str, header: Header) -> list[int]:
        return self._counts.setdefault((source, to, header.protocol, header.port), [0] * FIELDS)

    def _answer(self, order: dict[str, Any]) -> None:
        answer = self._orders[order.pop("do")](**order)
        print(json.dumps(answer), flush=True)

    def _cut(self, seconds: float, one: str, other: str | None = None) -> None:
        """Cut one robot from another, or from all others."""
        for name in [other] if other else [name for name in self._names if name != one]:
            number, of_name = self._numbers(one, name)
            self._air.cut(number, of_name, time.monotonic() + seconds)

    def _move(self, one: str, addresses: list[str]) -> None:
        (number,) = self._numbers(one)
        self._at = {address: n for address, n in self._at.items() if n != number}
        self._at |= {packed(address): number for address in addresses}

    def _numbers(self, *names: str) -> list[int]:
        return [self._names.index(name) for name in names]


def packed(address: str) -> bytes:
    """An address in the bytes of a packet."""
    return socket.inet_pton(socket.AF_INET6 if ":" in address else socket.AF_INET, address)


def main() -> None:
    """Route packets, with real-time priority if permitted: CPU load must not add delay."""
    with open(sys.stdin.fileno(), "rb", buffering=0, closefd=False) as control:
        options = json.loads(control.readline())
    # Ctrl-C is handled by the parent process, which then closes stdin.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    router = Router(**options)
    print(json.dumps("ready"), flush=True)
    router.serve()


if __name__ == "__main__":
    main()
