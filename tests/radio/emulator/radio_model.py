"""The model of the radio: losses and arrival times of packets, without a clock or a socket."""

from __future__ import annotations

import heapq
import random
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from emulator.cells import Cell, Link
from emulator.channel import SharedChannel

#: Sender and receiver.
Direction = tuple[int, int]


class Delivery(NamedTuple):
    """A packet that reaches a robot."""

    to: int
    packet: bytes


class _Sent(NamedTuple):
    direction: Direction
    packet: bytes
    lost: bool
    jitter: float


class _Fades:
    """The times in which a pair loses all packets. The times of successive calls must not decrease."""

    def __init__(self, link: Link, start: float, rng: random.Random) -> None:
        self._rng, self._until, self._faded = rng, start, True
        self._means = {True: link.burst, False: link.burst * (1 - link.fade) / link.fade}

    def at(self, now: float) -> bool:
        """Whether the pair is in a fade."""
        while self._until <= now:
            self._faded = not self._faded
            self._until += self._rng.expovariate(1 / self._means[self._faded])
        return self._faded


class Air:
    """Robots, by number, that send packets to each other.

    Events are `send`, `cut`, `mend` and the setters, in the order of time; the effects are the deliveries
    and losses that `advance` and `pop_lost` return. `next_event` says when to call `advance`. The n-th
    packet of a direction has the same loss and jitter for the same seed, independently of other directions.
    """

    def __init__(self, names: Sequence[str], seed: int) -> None:
        self._names, self._seed = names, seed
        self._cell, self._links = Cell(), dict[Direction, Link]()
        self._channel: SharedChannel[_Sent] | None = None
        self._rng: dict[Direction, random.Random] = {}
        self._fades: dict[Direction, _Fades] = {}
        self._cut_until: defaultdict[Direction, float] = defaultdict(float)
        self._last_arrival: defaultdict[Direction, float] = defaultdict(float)
        self._in_flight: list[tuple[float, int, Delivery]] = []
        self._count = 0
        self._lost: list[tuple[Direction, bytes]] = []

    def set_cell(self, cell: Cell) -> None:
        """Set all pairs and the channel. Drop queued packets and draw new fades."""
        self._cell = cell
        self._links.clear()
        self._fades.clear()
        self._channel = SharedChannel(cell.channel, len(self._names)) if cell.channel.rate else None

    def set_link(self, link: Link, one: int, other: int) -> None:
        """Set both directions of one pair."""
        self._links[_pair(one, other)] = link
        self._fades.pop(_pair(one, other), None)

    def cut(self, one: int, other: int, until: float) -> None:
        """Lose all that a pair sends before a time."""
        pair = _pair(one, other)
        self._cut_until[pair] = max(self._cut_until[pair], until)

    def mend(self) -> None:
        """End all cuts."""
        self._cut_until.clear()

    def send(self, now: float, source: int, to: int, packet: bytes) -> None:
        """A robot sends a packet."""
        direction = source, to
        link, rng = self._link(direction), self._rng_of(direction)
        # Each packet uses two random numbers, so that one parameter does not change later packets.
        sent = _Sent(direction, packet, rng.random() < link.loss, rng.random() * link.jitter)
        if self._channel is None:
            self._transmit(sent, now, now)
            return
        self._serve_channel(now)
        if not self._channel.offer(now, source, sent, len(packet)):
            self._lost.append((direction, packet))
        self._serve_channel(now)

    def advance(self, now: float) -> Iterator[Delivery]:
        """Packets that have arrived by now, in the order of time."""
        self._serve_channel(now)
        while self._in_flight and self._in_flight[0][0] <= now:
            yield heapq.heappop(self._in_flight)[2]

    def next_event(self) -> float | None:
        """Time of the next arrival or transmission; None when nothing is pending."""
        times = [self._in_flight[0][0]] if self._in_flight else []
        if self._channel is not None and (free := self._channel.next_event) is not None:
            times.append(free)
        return min(times, default=None)

    def pop_lost(self) -> list[tuple[Direction, bytes]]:
        """The packets that were lost since the last call."""
        lost, self._lost = self._lost, []
        return lost

    def _serve_channel(self, now: float) -> None:
        if self._channel is not None:
            for transmission in self._channel.pop_started(now):
                self._transmit(transmission.item, transmission.start, transmission.end)

    def _transmit(self, sent: _Sent, start: float, end: float) -> None:
        link, pair = self._link(sent.direction), _pair(*sent.direction)
        if (
            sent.lost
            or self._cut_until[pair] > start
            or (link.fade and self._fades_of(pair, start).at(start))
        ):
            self._lost.append((sent.direction, sent.packet))
            return
        arrival = max(end + link.delay + sent.jitter, self._last_arrival[sent.direction])
        self._last_arrival[sent.direction] = arrival
        self._count += 1
        heapq.heappush(self._in_flight, (arrival, self._count, Delivery(sent.direction[1], sent.packet)))

    def _link(self, direction: Direction) -> Link:
        return self._links.get(_pair(*direction), self._cell.link)

    def _rng_of(self, direction: Direction) -> random.Random:
        if direction not in self._rng:
            self._rng[direction] = random.Random(
                f"{self._seed}/{self._names[direction[0]]}>{self._names[direction[1]]}"
            )
        return self._rng[direction]

    def _fades_of(self, pair: Direction, now: float) -> _Fades:
        if pair not in self._fades:
            rng = random.Random(f"{self._seed}/fades/{self._names[pair[0]]}/{self._names[pair[1]]}")
            self._fades[pair] = _Fades(self._link(pair), now, rng)
        return self._fades[pair]


def _pair(one: int, other: int) -> Direction:
    return min(one, other), max(one, other)
