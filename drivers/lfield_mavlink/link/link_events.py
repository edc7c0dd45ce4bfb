"""Events of a link for its driver: received bytes with their address, log lines, reconnection."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from lfield.driver import DeviceError

#: Seconds between attempts to reopen a link, and per attempt.
RETRY_INTERVAL, ATTEMPT_TIMEOUT = 1.0, 2.0


#: Receives bytes.
OnData = Callable[[bytes], None]


def _nothing(*_: object) -> None:
    """Ignores an event."""


class LinkEvents(Struct, frozen=True):
    """`note` takes a log line; `reopened` is called when a lost link works again.

    `sender` gets the address of the following bytes, if a link has several peers.
    """

    note: Callable[[str], None] = _nothing
    reopened: Callable[[], None] = _nothing
    sender: Callable[[str], None] = _nothing

    def log(self, line: str) -> None:
        """Logs a line unless it is empty."""
        if line:
            self.note(line)


def cannot_open(name: str, error: Exception) -> DeviceError:
    """The exception for an endpoint that cannot be opened."""
    return DeviceError("endpoint", f"cannot open {name}: {reason_of(error)}")


def reason_of(error: Exception) -> str:
    """The cause of a failure, as the end of a sentence."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def name_of(kind: str, host: str, port: int) -> str:
    """`tcp:[fd00::5]:5760`."""
    return f"{kind}:[{host}]:{port}" if ":" in host else f"{kind}:{host}:{port}"
