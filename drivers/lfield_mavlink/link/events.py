"""What a link tells its driver: bytes with their address, lines for the log, and that it was reopened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lfield.driver import DeviceError

#: Seconds between attempts to open a link again, and that one attempt may take.
AGAIN, ATTEMPT = 1.0, 2.0


#: Takes bytes.
OnData = Callable[[bytes], None]


def _nothing(*_: object) -> None:
    """Nobody is interested."""


@dataclass(frozen=True, slots=True)
class LinkEvents:
    """`note` takes a line for the log; `reopened` is called when a link works again that was lost.

    `sender` gets the address that the bytes after it come from, where a link has several far ends.
    """

    note: Callable[[str], None] = _nothing
    reopened: Callable[[], None] = _nothing
    sender: Callable[[str], None] = _nothing

    def log(self, line: str) -> None:
        """A line, unless it is empty."""
        if line:
            self.note(line)


def cannot_open(name: str, error: Exception) -> DeviceError:
    """The exception for an endpoint that cannot be opened."""
    return DeviceError("endpoint", f"cannot open {name}: {reason_of(error)}")


def reason_of(error: Exception) -> str:
    """Why something failed, as the end of a sentence."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def name_of(kind: str, host: str, port: int) -> str:
    """`tcp:[fd00::5]:5760`."""
    return f"{kind}:[{host}]:{port}" if ":" in host else f"{kind}:{host}:{port}"
