"""The network between simulated machines: listeners, connections, and paths."""

from __future__ import annotations

import asyncio
import errno
import random
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import ProcessLoop, unsupported
from lfield.simulate.computers.simulated_connection import (
    Address,
    ConnectionEnd,
    SimulatedConnection,
    SimulatedSocket,
    reset,
)
from lfield.simulate.computers.simulated_machine import NetworkPaths, SimulatedMachine
from lfield.simulate.computers.simulated_serial import SimulatedSerialPort

#: Seconds between two connection attempts without an answer: the mean of TCP's growing delays.
RETRY_DELAY = 1.0
LOOPBACK = "127.0.0.1"


class SimulatedNetwork:
    """All connections between `machines`, by name. `rng` determines all random values."""

    def __init__(
        self, timeline: EventQueue, machines: Mapping[str, SimulatedMachine], rng: random.Random
    ) -> None:
        self._timeline, self._machines = timeline, dict(machines)
        self.paths = NetworkPaths(rng)
        self._listening: dict[Address, ListeningPort] = {}
        self._connections: list[SimulatedConnection] = []
        self._free_port = 40_000
        #: Serial ports by path, with their far ends.
        self.ports: dict[str, SimulatedSerialPort] = {}
        #: The process that has an exclusive resource, by name.
        self.ports_in_use: dict[str, ProcessLoop] = {}
        #: Objects shared by simulated devices, by name.
        self.common: dict[str, Any] = {}

    def join(self, machine: SimulatedMachine) -> None:
        """Connects a machine."""
        self._machines[machine.name] = machine

    def plug_in(self, machine: SimulatedMachine) -> None:
        """Connects a machine by a cable: no path between others leads through it."""
        self.join(machine)
        self.paths.cabled.add(machine.name)

    # --- faults ---------------------------------------------------------------------------------------

    def silence(self, sender: str, receiver: str) -> None:
        """Silences a path."""
        self.paths.silent.add((sender, receiver))

    def heal(self, sender: str, receiver: str) -> None:
        """Restores a path, and delivers pending data."""
        self.paths.silent.discard((sender, receiver))
        for end in self._ends():
            if end.path == (sender, receiver):
                end.push()

    def heal_all(self) -> None:
        """Restores all paths, with default latency."""
        self.paths.slow.clear()
        for path in sorted(self.paths.silent):
            self.heal(*path)

    def reset(self, host: str, other: str) -> None:
        """Breaks every connection of two machines at once, with pending data."""
        for end in self._ends():
            if set(end.path) == {host, other}:
                end.lose(reset())

    def half_open(self, lost_host: str, remaining_host: str) -> None:
        """Breaks one end of every connection of two machines without notifying the other."""
        for end in self._ends():
            if end.path == (lost_host, remaining_host):
                end.lose(reset())

    def process_died(self, loop: ProcessLoop, *, silently: bool) -> None:
        """Frees the ports of a dead process and resets its connections; `silently` when its machine is
        gone.
        """
        self._listening = {at: found for at, found in self._listening.items() if found.loop is not loop}
        for end in self._ends():
            if end.loop is loop:
                end.cut_off(silently=silently)

    def _ends(self) -> list[ConnectionEnd]:
        self._connections = [connection for connection in self._connections if not connection.is_over]
        return [end for connection in self._connections for end in connection.ends]

    # --- for processes --------------------------------------------------------------------------------

    def listen(
        self, loop: ProcessLoop, host: str, port: int, make_protocol: Callable[[], asyncio.Protocol]
    ) -> ListeningPort:
        """Listens at an address; loopback is the machine itself. Raises OSError when it is in use."""
        host = loop.machine.name if host == LOOPBACK else host
        if port == 0:
            self._free_port += 1
            port = self._free_port
        if (host, port) in self._listening:
            raise OSError(errno.EADDRINUSE, "Address already in use")
        listening = self._listening[host, port] = ListeningPort(self, loop, (host, port), make_protocol)
        return listening

    def remove_listener(self, address: Address) -> None:
        """Stops listening."""
        self._listening.pop(address, None)

    async def connect(
        self, loop: ProcessLoop, make_protocol: Callable[[], asyncio.Protocol], host: str, port: int
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """Connects to a listener; waits for ever without an answer. Raises ConnectionRefusedError."""
        caller, called = loop.machine, self._machines.get(host)
        if called is None:
            unsupported(f"connect to {host}:{port}")
        await asyncio.sleep(self.paths.delay((caller.name, called.name)))
        while self.paths.silences(caller.name, called.name) or not called.is_on:
            await asyncio.sleep(RETRY_DELAY)
        listening = self._listening.get((host, port))
        if listening is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        self._free_port += 1
        connection = SimulatedConnection(
            self.paths, loop, listening.loop, ((caller.name, self._free_port), (host, port))
        )
        self._connections.append(connection)
        caller_end, called_end = connection.ends
        self._timeline.after(
            0.0, partial(called_end.arrive, partial(called_end.start, listening.make_protocol))
        )
        await asyncio.sleep(self.paths.delay((called.name, caller.name)))
        if caller_end.is_over:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        protocol = make_protocol()
        caller_end.start(lambda: protocol)
        return caller_end, protocol


class ListeningPort:
    """A listening port of a process, as its server."""

    def __init__(
        self,
        network: SimulatedNetwork,
        loop: ProcessLoop,
        address: Address,
        make_protocol: Callable[[], asyncio.Protocol],
    ) -> None:
        self._network, self.loop, self._address, self.make_protocol = network, loop, address, make_protocol
        self.sockets = [SimulatedSocket(address)]

    def close(self) -> None:
        """Stops accepting connections."""
        self._network.remove_listener(self._address)
