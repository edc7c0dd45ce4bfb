"""The bus and its frames: who transmits when, who hears it, what goes wrong. Pure: time is given.

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
from typing import Any

from lfield_sim.faults import Fault, Faults, share

#: The lengths that a CAN FD frame can have, by data length code.
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
STANDARD_MASK, EXTENDED_MASK = 0x7FF, 0x1FFFFFFF

#: Error frames carry, as in Linux's can/error.h, what happened in their identifier.
ERROR_PROTOCOL, ERROR_BUS_OFF = 0x20000088, 0x20000040
#: Bits of recessive level after which a bus-off node takes part again.
RECOVERY_BITS = 128 * 11
WARNING, PASSIVE, BUS_OFF = 96, 128, 256

#: A fault as one device sees it: its name in, its value out.
Flaw = Callable[[str], Any]

#: What can go wrong, for the bus or for one device (`NAME@NODE=VALUE`).
FAULTS = (
    share("loss", "frames that a device sends or should hear are lost without a trace"),
    share("corrupt", "frames end in an error frame; the sender tries again until it is bus-off"),
    Fault("delay", 0.0, "seconds that a device's frames come late", 0.0, 10.0),
    Fault("bus_off", False, "off the bus, its motor goes on; for the whole bus: nothing gets through"),
    Fault("unplug", False, "the doors: clients are thrown out, until it is false again"),
    Fault("silence", False, "without power; when it returns it starts anew"),
    Fault("stuck", False, "the motor does not move"),
    Fault("overcurrent", False, "the power stage trips"),
    Fault("overheat", False, "130 degrees Celsius: the power stage trips"),
    Fault("follow_error", False, "the drive reports a following error (an ODrive: spinout)"),
    Fault("lost_heartbeat", False, "the heartbeat is not sent, the rest is"),
    Fault("lost_tpdo", False, "periodic telemetry is not sent (TPDOs, cyclic and status messages)"),
    share("nonsense", "answers to requests are random bytes"),
)


@dataclass(frozen=True, slots=True)
class Frame:
    """A data, remote or error frame (ISO 11898-1).

    `dlc` is that of remote frames, `switch` the FD bit rate switch.
    """

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    dlc: int = 0
    fd: bool = False
    switch: bool = False
    error: bool = False

    @property
    def rank(self) -> tuple[int, bool, int, bool]:
        """Of frames that start together the lowest wins: standard before extended, data before remote."""
        if self.extended:
            return self.identifier >> 18, True, self.identifier & 0x3FFFF, self.remote
        return self.identifier, False, 0, self.remote

    def seconds(self, bitrate: float, data_bitrate: float) -> float:
        """The time on the wire, interframe space included, stuff bits not."""
        head = 67 if self.extended else 47
        if not self.fd:
            return (head + 8 * len(self.data)) / bitrate
        fast = data_bitrate if self.switch else bitrate
        return (head - 15) / bitrate + (8 * len(self.data) + 26) / fast


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
