"""Shutdown requests of a host: the first makes its devices safe, a second one shortens the wait for rest.

A request is a signal, or the end of the parent process. Two presses of Ctrl-C in quick succession are one
request, and so are two signals of a service manager. A closed terminal or an ended parent counts as one
request that cannot be repeated.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable

from lfield.clock import Clock

#: The seconds after the first request within which further ones are the same request.
REPEAT_WINDOW = 1.0


class ShutdownSignals:
    """The requests so far. `first_requested` is set by the first; a callback is called by every later one."""

    def __init__(self, clock: Clock, on_second: Callable[[], None] = lambda: None) -> None:
        self._clock, self._on_second = clock, on_second
        self._first_at: float | None = None
        self.first_requested = asyncio.Event()

    def call_on_second(self, callback: Callable[[], None]) -> None:
        """Set the callback for later requests."""
        self._on_second = callback

    def request(self, *, is_repeatable: bool = True) -> None:
        """Request the end of the host; `is_repeatable`: a later request may count as the second one."""
        now = self._clock.monotonic()
        self.first_requested.set()
        if self._first_at is None:
            self._first_at = now
        elif is_repeatable and now >= self._first_at + REPEAT_WINDOW:
            self._on_second()


def install_signal_handlers(signals: ShutdownSignals) -> None:
    """Treat SIGINT, SIGTERM and SIGHUP as requests."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, signals.request)
    loop.add_signal_handler(signal.SIGHUP, lambda: signals.request(is_repeatable=False))
