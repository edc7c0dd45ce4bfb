"""A simulated computer: a machine, its place in the network, and the processes that it runs."""

from __future__ import annotations

import asyncio
import errno
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from lfield.loop import Fake, SerialEnd, SerialUser
from lfield.simulate.computers.loop import ProcessLoop, beyond
from lfield.simulate.computers.machines import Machine
from lfield.simulate.computers.network import Listening, Network
from lfield.simulate.computers.pipes import Child
from lfield.simulate.computers.serial import SerialPort

T = TypeVar("T")

#: Seconds until a child runs that was just started.
STARTS = (0.05, 0.3)
#: Numbers that no process of the real computer has.
_PIDS = itertools.count(1 << 40)

#: What takes the bytes that come through a child's stdin, and None for their end.
Input = Callable[[bytes | None], None]
#: Begins a child inside its loop, with what follows the module in its command line; and what it writes to
#: stdout it is given.
Program = Callable[["Process", Sequence[str], asyncio.WriteTransport], Input]


class Computer:
    """One computer. `programs` are what its processes may start, by the module that a command line names."""

    def __init__(self, machine: Machine, network: Network, programs: Mapping[str, Program]) -> None:
        self.machine, self.network, self.programs = machine, network, programs
        self.processes: list[Process] = []

    def start(self) -> Process:
        """A new process, in which nothing runs yet."""
        process = Process(self)
        self.processes.append(process)
        return process

    def power_off(self) -> None:
        """All its processes are gone, and nobody is told."""
        self.machine.on = False
        for process in list(self.processes):
            process.die(-9, silently=True)

    def power_on(self) -> None:
        """It is there again; nothing runs on it yet."""
        self.machine.switch_on()


class Process:
    """One process of a computer."""

    def __init__(self, computer: Computer) -> None:
        self.computer, self.pid = computer, next(_PIDS)
        self.loop = _Loop(self)
        self.on_end: Callable[[int], None] = lambda status: None
        #: Is told when a fake serves in it.
        self.on_fake: Callable[[Fake], None] = lambda fake: None
        self.children: list[Process] = []
        self._input: Input | None = None
        self._early: list[bytes | None] = []

    def begin(self, program: Program, arguments: Sequence[str], output: asyncio.WriteTransport) -> None:
        """Run a program in it."""
        self._input = program(self, arguments, output)
        for data in self._early:
            self._input(data)

    def received(self, data: bytes | None) -> None:
        """Something came through its stdin, or the end of it."""
        if self._input is not None:
            self._input(data)
        else:
            self._early.append(data)

    def exit(self, status: int) -> None:
        """It ends by itself, when what it does now is done."""
        self.computer.machine.timeline.after(0.0, partial(self.die, status))

    def die(self, status: int, *, silently: bool = False) -> None:
        """It ends now, as by SIGKILL; its children see the end of their stdin, unless the machine is gone."""
        if self.loop.dead:
            return
        self.computer.processes.remove(self)
        self.computer.network.process_died(self.loop, silently=silently)
        self.loop.die()
        if silently:
            return
        for child in self.children:
            child.loop.soon(partial(child.received, None))
        self.on_end(status)


class _Loop(ProcessLoop):
    """A process's loop, with its way to the network and to children."""

    def __init__(self, process: Process) -> None:
        super().__init__(process.computer.machine)
        self._process, self._computer = process, process.computer

    async def create_server(  # type: ignore[override]
        self, made: Callable[[], asyncio.Protocol], host: str, port: int, **_: Any
    ) -> Listening:
        """See asyncio; on the simulated network."""
        return self._computer.network.listen(self, host, port, made)

    async def create_connection(  # type: ignore[override]
        self, made: Callable[[], asyncio.Protocol], host: str = "", port: int = 0, **_: Any
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """See asyncio; on the simulated network."""
        if not host:
            beyond("use a socket")
        return await self._computer.network.connect(self, made, host, port)

    async def subprocess_exec(  # type: ignore[override]
        self, made: Callable[[], asyncio.SubprocessProtocol], *command: str, **_: Any
    ) -> tuple[asyncio.SubprocessTransport, asyncio.SubprocessProtocol]:
        """See asyncio; `python -m MODULE` is one of the computer's programs."""
        module, *words = command[command.index("-m") + 1 :] if "-m" in command else [""]
        program = self._computer.programs.get(module)
        if program is None:
            beyond(f"start {' '.join(map(str, command))}")
        protocol, child = made(), self._computer.start()
        self._process.children.append(child)
        transport = Child(self, child, protocol)
        protocol.connection_made(transport)
        begin = partial(child.begin, program, words, transport.stdout)
        child.loop.soon(begin, self.machine.dice.uniform(*STARTS))
        return transport, protocol

    # --- what a simulated loop has beyond asyncio's: see lfield.loop.Simulated ---------------------------

    def open_serial(self, path: str, baud: int, user: SerialUser) -> SerialEnd:
        """Open a serial port for us alone. Raises OSError."""
        port = self._computer.network.ports.get(path)
        if port is None:
            raise OSError(errno.ENOENT, "No such file or directory")
        return port.open(self, baud, user)

    def plug_serial(self, path: str, received: Callable[[bytes, int], None]) -> SerialEnd:
        """Be what stands at the far end of a new port. Raises OSError when there is one of that name."""
        ports = self._computer.network.ports
        if path in ports:
            raise OSError(errno.EEXIST, "File exists")
        port = ports[path] = SerialPort(self, received, partial(ports.__delitem__, path))
        return port

    def shared(self, name: str, make: Callable[[], T]) -> T:
        """One for all processes."""
        common = self._computer.network.common
        if name not in common:
            common[name] = make()
        made: T = common[name]
        return made

    async def serve(self, fake: Fake) -> None:
        """Be a fake until the process ends."""
        self._process.on_fake(fake)
        await self.create_future()


#: What loops of asyncio do with the computer that they run on, and how it is said.
_BEYOND = {
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
for deed, names in _BEYOND.items():
    for name in names:
        setattr(_Loop, name, lambda *_, deed=deed, **__: beyond(deed))
