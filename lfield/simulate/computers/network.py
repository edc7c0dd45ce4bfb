"""The network between simulated machines: who listens where, who is connected, and how the ways are."""

from __future__ import annotations

import asyncio
import errno
import random
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from lfield.simulate.computers.connection import Address, Connection, End, Socket, reset
from lfield.simulate.computers.loop import ProcessLoop, beyond
from lfield.simulate.computers.machines import Machine, Ways
from lfield.simulate.computers.serial import SerialPort
from lfield.simulate.computers.timeline import Timeline

#: Seconds between two attempts to connect where nothing answers: TCP's own grow, this is the mean of them.
AGAIN = 1.0
LOOPBACK = "127.0.0.1"


class Network:
    """All connections between `machines`, by name. Everything that is left to chance comes from `dice`."""

    def __init__(self, timeline: Timeline, machines: Mapping[str, Machine], dice: random.Random) -> None:
        self._timeline, self._machines = timeline, dict(machines)
        self.ways = Ways(dice)
        self._listening: dict[Address, Listening] = {}
        self._connections: list[Connection] = []
        self._free_port = 40_000
        #: Serial ports by their paths: each leads to whatever stands at its far end.
        self.ports: dict[str, SerialPort] = {}
        #: Which process has taken what only one may have, by name.
        self.taken: dict[str, ProcessLoop] = {}
        #: What fakes have in common, by name.
        self.common: dict[str, Any] = {}

    def join(self, machine: Machine) -> None:
        """A machine is connected from now on."""
        self._machines[machine.name] = machine

    def plug_in(self, machine: Machine) -> None:
        """A machine hangs on a cable from now on: none of the ways between the others leads through it."""
        self.join(machine)
        self.ways.cabled.add(machine.name)

    # --- faults ---------------------------------------------------------------------------------------

    def silence(self, near: str, far: str) -> None:
        """Nothing comes through that way from now on."""
        self.ways.silent.add((near, far))

    def heal(self, near: str, far: str) -> None:
        """It comes through again, and with it what has waited."""
        self.ways.silent.discard((near, far))
        for end in self._ends():
            if end.way == (near, far):
                end.push()

    def heal_all(self) -> None:
        """All of them speak, as fast as ever."""
        self.ways.slow.clear()
        for way in sorted(self.ways.silent):
            self.heal(*way)

    def reset(self, one: str, other: str) -> None:
        """Break every connection of two machines at once, with what is under way on it."""
        for end in self._ends():
            if set(end.way) == {one, other}:
                end.lose(reset())

    def half_open(self, gone: str, left: str) -> None:
        """One end of every connection of two machines breaks, and the other is not told."""
        for end in self._ends():
            if end.way == (gone, left):
                end.lose(reset())

    def process_died(self, loop: ProcessLoop, *, silently: bool) -> None:
        """Its ports are free, its connections reset; `silently` when its machine is gone and tells nobody."""
        self._listening = {at: found for at, found in self._listening.items() if found.loop is not loop}
        for end in self._ends():
            if end.loop is loop:
                end.cut_off(silently=silently)

    def _ends(self) -> list[End]:
        self._connections = [connection for connection in self._connections if not connection.over]
        return [end for connection in self._connections for end in connection.ends]

    # --- for processes --------------------------------------------------------------------------------

    def listen(
        self, loop: ProcessLoop, host: str, port: int, made: Callable[[], asyncio.Protocol]
    ) -> Listening:
        """Listen at an address; loopback is the machine itself. Raises OSError when it is taken."""
        host = loop.machine.name if host == LOOPBACK else host
        if port == 0:
            self._free_port += 1
            port = self._free_port
        if (host, port) in self._listening:
            raise OSError(errno.EADDRINUSE, "Address already in use")
        listening = self._listening[host, port] = Listening(self, loop, (host, port), made)
        return listening

    def forget(self, address: Address) -> None:
        """Nobody listens there any more."""
        self._listening.pop(address, None)

    async def connect(
        self, loop: ProcessLoop, made: Callable[[], asyncio.Protocol], host: str, port: int
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """Call whoever listens there; while nothing answers, for ever. Raises ConnectionRefusedError."""
        here, there = loop.machine, self._machines.get(host)
        if there is None:
            beyond(f"connect to {host}:{port}")
        await asyncio.sleep(self.ways.delay((here.name, there.name)))
        while self.ways.silences(here.name, there.name) or not there.on:
            await asyncio.sleep(AGAIN)
        listening = self._listening.get((host, port))
        if listening is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        self._free_port += 1
        connection = Connection(self.ways, loop, listening.loop, ((here.name, self._free_port), (host, port)))
        self._connections.append(connection)
        near, far = connection.ends
        self._timeline.after(0.0, partial(far.arrive, partial(far.begin, listening.made)))
        await asyncio.sleep(self.ways.delay((there.name, here.name)))
        if near.over:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        protocol = made()
        near.begin(lambda: protocol)
        return near, protocol


class Listening:
    """A port that a process listens at, as its server."""

    def __init__(
        self, network: Network, loop: ProcessLoop, address: Address, made: Callable[[], asyncio.Protocol]
    ) -> None:
        self._network, self.loop, self._address, self.made = network, loop, address, made
        self.sockets = [Socket(address)]

    def close(self) -> None:
        """Take no more callers."""
        self._network.forget(self._address)
