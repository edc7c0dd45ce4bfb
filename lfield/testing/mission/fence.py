"""While a mission is under test nothing real is touched: no network, no port, no device, no process.

Python tells its audit hooks of nearly all that (PEP 578), whichever library does it. A hook cannot be taken
away again, so there is one, and it looks whether a fence stands. Of what Python tells nothing, functions are
exchanged for as long as one does. Behind a fence are the test itself and every thread that began after it
went up; what was there before, such as a debugger, is not. It is no jail: whoever wants to get through does,
by what testing.md names.
"""

from __future__ import annotations

import _posixsubprocess
import os
import signal
import socket
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any

from lfield.errors import RealEndpoint

#: What is told of, and how it is said of its arguments.
_ACTS = {
    "socket.getaddrinfo": "reach {0}:{1}",
    "socket.gethostbyname": "reach {0}",
    "socket.gethostbyaddr": "reach {0}",
    "socket.getnameinfo": "reach {0}",
    "subprocess.Popen": "start {0}",
    "os.posix_spawn": "start {0}",
    "os.exec": "start {0}",
    "os.system": "start {0}",
    "os.fork": "start a process",
    "os.forkpty": "start a process",
    "os.kill": "send a signal to process {0}",
    "os.killpg": "send a signal to the processes of group {0}",
    "ctypes.dlopen": "load {0} by ctypes",
    "ctypes.dlsym": "call {1} by ctypes",
    "socket.connect": "connect to {1}",
    "socket.bind": "listen at {1}",
    "socket.sendto": "send to {1}",
    # What a process of a simulated computer wants of the real one.
    "lfield.beyond": "{0}",
}
#: The devices that lead nowhere, by their numbers: null, zero, full, random, urandom and the terminal.
_NOWHERE = {*(os.makedev(1, minor) for minor in (3, 5, 7, 8, 9)), os.makedev(5, 0)}


class Fence:
    """Stands from now on, until it is taken `down`. `caught` is what was tried behind it and nobody raised.

    What the test itself tries between two runs is raised there, and is in no list.
    """

    def __init__(self) -> None:
        self.caught: list[RealEndpoint] = []
        #: Whether the mission runs, not only the test.
        self.is_running = False
        self._test = threading.get_native_id()
        self._outside = {int(thread) for thread in os.listdir("/proc/self/task")} - {self._test}
        if not _STANDING:
            _exchange()
        _STANDING.append(self)

    def down(self) -> None:
        """It stands no more."""
        if self in _STANDING:
            _STANDING.remove(self)
            if not _STANDING:
                _put_back()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Whatever is tried within is in the list, also where whoever tries keeps silent about it."""
        self.is_running = True
        try:
            yield
        finally:
            self.is_running = False

    def refuse(self, what: str) -> None:
        """Raise it, unless whoever wants it stands outside."""
        thread = threading.get_native_id()
        if thread in self._outside:
            return
        error = RealEndpoint(f"it wanted to {what}")
        if self.is_running or thread != self._test:
            self.caught.append(error)
        raise error


@contextmanager
def fenced() -> Iterator[list[RealEndpoint]]:
    """A fence about what runs within; what was tried is in the list."""
    fence = Fence()
    try:
        with fence.running():
            yield fence.caught
    finally:
        fence.down()


#: The fences of all teams that are there; several stand where a test has several teams.
_STANDING: list[Fence] = []


def _refuse(what: str) -> None:
    running = (fence for fence in _STANDING if fence.is_running)
    next(running, _STANDING[-1]).refuse(what)


# --- what Python tells --------------------------------------------------------------------------------


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _STANDING:
        return
    if event in _ACTS:
        _refuse(_ACTS[event].format(*arguments))
    elif event == "socket.sendmsg" and not (arguments[1] is None and _is_pair(arguments[0])):
        _refuse(f"send to {arguments[1]}")
    elif event == "open" and not isinstance(arguments[0], int) and _leads_out(arguments[0]):
        _refuse(f"open {os.fsdecode(arguments[0])}")


sys.addaudithook(_hook)


def _leads_out(path: str | bytes | os.PathLike[str]) -> bool:
    """Whether a path leads to a device or a pipe, by whatever links; in /dev what is not there would."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        real = os.path.realpath(os.fsdecode(path))
        return real.startswith("/dev/") and not real.startswith("/dev/shm/")
    kind = stat.S_IFMT(found.st_mode)
    is_device = kind in (stat.S_IFCHR, stat.S_IFBLK) and found.st_rdev not in _NOWHERE
    return is_device or kind == stat.S_IFIFO


def _is_pair(one: socket.socket) -> bool:
    """Whether a socket is one of a pair within this process, as loops wake up by: no end has a name.

    Of a connection that was accepted this end has one, which is where it was listened.
    """
    with suppress(OSError):
        return one.family == socket.AF_UNIX and not one.getsockname() and not one.getpeername()
    return False


# --- what it does not tell ----------------------------------------------------------------------------


def _with_a_socket(name: str) -> Callable[..., str]:
    return lambda used, *_, **__: "" if _is_pair(used) else f"use a socket ({name})"


def _in_a_folder(path: Any, *_: Any, dir_fd: int | None = None, **__: Any) -> str:
    """A path as seen from an open folder: Python tells of the path alone."""
    if dir_fd is None or not _leads_out(os.path.join(f"/proc/self/fd/{dir_fd}", os.fsdecode(path))):
        return ""
    return f"open {os.fsdecode(path)}"


#: What is done with a socket and not told.
_BY_A_SOCKET = (
    *("listen", "accept", "send", "sendall", "sendfile"),
    *("recv", "recv_into", "recvfrom", "recvfrom_into", "recvmsg", "recvmsg_into"),
)
#: Where it is done, by which function, and what is to be said of its arguments, '' for nothing.
_SILENT: list[tuple[Any, str, Callable[..., str]]] = [
    (os, "open", _in_a_folder),
    # By this multiprocessing starts what it does not fork.
    (_posixsubprocess, "fork_exec", lambda command, *_: f"start {os.fsdecode(command[0])}"),
    (signal, "pidfd_send_signal", lambda *_, **__: "send a signal to a process"),
    *((os, name, lambda *_: "open a terminal") for name in ("openpty", "posix_openpt") if hasattr(os, name)),
    *((socket.socket, name, _with_a_socket(name)) for name in _BY_A_SOCKET),
]
_before: list[tuple[Any, str, Any]] = []


def _exchange() -> None:
    for where, name, told in _SILENT:
        _before.append((where, name, vars(where).get(name)))
        setattr(where, name, _refusing(getattr(where, name), told))


def _put_back() -> None:
    while _before:
        where, name, function = _before.pop()
        if function is None:
            # It was another class's, from which this one has it.
            delattr(where, name)
        else:
            setattr(where, name, function)


def _refusing(function: Callable[..., Any], told: Callable[..., str]) -> Callable[..., Any]:
    @wraps(function)
    def refusing(*arguments: Any, **named: Any) -> Any:
        if what := told(*arguments, **named):
            _refuse(what)
        return function(*arguments, **named)

    return refusing
