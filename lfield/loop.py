"""Event loop of every process of lfield that has one: uvloop's where it is installed, and when it runs."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import os
import resource
import signal
from collections.abc import Callable, Coroutine, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

T = TypeVar("T")

#: The capability that lets a process have real-time priority, as a bit of `CapEff`.
_CAP_SYS_NICE = 1 << 23


def run(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end on the fastest loop there is."""
    with asyncio.Runner(loop_factory=_fastest()) as runner:
        return runner.run(work)


def unexpected(error: BaseException) -> None:
    """Hand what nobody expected to the loop's exception handler, from a task or a callback.

    The loops take an OSError that a callback of a socket raises for a connection that was lost, and say
    nothing; what a task raises they tell when it is collected, if ever.
    """
    context = {"message": "a task or callback has failed", "exception": error}
    asyncio.get_running_loop().call_exception_handler(context)


def spare_descriptors(count: int) -> bool:
    """Whether this process could open so many more files or sockets now."""
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
    """Start a process with pipes for stdin and stdout, in a session of its own. Raises OSError."""
    # A Ctrl-C is for whoever starts it. Asked first: uvloop loses descriptors where there are too few.
    if not spare_descriptors(_FOR_A_PROCESS):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    await asyncio.get_running_loop().subprocess_exec(
        lambda: protocol, *command, stderr=None, start_new_session=True
    )


def kill(process: asyncio.SubprocessTransport) -> None:
    """End a process by force, if it has not ended.

    Not by a transport of the loops: it would reap a process that has just ended, behind the loop's back.
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
    """A process that only looks like one to the loops."""

    def kill_now(self) -> None:
        """End it."""


class SerialUser(Protocol):
    """Who has a serial port open."""

    def received(self, data: bytes) -> None:
        """Bytes have arrived."""

    def unplugged(self) -> None:
        """The port has gone."""


class SerialEnd(Protocol):
    """One end of a serial line."""

    def write(self, data: bytes) -> None:
        """Send bytes. Raises OSError."""

    def close(self) -> None:
        """Give it back; at the far end, unplug it."""


class Fake(NamedTuple):
    """A fake that serves: its kind and endpoint, what can be set in it, and what is true of its devices.

    `devices` are ids with the names of their bindings; `facts` and `places` are by id. A place is in metres
    north, east and up of one point for all fakes. Things that are no device have places by their own names.
    """

    kind: str
    endpoint: str
    faults: Settable
    devices: Mapping[str, str]
    facts: Mapping[str, Callable[[], Mapping[str, str | int | bool]]]
    places: Mapping[str, Callable[[], tuple[float, float, float]]]


class Settable(Protocol):
    """What can go wrong with a fake."""

    def apply(self, texts: Iterable[str]) -> None:
        """Set `NAME[@DEVICE]=VALUE`, all or none. Raises ValueError with a sentence."""


@runtime_checkable
class Simulated(Protocol):
    """The loop of a process on a simulated computer: its streams, children and serial ports are no real ones.

    It has no datagrams, and nothing of the computer that simulates: no descriptor, no signal, no stdin.
    """

    def open_serial(self, path: str, baud: int, user: SerialUser) -> SerialEnd:
        """Open a serial port for us alone. Raises OSError."""

    def plug_serial(self, path: str, received: Callable[[bytes, int], None]) -> SerialEnd:
        """Be what stands at the far end of a new port; what comes has the baud rate of who sent it.

        Raises OSError when there is one of that name.
        """

    def shared(self, name: str, make: Callable[[], T]) -> T:
        """What is one for all fakes of this simulation, such as the ground that several of them stand on.

        Whoever asks first makes it.
        """

    async def serve(self, fake: Fake) -> None:
        """Be a fake of this simulation, until it is told to end."""


#: What the loops take to start a process, with some to spare.
_FOR_A_PROCESS = 12

#: Tasks that nobody else holds: without a reference a task may be collected before it ends.
_tasks: set[asyncio.Task[Any]] = set()


def spawn(work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
    """Run something beside the rest; what it raises goes to the loop's exception handler at once."""
    task = asyncio.get_running_loop().create_task(work)
    _tasks.add(task)
    task.add_done_callback(_ended)
    return task


def abandon(task: asyncio.Task[Any]) -> None:
    """Drop the reference to a task whose loop will never run again: a killed process of a simulation."""
    _tasks.discard(task)


def _ended(task: asyncio.Task[None]) -> None:
    _tasks.discard(task)
    if not task.cancelled() and (error := task.exception()) is not None:
        unexpected(error)


def be_prompt() -> None:
    """Have the timers of this process come first, also on a computer that is busy.

    For what must keep time: a guard, and a fake, which stands for hardware that does nothing else. Only where
    the system allows it (CAP_SYS_NICE, or LimitRTPRIO=1 in the service's unit). Threads do not inherit it:
    one that spins must not starve the machine.
    """
    policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, policy, os.sched_param(1))
    # What is there now stays: later collections look at new objects only, and are short.
    gc.collect()
    gc.freeze()


def may_be_prompt() -> bool:
    """Whether the system allows a process of this user to be so. Root in a container often may not."""
    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    effective = next((line for line in status.splitlines() if line.startswith("CapEff:")), "CapEff: 0")
    may_be_nice = bool(int(effective.split()[1], 16) & _CAP_SYS_NICE)
    return may_be_nice or soft >= 1 or soft == resource.RLIM_INFINITY


def _fastest() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """uvloop's, else asyncio's own (None)."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
