"""Prevents tests of missions from real I/O: network, ports, devices, processes.

Uses Python's audit hooks (PEP 578), which report nearly all I/O. A hook cannot be removed, so a single hook
checks for active guards. Functions without an audit event are patched while a guard is active. A guard
covers the test and every thread started later, but not earlier ones such as a debugger. It is no sandbox:
testing.md lists ways around it.
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

#: Audit events, with a description of their arguments.
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
    # A simulated process that attempts real I/O.
    "lfield.beyond": "{0}",
}
#: Harmless devices by number: null, zero, full, random, urandom and the terminal.
_HARMLESS_DEVICES = {*(os.makedev(1, minor) for minor in (3, 5, 7, 8, 9)), os.makedev(5, 0)}


class IoGuard:
    """Active from creation until `remove`. `caught` lists attempts during a run that were not raised.

    Attempts of the test between two runs are raised there and not listed.
    """

    def __init__(self) -> None:
        self.caught: list[RealEndpoint] = []
        #: Whether the mission runs, as opposed to the test.
        self.is_running = False
        self._test = threading.get_native_id()
        self._outside = {int(thread) for thread in os.listdir("/proc/self/task")} - {self._test}
        if not _STANDING:
            _exchange()
        _STANDING.append(self)

    def remove(self) -> None:
        """Deactivates the guard."""
        if self in _STANDING:
            _STANDING.remove(self)
            if not _STANDING:
                _put_back()

    def drain_caught(self) -> list[RealEndpoint]:
        """Removes and returns the attempts."""
        caught, self.caught = self.caught, []
        return caught

    @contextmanager
    def running(self) -> Iterator[None]:
        """Lists every attempt within the block, even if its exception is caught."""
        self.is_running = True
        try:
            yield
        finally:
            self.is_running = False

    def refuse(self, operation: str) -> None:
        """Raises RealEndpoint, unless the caller is exempt."""
        thread = threading.get_native_id()
        if thread in self._outside:
            return
        error = RealEndpoint(f"it tried to {operation}")
        if self.is_running or thread != self._test:
            self.caught.append(error)
        raise error


@contextmanager
def io_guarded() -> Iterator[list[RealEndpoint]]:
    """Guards the block; attempts are in the list."""
    fence = IoGuard()
    try:
        with fence.running():
            yield fence.caught
    finally:
        fence.remove()


#: The active guards; several if a test has several teams.
_STANDING: list[IoGuard] = []


def _refuse(operation: str) -> None:
    running = (fence for fence in _STANDING if fence.is_running)
    next(running, _STANDING[-1]).refuse(operation)


# -- audit events --------------------------------------------------------------------------------------


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _STANDING:
        return
    if event in _ACTS:
        _refuse(_ACTS[event].format(*arguments))
    elif event == "socket.sendmsg" and not (arguments[1] is None and _is_pair(arguments[0])):
        _refuse(f"send to {arguments[1]}")
    elif event == "open" and not isinstance(arguments[0], int) and _is_device_path(arguments[0]):
        _refuse(f"open {os.fsdecode(arguments[0])}")


sys.addaudithook(_hook)


def _is_device_path(path: str | bytes | os.PathLike[str]) -> bool:
    """Whether a path leads to a device or a pipe, through links; for a missing file in /dev too."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        real = os.path.realpath(os.fsdecode(path))
        return real.startswith("/dev/") and not real.startswith("/dev/shm/")
    kind = stat.S_IFMT(found.st_mode)
    is_device = kind in (stat.S_IFCHR, stat.S_IFBLK) and found.st_rdev not in _HARMLESS_DEVICES
    return is_device or kind == stat.S_IFIFO


def _is_pair(end: socket.socket) -> bool:
    """Whether a socket is one of a pair within this process, as used to wake loops: neither end has a name.

    The accepted end of a connection has one.
    """
    with suppress(OSError):
        return end.family == socket.AF_UNIX and not end.getsockname() and not end.getpeername()
    return False


# -- functions without audit events --------------------------------------------------------------------


def _with_a_socket(name: str) -> Callable[..., str]:
    return lambda used, *_, **__: "" if _is_pair(used) else f"use a socket ({name})"


def _in_a_folder(path: Any, *_: Any, dir_fd: int | None = None, **__: Any) -> str:
    """A path relative to an open folder, which the audit event omits."""
    if dir_fd is None or not _is_device_path(os.path.join(f"/proc/self/fd/{dir_fd}", os.fsdecode(path))):
        return ""
    return f"open {os.fsdecode(path)}"


#: Socket methods without audit events.
_BY_A_SOCKET = (
    *("listen", "accept", "send", "sendall", "sendfile"),
    *("recv", "recv_into", "recvfrom", "recvfrom_into", "recvmsg", "recvmsg_into"),
)
#: Functions without audit events: owner, name, and description of their arguments, '' for harmless ones.
_SILENT: list[tuple[Any, str, Callable[..., str]]] = [
    (os, "open", _in_a_folder),
    # Used by multiprocessing to start processes other than forks.
    (_posixsubprocess, "fork_exec", lambda command, *_: f"start {os.fsdecode(command[0])}"),
    (signal, "pidfd_send_signal", lambda *_, **__: "send a signal to a process"),
    *((os, name, lambda *_: "open a terminal") for name in ("openpty", "posix_openpt") if hasattr(os, name)),
    *((socket.socket, name, _with_a_socket(name)) for name in _BY_A_SOCKET),
]
_originals: list[tuple[Any, str, Any]] = []


def _exchange() -> None:
    for where, name, describe in _SILENT:
        _originals.append((where, name, vars(where).get(name)))
        setattr(where, name, _refusing(getattr(where, name), describe))


def _put_back() -> None:
    while _originals:
        where, name, function = _originals.pop()
        if function is None:
            # The class had no function of its own.
            delattr(where, name)
        else:
            setattr(where, name, function)


def _refusing(function: Callable[..., Any], describe: Callable[..., str]) -> Callable[..., Any]:
    @wraps(function)
    def refusing(*arguments: Any, **named: Any) -> Any:
        if operation := describe(*arguments, **named):
            _refuse(operation)
        return function(*arguments, **named)

    return refusing
