"""The asyncio event loop of lfield's processes (uvloop if installed): child processes, tasks, priority."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import os
import resource
import signal
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Callable, Coroutine, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol, TypeVar, runtime_checkable

T = TypeVar("T")

#: CAP_SYS_NICE, which permits real-time priority, as a bit of `CapEff`.
_CAP_SYS_NICE = 1 << 23


def run(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to completion on uvloop, or on asyncio's loop without it."""
    with asyncio.Runner(loop_factory=_fastest()) as runner:
        return runner.run(work)


def report_exception(error: BaseException) -> None:
    """Pass an unexpected exception of a task or callback to the loop's exception handler.

    The loops silently treat an OSError from a socket callback as a lost connection, and report a task's
    exception only when the task is collected, if ever.
    """
    context = {"message": "a task or callback has failed", "exception": error}
    asyncio.get_running_loop().call_exception_handler(context)


def has_spare_descriptors(count: int) -> bool:
    """Whether this process can open `count` more files or sockets."""
    held: list[int] = []
    try:
        while len(held) < count:
            held.append(os.open(os.sep, os.O_RDONLY | os.O_CLOEXEC))
    except OSError:
        return False
    finally:
        for descriptor in held:
            os.close(descriptor)
    return True


async def start_process(protocol: asyncio.SubprocessProtocol, *command: str) -> None:
    """Start a process in its own session, with pipes for stdin and stdout. Raises OSError."""
    # The process has its own session, so that only the starting process gets Ctrl-C. Descriptors are checked
    # first, because uvloop leaks them on EMFILE.
    if not has_spare_descriptors(_DESCRIPTORS_PER_PROCESS):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    await asyncio.get_running_loop().subprocess_exec(
        lambda: protocol, *command, stderr=None, start_new_session=True
    )


async def start_child(
    *command: str, stdin: int | BinaryIO = DEVNULL, stdout: int = PIPE, env: Mapping[str, str] | None = None
) -> Process:
    """Start a process in its own session. A cancellation during the start kills it. Raises OSError."""
    # The start is shielded, because uvloop loses a process whose start is cancelled, and the process
    # continues.
    starting = asyncio.create_task(
        asyncio.create_subprocess_exec(
            *command, stdin=stdin, stdout=stdout, stderr=PIPE, env=env, start_new_session=True
        )
    )
    try:
        return await asyncio.shield(starting)
    except asyncio.CancelledError:
        process = await starting
        process.kill()
        await process.communicate()
        raise


async def run_process(
    *command: str, stdin: int | BinaryIO = DEVNULL, stdout: int = PIPE, env: Mapping[str, str] | None = None
) -> tuple[int, bytes, bytes]:
    """Run a process; returns its exit status, output and errors. A cancellation kills it. Raises OSError."""
    process = await start_child(*command, stdin=stdin, stdout=stdout, env=env)
    try:
        output, errors = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return process.returncode or 0, output, errors


#: Bytes of one read of `read_until_end`.
_READ_SIZE = 8192


def read_until_end(descriptor: int, on_data: Callable[[bytes], None]) -> None:
    """Pass the bytes of a descriptor to `on_data` in the running loop, and b"" at its end.

    A pipe, a terminal, a regular file and /dev/null are all accepted; the descriptor becomes non-blocking.
    """
    loop = asyncio.get_running_loop()

    def read() -> bool:
        try:
            data = os.read(descriptor, _READ_SIZE)
        except BlockingIOError:
            return True
        except OSError:
            data = b""
        if not data:
            loop.remove_reader(descriptor)
        on_data(data)
        return bool(data)

    def read_file() -> None:
        if read():
            loop.call_soon(read_file)

    os.set_blocking(descriptor, False)
    try:
        loop.add_reader(descriptor, read)
    except PermissionError:
        # epoll refuses a regular file and /dev/null. A read of them returns at once.
        loop.call_soon(read_file)


def kill(process: asyncio.SubprocessTransport) -> None:
    """Kill a process that has not ended.

    The loop's transport is not used, because it would reap a process that has just ended before the loop is
    informed.
    """
    if process.get_returncode() is not None:
        return
    if isinstance(process, Killable):
        process.kill_now()
    elif pid := process.get_pid():
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@runtime_checkable
class Killable(Protocol):
    """A process as the loops represent it, possibly simulated."""

    def kill_now(self) -> None:
        """Kill the process."""


class SerialUser(Protocol):
    """The user of an open serial port."""

    def received(self, data: bytes) -> None:
        """Called with received bytes."""

    def unplugged(self) -> None:
        """Called when the port is unplugged."""


class SerialLineEnd(Protocol):
    """One end of a serial line."""

    def write(self, data: bytes) -> None:
        """Send bytes. Raises OSError."""

    def close(self) -> None:
        """Close the port; at the far end, unplug it."""


class ServedFake(NamedTuple):
    """A running simulated device: its kind and endpoint, its settings and the state of its devices.

    `devices` maps ids to binding names; `facts` and `places` are by id. Places are metres north, east and up
    of one origin for all simulated devices. Objects that are no devices have places under their own names.
    """

    kind: str
    endpoint: str
    faults: FaultSettings
    devices: Mapping[str, str]
    facts: Mapping[str, Callable[[], Mapping[str, str | int | bool]]]
    places: Mapping[str, Callable[[], tuple[float, float, float]]]


class FaultSettings(Protocol):
    """The fault settings of a fake."""

    def apply(self, texts: Iterable[str]) -> None:
        """Set each `NAME[@DEVICE]=VALUE`, all or none. Raises ValueError with a message."""


@runtime_checkable
class SimulatedLoop(Protocol):
    """The loop of a process on a simulated computer, with simulated streams, child processes and serial
    ports.

    It has no datagrams, signals, stdin or file descriptors of the real computer.
    """

    def open_serial(self, path: str, baud: int, user: SerialUser) -> SerialLineEnd:
        """Open a serial port exclusively. Raises OSError."""

    def plug_serial(self, path: str, received: Callable[[bytes, int], None]) -> SerialLineEnd:
        """Create a serial port and return its far end; received bytes carry the sender's baud rate.

        Raises OSError if the port exists.
        """

    def shared(self, name: str, make: Callable[[], T]) -> T:
        """An object shared by all simulated devices of this simulation (terrain); the first caller creates
        it."""

    async def serve(self, fake: ServedFake) -> None:
        """Run a simulated device of this simulation until it is stopped."""


#: File descriptors needed to start a process, with a margin.
_DESCRIPTORS_PER_PROCESS = 12

#: References to running tasks: an unreferenced task may be collected before it ends.
_tasks: set[asyncio.Task[Any]] = set()


def spawn(work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
    """Run a background task. Its exception goes to the loop's exception handler at once."""
    task = asyncio.get_running_loop().create_task(work)
    _tasks.add(task)
    task.add_done_callback(_ended)
    return task


def abandon(task: asyncio.Task[Any]) -> None:
    """Drop the reference to a task whose loop will never run again (a killed simulated process)."""
    _tasks.discard(task)


def _ended(task: asyncio.Task[None]) -> None:
    _tasks.discard(task)
    if not task.cancelled() and (error := task.exception()) is not None:
        report_exception(error)


def raise_timer_priority() -> None:
    """Give this thread real-time priority, so that its timers are on time on a busy computer.

    The callers are the guard, and simulated devices, which represent dedicated hardware. The call needs
    CAP_SYS_NICE or LimitRTPRIO=1 in the service's unit. Other threads do not inherit the priority, so that a
    thread in an endless loop cannot block the computer.
    """
    policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, policy, os.sched_param(1))
    # Freeze existing objects: later collections scan only new ones and are short.
    gc.collect()
    gc.freeze()


def may_raise_timer_priority() -> bool:
    """Whether the system permits real-time priority. Root in a container often does not have it."""
    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    effective = next((line for line in status.splitlines() if line.startswith("CapEff:")), "CapEff: 0")
    may_be_nice = bool(int(effective.split()[1], 16) & _CAP_SYS_NICE)
    return may_be_nice or soft >= 1 or soft == resource.RLIM_INFINITY


def _fastest() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """uvloop's loop factory, or None for asyncio's."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
