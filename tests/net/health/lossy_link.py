"""A link on a path that loses packets, in virtual time: heartbeats over TCP, which repeats lost segments.

The model is worse than TCP: a sender has one segment in flight and sends the next one when that is
acknowledged; only a time-out detects a loss. As in TCP, each packet acknowledges everything received.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass

from lfield.net.health.link_heartbeats import PING_EVERY, Heartbeats


@dataclass(frozen=True)
class Path:
    """One-way `delay` in s, and the independent probability that a packet is lost."""

    delay: float
    loss: float


@dataclass(frozen=True)
class Kernel:
    """Margin beyond the round trip and longest time-out, in s; the first `linear` time-outs do not double."""

    margin: float
    longest: float
    linear: int = 6


class Simulation:
    """Virtual time and its queue of events."""

    def __init__(self, seed: int, path: Path, kernel: Kernel) -> None:
        self.now, self.path, self.kernel = 0.0, path, kernel
        self.rng = random.Random(seed)
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def later(self, seconds: float, what: Callable[[], None]) -> None:
        """Call `what` after `seconds`."""
        heapq.heappush(self._due, (self.now + seconds, next(self._order), what))

    def carry(self, what: Callable[[], None]) -> None:
        """Send a packet; `what` is called when it arrives."""
        if self.rng.random() >= self.path.loss:
            self.later(self.path.delay, what)

    def run(self, seconds: float) -> None:
        """Advance the time to `seconds`."""
        while self._due and self._due[0][0] <= seconds:
            self.now, _, what = heapq.heappop(self._due)
            what()


class Sender:
    """One direction of a connection; `back` is the other."""

    def __init__(self, simulation: Simulation, deliver: Callable[[tuple[str, int]], None]) -> None:
        self._simulation, self._deliver, self.back = simulation, deliver, self
        self._queue: list[tuple[str, int]] = []
        self._segment: list[tuple[str, int]] = []
        self._number = self._arrived = self._tries = 0

    def send(self, message: tuple[str, int]) -> None:
        """Queue a message."""
        self._queue.append(message)
        if not self._segment:
            self._next()

    def _next(self) -> None:
        self._segment, self._queue = self._queue, []
        self._number, self._tries = self._number + 1, 0
        if self._segment:
            self._transmit(self._number)

    def _transmit(self, number: int) -> None:
        if number != self._number or not self._segment:
            return
        simulation, kernel = self._simulation, self._simulation.kernel
        segment, acknowledged = self._segment, self.back._arrived
        simulation.carry(lambda: self._arrives(number, segment, acknowledged))
        doublings = max(0, self._tries - kernel.linear + 1)
        timeout = min(kernel.longest, (2 * simulation.path.delay + kernel.margin) * 2.0**doublings)
        self._tries += 1
        simulation.later(timeout, lambda: self._transmit(number))

    def _arrives(self, number: int, segment: list[tuple[str, int]], acknowledged: int) -> None:
        self.back._acknowledged(acknowledged)
        if number > self._arrived:
            self._arrived = number
            for message in segment:
                self._deliver(message)
        self._simulation.carry(lambda: self._acknowledged(number))

    def _acknowledged(self, number: int) -> None:
        if number == self._number and self._segment:
            self._segment = []
            self._next()


class End:
    """One end of a link, as in `lfield.net.link_manager`: it is checked each second."""

    def __init__(self, simulation: Simulation, *, first: bool, is_idle: bool) -> None:
        self._is_idle = is_idle
        self.beats = Heartbeats(first=first)
        self.beats.on_link_made(0.0)
        self.last_received = 0.0
        #: Times at which this end closed the link, and each silence before a message.
        self.lost: list[float] = []
        self.silences: list[float] = []
        self.simulation, self.other = simulation, self
        self.sender = Sender(simulation, self._deliver)
        simulation.later(PING_EVERY * (0.3 if first else 0.8), self._check)

    def _deliver(self, message: tuple[str, int]) -> None:
        """Deliver a message of this end to the other end."""
        self.other.on_message(*message)

    def on_message(self, kind: str, token: int) -> None:
        """Handle a received message."""
        now = self.simulation.now
        self.silences.append(now - self.last_received)
        self.last_received = now
        if kind == "ping":
            self.beats.on_ping()
            self.sender.send(("pong", token))
        else:
            self.beats.on_pong(token, now)

    def _check(self) -> None:
        now = self.simulation.now
        silent = now - self.last_received
        if silent > self.beats.lost_after(now, is_idle=self._is_idle):
            self.lost.append(now)
            self.last_received = now
        elif self.beats.is_due(now, silent, is_idle=self._is_idle):
            self.sender.send(("ping", self.beats.send(now)))
        self.simulation.later(PING_EVERY, self._check)


def ends_after(
    seconds: float, path: Path, kernel: Kernel, seed: int, *, is_idle: bool = False
) -> tuple[End, End]:
    """Both ends of a link after `seconds`."""
    simulation = Simulation(seed, path, kernel)
    near, far = (End(simulation, first=first, is_idle=is_idle) for first in (True, False))
    near.other, far.other = far, near
    near.sender.back, far.sender.back = far.sender, near.sender
    simulation.run(seconds)
    return near, far
