"""Ctrl-C during a search of the debugger, and its progress on a terminal."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from lfield.replay.debugger.host_timeline import SearchCancelled
from lfield.replay.debugger.team_timeline import TeamTimeline

#: Seconds after which the progress of a command is shown, and between two changes of it.
SHOWN_AFTER, SHOWN_EVERY = 0.5, 0.2


@contextmanager
def interruptible(team: TeamTimeline, show: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """In the block, Ctrl-C raises SearchCancelled where a replay can end; a second one KeyboardInterrupt.

    `show` is called with the progress from time to time, and with '' at the end.
    """
    is_asked, due = False, time.monotonic() + SHOWN_AFTER
    is_shown = False

    def on_signal(number: int, frame: object) -> None:
        nonlocal is_asked
        if is_asked:
            raise KeyboardInterrupt
        is_asked = True

    def on_progress(seconds: float) -> None:
        nonlocal due, is_shown
        if is_asked:
            raise SearchCancelled
        if time.monotonic() >= due:
            is_shown, due = True, time.monotonic() + SHOWN_EVERY
            show(f"searching: {seconds:.1f} s of {team.duration:.1f} s")

    before = signal.signal(signal.SIGINT, on_signal)
    team.watch_progress(on_progress)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        team.watch_progress(lambda seconds: None)
        if is_shown:
            show("")


def show_on_terminal(text: str) -> None:
    """Write the progress into the present line of a terminal; '' erases it."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
