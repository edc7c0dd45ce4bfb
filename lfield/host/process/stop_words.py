"""The words that end a host: the first makes its devices safe, a second one does not wait until they rest.

A word is a signal, or the end of the process that holds the host's leash. Ctrl-C pressed twice in a hurry is
one word, and so is a service manager that sends two signals. A terminal that closes and a parent that is gone
say it once and for all: nobody is there to say a second one.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable

from lfield.clock import Clock

#: Words within so many seconds of the first are the same word.
ECHO = 1.0


class StopWords:
    """What has been said. `first` is set by the first word; `on_second` is called by every later one."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._first_at: float | None = None
        self.first = asyncio.Event()
        self.on_second: Callable[[], None] = lambda: None

    def say(self, *, again: bool = True) -> None:
        """Somebody wants the host to end; whether it may count as a second word."""
        now = self._clock.monotonic()
        self.first.set()
        if self._first_at is None:
            self._first_at = now
        elif again and now >= self._first_at + ECHO:
            self.on_second()


def hear_signals(words: StopWords) -> None:
    """Take SIGINT, SIGTERM and SIGHUP for words."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, words.say)
    loop.add_signal_handler(signal.SIGHUP, lambda: words.say(again=False))
