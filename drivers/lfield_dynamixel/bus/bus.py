"""The half-duplex bus: one exchange at a time, on the loop of the guard, each with a deadline.

An exchange is a packet sent and the answers to it. It always runs to its end, whatever becomes of the one who
asked: an answer that nobody waits for any more must not be taken for the answer to the next question. What
is urgent (a safe state) goes before what waits; it waits at most for the exchange under way.
"""

from __future__ import annotations

import asyncio
import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Protocol

from lfield.driver.serial import PortEvents
from lfield_dynamixel.bus.packets import AnyProtocol, EchoFilter, Reader, Status, harmless

#: Seconds that a servo and this computer may take beyond what the wire needs.
SLACK = 0.025
#: How often at most it is looked whether the adapter returns what is sent.
SEARCHES = 3

#: How urgent an exchange is.
SAFETY, COMMAND, POLL = range(3)


class Port(Protocol):
    """What a bus needs of its port. `latency` is how long bytes may be held back on the way, in seconds."""

    baud: int
    latency: float

    def open(self) -> None:
        """Open it. Raises DeviceError when that is impossible here and now."""

    def write(self, data: bytes) -> bool:
        """Send a packet, at once; whether that worked."""

    def close(self) -> None:
        """Give it back."""


MakePort = Callable[[PortEvents], Port]


@dataclass(slots=True)
class Exchange:
    """A packet, who is to answer it (nobody: empty), and what has come so far.

    One that `listens` takes in every byte until its time is over.
    """

    packet: bytes
    numbers: tuple[int, ...]
    size: int
    seconds: float
    reader: Reader
    done: asyncio.Future[list[Status]]
    listens: bool = False
    answers: list[Status] = field(default_factory=list)
    heard: bytes = b""
    sent: bool = False

    def take(self, status: Status) -> None:
        """Keep an answer of one who was asked, if it has the bytes that were asked for or says why not.

        What comes from others, or in another length, is late: the answer to an older question.
        """
        fits = len(status.data) == self.size or (status.error != 0 and not status.data)
        if fits and status.number in self.numbers and all(status.number != a.number for a in self.answers):
            self.answers.append(status)

    @property
    def complete(self) -> bool:
        """Whether everyone has answered; a fast answer stands for all."""
        return len(self.answers) == len(self.numbers)


class Bus:
    """The exchanges on one port. `on_lost` and `on_back` tell what becomes of the port."""

    def __init__(
        self,
        make_port: MakePort,
        on_lost: Callable[[str], None],
        on_back: Callable[[], None],
        on_echo: Callable[[], None] = lambda: None,
    ) -> None:
        self._make_port = make_port
        self._port: Port | None = None
        self._on_lost, self._on_back, self._on_echo = on_lost, on_back, on_echo
        self._waiting: list[tuple[int, int, Exchange]] = []
        self._order = count()
        self._current: Exchange | None = None
        self._timer: asyncio.TimerHandle | None = None
        #: Takes out what the adapter returns of what is sent, if it does; None until that is known.
        self._echo: EchoFilter | None = None
        self._echoes = False
        self._search = asyncio.Lock()
        self.gone = ""

    def open(self) -> None:
        """Make the port and open it. Raises DeviceError."""
        self._port = self._make_port(self)
        self._port.open()

    def close(self) -> None:
        """Give the port back; whoever waits gets no answers."""
        if self._port is not None:
            self._port.close()
        self._abandon()

    async def exchange(
        self,
        protocol: AnyProtocol,
        packet: bytes,
        numbers: tuple[int, ...],
        size: int,
        *,
        urgency: int = COMMAND,
    ) -> list[Status]:
        """Send a packet and return the answers that came in time, of `size` bytes of data each.

        `numbers` are the ids that are to answer; the broadcast id stands for the one packet that answers a
        fast sync read. Raises nothing: a port that is gone gives no answers.
        """
        if self._echo is None:
            await self._look_for_echo(protocol, urgency)
        exchange = self._exchange(protocol, packet, numbers, size)
        return await self._carried_out(exchange, urgency)

    async def listen(
        self, protocol: AnyProtocol, packet: bytes, size: int, *, urgency: int = COMMAND
    ) -> bytes:
        """Send a packet and return every byte that comes in the time that two answers of `size` take.

        What an adapter returns of the packet itself is taken out. Raises nothing.
        """
        if self._echo is None:
            await self._look_for_echo(protocol, urgency)
        exchange = self._exchange(protocol, packet, (0, 0), size, listens=True)
        await self._carried_out(exchange, urgency)
        return exchange.heard

    async def _look_for_echo(self, protocol: AnyProtocol, urgency: int) -> None:
        """Send what nobody answers, and see whether it comes back: an adapter may return what is sent.

        In protocol 1.0 an instruction looks like an answer, so this must be known before anybody is asked.
        """
        async with self._search:
            if self._echo is not None or self.gone:
                return
            for _ in range(SEARCHES):
                exchange = self._exchange(protocol, harmless(protocol), (0,), 0, listens=True)
                await self._carried_out(exchange, urgency)
                echoes = exchange.packet in exchange.heard
                # What came may be an echo that was damaged, as of the first bytes after a port was opened.
                if echoes or not exchange.heard:
                    break
            if exchange.sent and not self.gone:
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
        assert self._port is not None, "the bus is opened first"
        answer = (protocol.overhead + size) * len(numbers)
        on_wire = 10.0 * (len(packet) + answer) / self._port.baud
        late = 2.0 * self._port.latency + SLACK if numbers else 0.0
        done = asyncio.get_running_loop().create_future()
        return Exchange(packet, numbers, size, on_wire + late, protocol.reader(), done, listens)

    async def _carried_out(self, exchange: Exchange, urgency: int) -> list[Status]:
        heapq.heappush(self._waiting, (urgency, next(self._order), exchange))
        if self._current is None:
            self._next()
        return await exchange.done

    def received(self, data: bytes) -> None:
        """Bytes from the port; what comes while nobody is asked is nobody's answer."""
        if self._echo is not None and self._echoes:
            data = self._echo.strip(data)
        current = self._current
        if current is None:
            return
        if current.listens:
            current.heard += data
            return
        for status in current.reader.feed(data):
            current.take(status)
        if current.numbers and current.complete:
            self._finish()

    def lost(self, reason: str) -> None:
        """The port has gone; another adapter may come back."""
        self.gone, self._echo = reason, None
        self._abandon()
        self._on_lost(reason)

    def back(self) -> None:
        """The port is open again."""
        self.gone = ""
        self._on_back()

    def _abandon(self) -> None:
        while self._waiting:
            exchange = heapq.heappop(self._waiting)[2]
            if not exchange.done.done():
                exchange.done.set_result([])
        if self._current is not None:
            self._finish()

    def _next(self) -> None:
        """Start the most urgent exchange; those whose askers have left before they began are dropped."""
        while self._waiting and self._current is None:
            exchange = heapq.heappop(self._waiting)[2]
            if exchange.done.done():
                continue
            self._current = exchange
            if self._echo is not None:
                self._echo.on_sent(exchange.packet)
            exchange.sent = self._port is not None and self._port.write(exchange.packet)
            # A port that fails while it is written has abandoned this exchange already.
            if self._current is exchange:
                self._timer = asyncio.get_running_loop().call_later(
                    exchange.seconds if exchange.sent else 0.0, self._finish
                )

    def _finish(self) -> None:
        """The exchange is over: everyone has answered, or the time is."""
        exchange, self._current = self._current, None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        assert exchange is not None, "only a running exchange ends"
        if not exchange.done.done():
            exchange.done.set_result(exchange.answers)
        self._next()
