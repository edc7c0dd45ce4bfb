"""The bus and its frames: arbitration, reception, errors. Pure: time is given.

A frame takes its time at the bit rate. When the bus becomes free the lowest rank of the waiting frames goes
first. A corrupted frame ends in an error frame and is repeated; transmit errors count as in ISO 11898-1 (8
up, 1 down) and above 255 the sender is bus-off until 128 times 11 bits have passed.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from typing import Any

from msgspec import Struct

from lfield_sim.faults import Fault, Faults, share

#: Valid lengths of a CAN FD frame, by data length code.
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
STANDARD_MASK, EXTENDED_MASK = 0x7FF, 0x1FFFFFFF

#: Ids of error frames as in Linux's can/error.h.
ERROR_PROTOCOL, ERROR_BUS_OFF = 0x20000088, 0x20000040
#: Recessive bits after which a bus-off node participates again.
RECOVERY_BITS = 128 * 11
WARNING, PASSIVE, BUS_OFF = 96, 128, 256

#: Fault lookup of one device: name in, value out.
FaultLookup = Callable[[str], Any]

#: Faults of the bus or of one device (`NAME@NODE=VALUE`).
FAULTS = (
    share("loss", "frames that a device sends or receives are lost"),
    share("corrupt", "frames end in an error frame; the sender retries until it is bus-off"),
    Fault("delay", 0.0, "seconds that a device's frames are late", 0.0, 10.0),
    Fault("bus_off", False, "off the bus, its motor continues; for the whole bus: nothing is transmitted"),
    Fault("unplug", False, "the adapters: clients are disconnected, until it is false again"),
    Fault("silence", False, "without power; on its return the device restarts"),
    Fault("stuck", False, "the motor does not move"),
    Fault("overcurrent", False, "the power stage trips"),
    Fault("overheat", False, "130 degrees Celsius: the power stage trips"),
    Fault("follow_error", False, "the drive reports a following error (an ODrive: spinout)"),
    Fault("lost_heartbeat", False, "the heartbeat is not sent, everything else is"),
    Fault("lost_tpdo", False, "periodic telemetry is not sent (TPDOs, cyclic and status messages)"),
    share("nonsense", "answers to requests are random bytes"),
)


class CanFrame(Struct, frozen=True):
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
        """The lowest rank of simultaneous frames wins: standard before extended, data before remote."""
        if self.extended:
            return self.identifier >> 18, True, self.identifier & 0x3FFFF, self.remote
        return self.identifier, False, 0, self.remote

    def seconds(self, bitrate: float, data_bitrate: float) -> float:
        """The time on the wire, with interframe space, without stuff bits."""
        head = 67 if self.extended else 47
        if not self.fd:
            return (head + 8 * len(self.data)) / bitrate
        fast = data_bitrate if self.switch else bitrate
        return (head - 15) / bitrate + (8 * len(self.data) + 26) / fast


class BusPort(Struct, eq=False):
    """A connection to the bus. `device` is its id for faults, '' for an adapter; `on_frame` gets frame and
    time.

    A port with a bit rate other than the bus's neither sends nor receives.
    """

    on_frame: Callable[[CanFrame, float], None]
    device: str = ""
    bitrate: int = 0
    waiting: int = 0
    errors: int = 0
    off_until: float = 0.0

    def can_communicate(self, now: float, bitrate: int) -> bool:
        """Whether the port can send and receive now."""
        return now >= self.off_until and self.bitrate in (0, bitrate)


class CanBus:
    """The wire between ports. Times are seconds on the caller's clock."""

    def __init__(self, faults: Faults, *, bitrate: int, data_bitrate: int, seed: int = 1) -> None:
        self.bitrate, self._data_bitrate = bitrate, data_bitrate
        self._faults = faults
        self._random = random.Random(seed)
        self._ports: list[BusPort] = []
        self._count = itertools.count()
        #: Frames by the earliest time of sending, and those that compete for the bus.
        self._later: list[tuple[float, int, CanFrame, BusPort]] = []
        self._ready: list[tuple[tuple[int, bool, int, bool], int, CanFrame, BusPort]] = []
        self._current: tuple[CanFrame, BusPort] | None = None
        self._free_at = 0.0

    def attach(self, port: BusPort) -> None:
        """Attaches a port."""
        self._ports.append(port)

    def detach(self, port: BusPort) -> None:
        """Detaches a port; its queued frames are still sent."""
        self._ports.remove(port)

    def send(self, port: BusPort, frame: CanFrame, now: float) -> None:
        """Queues a port's frame."""
        port.waiting += 1
        ready_at = now + float(self._faults.get("delay", port.device))
        heapq.heappush(self._later, (ready_at, next(self._count), frame, port))

    def due(self) -> float:
        """The time when `advance` is next due; infinity when the bus is idle."""
        if self._current:
            return self._free_at
        if self._ready:
            return self._free_at
        return max(self._free_at, self._later[0][0]) if self._later else float("inf")

    def advance(self, now: float) -> None:
        """Starts and ends every transmission due by `now`."""
        while self.due() <= now:
            if self._current:
                frame, port = self._current
                self._current = None
                self._finish(frame, port, self._free_at)
            else:
                self._start(self.due())

    def announce(self, error: int, now: float) -> None:
        """Reports an error condition to every adapter."""
        for port in list(self._ports):
            if not port.device:
                port.on_frame(CanFrame(error, error=True), now)

    def _start(self, now: float) -> None:
        """Arbitration: the lowest rank of all waiting frames."""
        while self._later and self._later[0][0] <= now:
            _, number, frame, port = heapq.heappop(self._later)
            heapq.heappush(self._ready, (frame.rank, number, frame, port))
        _, _, frame, port = heapq.heappop(self._ready)
        self._current = (frame, port)
        self._free_at = now + frame.seconds(self.bitrate, self._data_bitrate)

    def _finish(self, frame: CanFrame, port: BusPort, now: float) -> None:
        if not port.can_communicate(now, self.bitrate) or self._cut_off(port):
            port.waiting -= 1
        elif self._random.random() < self._faults.get("corrupt", port.device):
            self._corrupted(frame, port, now)
        else:
            port.waiting -= 1
            port.errors = max(0, port.errors - 1)
            sender_loss = self._faults.get("loss", port.device)
            for other in list(self._ports):
                if other is not port and other.can_communicate(now, self.bitrate):
                    self._deliver(frame, sender_loss, other, now)

    def _corrupted(self, frame: CanFrame, port: BusPort, now: float) -> None:
        port.errors += 8
        self.announce(ERROR_PROTOCOL, now)
        if port.errors < BUS_OFF:
            heapq.heappush(self._later, (now, next(self._count), frame, port))
            return
        port.waiting -= 1
        port.errors, port.off_until = 0, now + RECOVERY_BITS / self.bitrate
        if not port.device:
            port.on_frame(CanFrame(ERROR_BUS_OFF, error=True), now)

    def _deliver(self, frame: CanFrame, sender_loss: float, other: BusPort, now: float) -> None:
        loss = max(sender_loss, self._faults.get("loss", other.device))
        if not self._cut_off(other) and self._random.random() >= loss:
            other.on_frame(frame, now)

    def _cut_off(self, port: BusPort) -> bool:
        return bool(self._faults.get("bus_off", port.device))
