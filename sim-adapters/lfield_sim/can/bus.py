"""The bus: who transmits when, who hears it, and what is lost on the way. Pure: time is given.

A frame takes its time at the bit rate. Of the frames that wait when the bus becomes free the lowest rank goes
first. A corrupted frame ends in an error frame and is repeated; transmit errors count by ISO 11898-1 (8 up,
1 down) and above 255 the sender is bus-off until 128 times 11 bits have passed.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass

from lfield_sim.can.frame import ERROR_BUS_OFF, ERROR_PROTOCOL, Frame
from lfield_sim.faults import Faults

#: Bits of recessive level after which a bus-off node takes part again.
RECOVERY_BITS = 128 * 11
WARNING, PASSIVE, BUS_OFF = 96, 128, 256


@dataclass(slots=True, eq=False)
class Port:
    """One connection to the bus. `device` is its id for faults, '' for a door; `hear` gets frame and time.

    A port with a bit rate of its own that is not that of the bus neither sends nor hears.
    """

    hear: Callable[[Frame, float], None]
    device: str = ""
    bitrate: int = 0
    waiting: int = 0
    errors: int = 0
    off_until: float = 0.0

    def take_part(self, now: float, bitrate: int) -> bool:
        """Whether it can send and hear now."""
        return now >= self.off_until and self.bitrate in (0, bitrate)


class Bus:
    """The wire between ports. Times are seconds on the caller's clock."""

    def __init__(self, faults: Faults, *, bitrate: int, data_bitrate: int, seed: int = 1) -> None:
        self.bitrate, self._data_bitrate = bitrate, data_bitrate
        self._faults = faults
        self._random = random.Random(seed)
        self._ports: list[Port] = []
        self._count = itertools.count()
        #: Frames by the time from which they want to be sent, and those that compete for the free bus.
        self._later: list[tuple[float, int, Frame, Port]] = []
        self._ready: list[tuple[tuple[int, bool, int, bool], int, Frame, Port]] = []
        self._current: tuple[Frame, Port] | None = None
        self._free_at = 0.0

    def attach(self, port: Port) -> None:
        """Let a port send and hear."""
        self._ports.append(port)

    def detach(self, port: Port) -> None:
        """Forget a port; what it has waiting is still sent."""
        self._ports.remove(port)

    def send(self, port: Port, frame: Frame, now: float) -> None:
        """Let a port's frame wait for the bus."""
        port.waiting += 1
        ready = now + float(self._faults.get("delay", port.device))
        heapq.heappush(self._later, (ready, next(self._count), frame, port))

    def due(self) -> float:
        """When `advance` has the next thing to do; infinity when the bus is quiet."""
        if self._current:
            return self._free_at
        if self._ready:
            return self._free_at
        return max(self._free_at, self._later[0][0]) if self._later else float("inf")

    def advance(self, now: float) -> None:
        """Start and end every transmission that is due by `now`."""
        while self.due() <= now:
            if self._current:
                frame, port = self._current
                self._current = None
                self._finish(frame, port, self._free_at)
            else:
                self._start(self.due())

    def announce(self, error: int, now: float) -> None:
        """Tell every door of an error condition."""
        for port in list(self._ports):
            if not port.device:
                port.hear(Frame(error, error=True), now)

    def _start(self, now: float) -> None:
        """Arbitration: the lowest rank of all that wait."""
        while self._later and self._later[0][0] <= now:
            _, number, frame, port = heapq.heappop(self._later)
            heapq.heappush(self._ready, (frame.rank, number, frame, port))
        _, _, frame, port = heapq.heappop(self._ready)
        self._current = (frame, port)
        self._free_at = now + frame.seconds(self.bitrate, self._data_bitrate)

    def _finish(self, frame: Frame, port: Port, now: float) -> None:
        if not port.take_part(now, self.bitrate) or self._cut_off(port):
            port.waiting -= 1
        elif self._random.random() < self._faults.get("corrupt", port.device):
            self._corrupted(frame, port, now)
        else:
            port.waiting -= 1
            port.errors = max(0, port.errors - 1)
            for other in list(self._ports):
                if other is not port and other.take_part(now, self.bitrate):
                    self._deliver(frame, port, other, now)

    def _corrupted(self, frame: Frame, port: Port, now: float) -> None:
        port.errors += 8
        self.announce(ERROR_PROTOCOL, now)
        if port.errors < BUS_OFF:
            heapq.heappush(self._later, (now, next(self._count), frame, port))
            return
        port.waiting -= 1
        port.errors, port.off_until = 0, now + RECOVERY_BITS / self.bitrate
        if not port.device:
            port.hear(Frame(ERROR_BUS_OFF, error=True), now)

    def _deliver(self, frame: Frame, port: Port, other: Port, now: float) -> None:
        loss = max(self._faults.get("loss", port.device), self._faults.get("loss", other.device))
        if not self._cut_off(other) and self._random.random() >= loss:
            other.hear(frame, now)

    def _cut_off(self, port: Port) -> bool:
        return bool(self._faults.get("bus_off", port.device))
