"""A simulated computer: a machine, its network connection, and its processes."""

from __future__ import annotations

import asyncio
import errno
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from lfield.event_loop import SerialLineEnd, SerialUser, ServedFake
from lfield.simulate.computers.process_loop import ProcessLoop, unsupported
from lfield.simulate.computers.process_pipes import ChildProcess
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.computers.simulated_network import ListeningPort, SimulatedNetwork
from lfield.simulate.computers.simulated_serial import SimulatedSerialPort

T = TypeVar("T")

#: Seconds until a started child runs.
START_TIMES = (0.05, 0.3)
#: Ids that no real process has.
_PIDS = itertools.count(1 << 40)

#: Handles the bytes of a child's stdin, and None for their end.
Input = Callable[[bytes | None], None]
#: Starts a child inside its loop, with the arguments after the module and its stdout.
Program = Callable[["SimulatedProcess", Sequence[str], asyncio.WriteTransport], Input]


class SimulatedComputer:
    """One computer. `programs` are the modules that its processes may start."""

    def __init__(
        self, machine: SimulatedMachine, network: SimulatedNetwork, programs: Mapping[str, Program]
    ) -> None:
        self.machine, self.network, self.programs = machine, network, programs
        self.processes: list[SimulatedProcess] = []

    def start(self, on_fake: Callable[[ServedFake], None] = lambda fake: None) -> SimulatedProcess:
        """Creates a process, in which no program runs yet; `on_fake` is called when a simulated device
        serves in it.
        """
        process = SimulatedProcess(self, on_fake)
        self.processes.append(process)
        return process

    def power_off(self) -> None:
        """Ends all processes, without notification."""
        self.machine.switch_off()
        for process in list(self.processes):
            process.die(-9, silently=True)

    def power_on(self) -> None:
        """Switches the computer on again, without processes."""
        self.machine.switch_on()


class SimulatedProcess:
    """One process of a computer."""

    def __init__(self, computer: SimulatedComputer, on_fake: Callable[[ServedFake], None]) -> None:
        self.computer, self.pid = computer, next(_PIDS)
        self.loop = _Loop(self)
        self._on_end: Callable[[int], None] = lambda status: None
        #: Called when a simulated device serves in the process.
        self.on_fake = on_fake
        self.children: list[SimulatedProcess] = []
        self._input: Input | None = None
        self._early: list[bytes | None] = []

    def start(self, program: Program, arguments: Sequence[str], output: asyncio.WriteTransport) -> None:
        """Runs a program in the process."""
        self._input = program(self, arguments, output)
        for data in self._early:
            self._input(data)

    def await_end(self, on_end: Callable[[int], None]) -> None:
        """Sets a function that is called with the exit status."""
        self._on_end = on_end

    def received(self, data: bytes | None) -> None:
        """Receives data on stdin, or its end."""
        if self._input is not None:
            self._input(data)
        else:
            self._early.append(data)

    def exit(self, status: int) -> None:
        """Ends the process after its present work."""
        self.computer.machine.timeline.after(0.0, partial(self.die, status))

    def die(self, status: int, *, silently: bool = False) -> None:
        """Kills the process now, as by SIGKILL; its children see the end of stdin, unless the machine is
        gone.
        """
        if self.loop.dead:
            return
        self.computer.processes.remove(self)
        self.computer.network.process_died(self.loop, silently=silently)
        self.loop.die()
        if silently:
            return
        for child in self.children:
            child.loop.soon(partial(child.received, None))
        self._on_end(status)


class _Loop(ProcessLoop):
    """A process's loop, with access to the network and to children."""

    def __init__(self, process: SimulatedProcess) -> None:
        super().__init__(process.computer.machine)
        self._process, self._computer = process, process.computer

    async def create_server(  # type: ignore[override]  # fewer options
        self, make_protocol: Callable[[], asyncio.Protocol], host: str, port: int, **_: Any
    ) -> ListeningPort:
        """See asyncio; on the simulated network."""
        return self._computer.network.listen(self, host, port, make_protocol)

    async def create_connection(  # type: ignore[override]  # fewer options
        self, make_protocol: Callable[[], asyncio.Protocol], host: str = "", port: int = 0, **_: Any
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """See asyncio; on the simulated network."""
        if not host:
            unsupported("use a socket")
        return await self._computer.network.connect(self, make_protocol, host, port)

    async def subprocess_exec(  # type: ignore[override]  # fewer options
        self, make_protocol: Callable[[], asyncio.SubprocessProtocol], *command: str, **_: Any
    ) -> tuple[asyncio.SubprocessTransport, asyncio.SubprocessProtocol]:
        """See asyncio; `python -m MODULE` is one of the computer's programs."""
        module, *arguments = command[command.index("-m") + 1 :] if "-m" in command else [""]
        program = self._computer.programs.get(module)
        if program is None:
            unsupported(f"start {' '.join(map(str, command))}")
        protocol, child = make_protocol(), self._computer.start()
        self._process.children.append(child)
        transport = ChildProcess(self, child, protocol)
        protocol.connection_made(transport)
        start = partial(child.start, program, arguments, transport.stdout)
        child.loop.soon(start, self.machine.rng.uniform(*START_TIMES))
        return transport, protocol

    # --- additions of a simulated loop to asyncio's: see lfield.event_loop.SimulatedLoop
    # ---------------------------

    def open_serial(self, path: str, baud: int, user: SerialUser) -> SerialLineEnd:
        """Opens a serial port exclusively. Raises OSError."""
        port = self._computer.network.ports.get(path)
        if port is None:
            raise OSError(errno.ENOENT, "No such file or directory")
        return port.open(self, baud, user)

    def plug_serial(self, path: str, received: Callable[[bytes, int], None]) -> SerialLineEnd:
        """Creates a port and becomes its far end. Raises OSError if the name exists."""
        ports = self._computer.network.ports
        if path in ports:
            raise OSError(errno.EEXIST, "File exists")
        port = ports[path] = SimulatedSerialPort(self, received, partial(ports.__delitem__, path))
        return port

    def shared(self, name: str, make: Callable[[], T]) -> T:
        """An object shared by all processes."""
        common = self._computer.network.common
        if name not in common:
            common[name] = make()
        value: T = common[name]
        return value

    async def serve(self, fake: ServedFake) -> None:
        """Runs as a simulated device until the process ends."""
        self._process.on_fake(fake)
        await self.create_future()


#: Functions of asyncio loops that use the real computer, with descriptions.
_UNSUPPORTED = {
    "connect to a Unix socket": ["create_unix_connection"],
    "listen at a Unix socket": ["create_unix_server"],
    "open a datagram socket": ["create_datagram_endpoint"],
    "use a pipe": ["connect_read_pipe", "connect_write_pipe"],
    "run a command in a shell": ["subprocess_shell"],
    "wait for a descriptor": ["add_reader", "add_writer", "remove_reader", "remove_writer"],
    "catch a signal": ["add_signal_handler", "remove_signal_handler"],
    "use a socket": [
        "connect_accepted_socket", "sock_accept", "sock_connect", "sock_recv", "sock_recv_into",
        "sock_recvfrom", "sock_sendall", "sock_sendfile", "sock_sendto", "sendfile", "start_tls",
    ],
}  # fmt: skip
for operation, names in _UNSUPPORTED.items():
    for name in names:
        setattr(_Loop, name, lambda *_, operation=operation, **__: unsupported(operation))
