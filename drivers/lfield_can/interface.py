"""An open interface as the bus sees it, and what the bus hears of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from lfield_can.frames import Frame

#: Why a frame was not sent by an interface that has failed.
GONE = "the bus is lost"


@dataclass(frozen=True, slots=True)
class Listener:
    """What an interface calls, on the loop: with every data frame, with the id and data of every error frame,
    and once with the reason why the interface has failed."""

    frame: Callable[[Frame], None]
    error: Callable[[int, bytes], None]
    lost: Callable[[str], None]


class Interface(Protocol):
    """It works until its first failure; then it is closed and another one is opened.

    `malformed` counts what came in and was no frame.
    """

    malformed: int

    @property
    def off(self) -> bool:
        """Whether the interface itself says that its controller is off the bus."""

    async def send(self, frame: Frame) -> str:
        """Send a frame; '' once the interface has taken it, else the reason why it has not."""

    def post(self, frame: Frame) -> None:
        """Send a frame, or not. From any thread; never waits."""

    async def close(self) -> None:
        """Give it back."""
