"""While a mission is under test nothing real is touched: no network, no port, no device, no process.

Python tells its audit hooks of all that (PEP 578), whichever library does it. A hook cannot be taken away
again, so there is one, and it looks whether a test runs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from lfield.errors import RealEndpoint

#: What is told of, and how it is said.
_ACTS = {
    "socket.connect": "it wanted to connect to {1}",
    "socket.bind": "it wanted to listen at {1}",
    "socket.sendto": "it wanted to send to {1}",
    "socket.sendmsg": "it wanted to send to {1}",
    "socket.getaddrinfo": "it wanted to reach {0}:{1}",
    "subprocess.Popen": "it wanted to start {0}",
    "os.posix_spawn": "it wanted to start {0}",
}
#: Of the files in /dev, these are no devices.
_HARMLESS = ("/dev/null", "/dev/urandom", "/dev/random", "/dev/zero", "/dev/shm/")


class _Fence:
    def __init__(self) -> None:
        self.up = self.there = False
        self.caught: list[RealEndpoint] = []

    def hook(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self.up:
            return
        what = ""
        if event in _ACTS:
            what = _ACTS[event].format(*arguments)
        elif event == "open" and str(arguments[0]).startswith("/dev/"):
            path = str(arguments[0])
            what = "" if path.startswith(_HARMLESS) else f"it wanted to open {path}"
        if what:
            error = RealEndpoint(what)
            self.caught.append(error)
            raise error


_FENCE = _Fence()


@contextmanager
def fenced() -> Iterator[list[RealEndpoint]]:
    """Let nothing out; what was tried is in the list, also where whoever tried has kept silent about it."""
    if not _FENCE.there:
        sys.addaudithook(_FENCE.hook)
        _FENCE.there = True
    before, _FENCE.up = _FENCE.up, True
    _FENCE.caught = []
    try:
        yield _FENCE.caught
    finally:
        _FENCE.up = before
