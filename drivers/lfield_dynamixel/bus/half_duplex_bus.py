"""The half-duplex bus: one exchange at a time, on the loop of the guard, each with a deadline.

An exchange is a packet and its answers. It always completes, even if its caller was cancelled: a late answer
must not count as the answer to the next request. Urgent exchanges (safe states) go first; they wait at most
for the present one.
"""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable
from itertools import count
from typing import Protocol

from msgspec import Struct, field

from lfield.driver import WireLog
from lfield.driver.serial import PortEvents
from lfield_dynamixel.bus.packets import AnyProtocol, EchoFilter, Reader, Status, harmless

#: Seconds for servo and computer in addition to the transmission time.
EXTRA_TIME = 0.025
#: Maximum attempts to detect an echo of the adapter.
SEARCHES = 3

#: Urgency of an exchange.
SAFETY, COMMAND, POLL = range(3)


class Port(Protocol):
    """The interface of a port to its bus. `latency` is the longest delay of received bytes, in seconds."""

    baud: int
    latency: float

    def open(self) -> None:
        """Opens the port. Raises DeviceError when that is impossible now."""

    def write(self, data: bytes) -> bool:
        """Sends a packet without waiting; returns whether that succeeded."""

    def close(self) -> None:
        """Closes the port."""


MakePort = Callable[[PortEvents], Port]


class Exchange(Struct):
    """A packet, the ids that must answer (none: empty), and the received answers.

    With `listens` it collects every byte until its deadline.
    """

    packet: bytes
    numbers: tuple[int, ...]
    size: int
    seconds: float
    reader: Reader
    done: asyncio.Future[list[Status]]
    listens: bool = False
    answers: list[Status] = field(default_factory=list)
    received: bytes = b""
    sent: bool = False

    def on_status(self, status: Status) -> None:
        """Stores an answer with the requested length, or an error, of an expected id.

        Others are late answers to an earlier request.
        """
        fits = len(status.data) == self.size or (status.error != 0 and not status.data)
        if fits and status.number in self.numbers and all(status.number != a.number for a in self.answers):
            self.answers.append(status)

    @property
    def complete(self) -> bool:
        """Whether all servos have answered; a fast answer counts for all."""
        return len(self.answers) == len(self.numbers)


class Bus:
    """The exchanges on one port, logged in `wire_log`. `on_lost` and `on_back` report its loss and return."""

    def __init__(
        self,
        make_port: MakePort,
        on_lost: Callable[[str], None],
        on_back: Callable[[], None],
        on_echo: Callable[[], None] = lambda: None,
        wire_log: WireLog | None = None,
    ) -> None:
        self._make_port, self._wire_log = make_port, wire_log
        self._port: Port | None = None
        self._on_lost, self._on_back, self._on_echo = on_lost, on_back, on_echo
        self._waiting: list[tuple[int, int, Exchange]] = []
        self._order = count()
        self._current: Exchange | None = None
        self._timer: asyncio.TimerHandle | None = None
        #: Removes the adapter's echo, if it has one; None until that is known.
        self._echo: EchoFilter | None = None
        self._echoes = False
        self._search = asyncio.Lock()
        self.is_lost = ""

    def open(self) -> None:
        """Creates the port and opens it. Raises DeviceError."""
        self._port = self._make_port(self)
        self._port.open()

    def close(self) -> None:
        """Closes the port; pending exchanges end without answers."""
        if self._port is not None:
            self._port.close()
        self._cancel_all()

    async def exchange(
        self,
        protocol: AnyProtocol,
        packet: bytes,
        numbers: tuple[int, ...],
        size: int,
        *,
        urgency: int = COMMAND,
    ) -> list[Status]:
        """Sends a packet and returns the answers that arrived in time, of `size` bytes of data each.

        `numbers` are the ids that must answer; the broadcast id stands for the one packet that answers a fast
        sync read. Raises nothing: without a port there are no answers.
        """
        if self._echo is None:
            await self._probe_echo(protocol, urgency)
        exchange = self._exchange(protocol, packet, numbers, size)
        return await self._execute(exchange, urgency)

    async def listen(
        self, protocol: AnyProtocol, packet: bytes, size: int, *, urgency: int = COMMAND
    ) -> bytes:
        """Sends a packet and returns every byte received in the time that two answers of `size` take.

        Without an echo of the packet itself. Raises nothing.
        """
        if self._echo is None:
            await self._probe_echo(protocol, urgency)
        exchange = self._exchange(protocol, packet, (0, 0), size, listens=True)
        await self._execute(exchange, urgency)
        return exchange.received

    async def _probe_echo(self, protocol: AnyProtocol, urgency: int) -> None:
        """Sends a packet without an answer to detect whether the adapter echoes.

        In protocol 1.0 an instruction looks like an answer, so this must be known before any request.
        """
        async with self._search:
            if self._echo is not None or self.is_lost:
                return
            for _ in range(SEARCHES):
                exchange = self._exchange(protocol, harmless(protocol), (0,), 0, listens=True)
                await self._execute(exchange, urgency)
                echoes = exchange.packet in exchange.received
                # Received bytes may be a damaged echo, such as the first bytes after opening a port.
                if echoes or not exchange.received:
                    break
            if exchange.sent and not self.is_lost:
                self._echo, self._echoes = EchoFilter(), echoes
                if echoes:
                    self._on_echo()

    def _exchange(
        self,
        protocol: AnyProtocol,
        packet: bytes,
        numbers: tuple[int, ...],
        size: int,
        *,
        listens: bool = False,
    ) -> Exchange:
        assert self._port is not None, "the bus is open here"
        answer_bytes = (protocol.overhead + size) * len(numbers)
        transmission_time = 10.0 * (len(packet) + answer_bytes) / self._port.baud
        delay = 2.0 * self._port.latency + EXTRA_TIME if numbers else 0.0
        done = asyncio.get_running_loop().create_future()
        return Exchange(packet, numbers, size, transmission_time + delay, protocol.reader(), done, listens)

    async def _execute(self, exchange: Exchange, urgency: int) -> list[Status]:
        heapq.heappush(self._waiting, (urgency, next(self._order), exchange))
        if self._current is None:
            self._next()
        return await exchange.done

    def received(self, data: bytes) -> None:
        """Handles bytes from the port; outside an exchange they are ignored."""
        if self._wire_log is not None:
            self._wire_log.log_bytes(data, is_sent=False)
        if self._echo is not None and self._echoes:
            data = self._echo.strip(data)
        current = self._current
        if current is None:
            return
        if current.listens:
            current.received += data
            return
        for status in current.reader.feed(data):
            current.on_status(status)
        if current.numbers and current.complete:
            self._finish()

    def lost(self, reason: str) -> None:
        """Ends the exchanges after a loss of the port; another adapter may replace it."""
        self.is_lost, self._echo = reason, None
        self._cancel_all()
        self._on_lost(reason)

    def back(self) -> None:
        """Reports that the port is open again."""
        self.is_lost = ""
        self._on_back()

    def _cancel_all(self) -> None:
        while self._waiting:
            exchange = heapq.heappop(self._waiting)[2]
            if not exchange.done.done():
                exchange.done.set_result([])
        if self._current is not None:
            self._finish()

    def _next(self) -> None:
        """Starts the most urgent exchange; drops those whose callers were cancelled before."""
        while self._waiting and self._current is None:
            exchange = heapq.heappop(self._waiting)[2]
            if exchange.done.done():
                continue
            self._current = exchange
            if self._echo is not None:
                self._echo.on_sent(exchange.packet)
            exchange.sent = self._port is not None and self._port.write(exchange.packet)
            if exchange.sent and self._wire_log is not None:
                self._wire_log.log_bytes(exchange.packet, is_sent=True)
            # A port that fails in the write has ended this exchange already.
            if self._current is exchange:
                self._timer = asyncio.get_running_loop().call_later(
                    exchange.seconds if exchange.sent else 0.0, self._finish
                )

    def _finish(self) -> None:
        """Ends the exchange when it is complete, or its deadline has passed."""
        exchange, self._current = self._current, None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        assert exchange is not None, "only a running exchange ends"
        if not exchange.done.done():
            exchange.done.set_result(exchange.answers)
        self._next()
