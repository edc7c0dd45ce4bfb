"""Interrupts a test that blocks or never ends, and names the code.

The watchdog observes virtual time, which advances on a slow computer, but not when code blocks.
"""

from __future__ import annotations

import inspect
import signal
import sysconfig
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import lfield

#: Longest interval between two checks of virtual time; time until a caught interrupt is repeated.
CHECK_INTERVAL = 1.0
#: Code that never blocks by itself.
_INNOCENT = (str(Path(lfield.__file__).parent), sysconfig.get_path("stdlib"))
#: Except for third-party packages in it.
_INSTALLED = ("site-packages", "dist-packages")


class StuckInterrupt(KeyboardInterrupt):
    """Virtual time has not advanced for too long. Not caught by `except Exception` or by asyncio loops."""


class StuckWatchdog:
    """Raises `StuckInterrupt` in the block when `now` is unchanged for so many seconds of real time.

    The time is measured in checks: a computer that is suspended or overloaded does not check. The watchdog is
    an alarm of the main thread, so it interrupts any wait there, except C code that never returns to Python.
    An existing alarm, such as pytest-timeout's, is called when due, and is kept if it would end Python; other
    threads have no alarm.
    """

    def __init__(self, seconds: float, now: Callable[[], float]) -> None:
        self._now, self._check_interval = now, min(CHECK_INTERVAL, seconds / 4)
        #: Limit of unchanged checks, their number, and the time.
        self._maximum_checks = round(seconds / self._check_interval)
        self._unchanged_checks, self._progressed_at = 0, now()
        #: Whether the watchdog has expired, and the blocking code, as in `Depot.take (test_depot.py:12)`.
        self.has_expired, self.holder = False, ""

    def __enter__(self) -> StuckWatchdog:
        """Starts the watchdog."""
        self._caller, self._started_at = _foreign(inspect.currentframe(), None), time.monotonic()
        self._remaining, self._interval = signal.getitimer(signal.ITIMER_REAL)
        self._before = signal.getsignal(signal.SIGALRM)
        in_main = threading.current_thread() is threading.main_thread()
        self._set = in_main and (callable(self._before) or not self._remaining)
        if self._set:
            signal.signal(signal.SIGALRM, self._ring)
            first = min(self._check_interval, self._remaining or self._check_interval)
            signal.setitimer(signal.ITIMER_REAL, first, self._check_interval)
        return self

    def __exit__(self, *_: object) -> None:
        """Stops the watchdog."""
        if not self._set:
            return
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._before)
        if self._remaining:
            remaining = self._remaining - (time.monotonic() - self._started_at)
            signal.setitimer(signal.ITIMER_REAL, max(remaining, 1e-3), self._interval)

    def _ring(self, number: int, frame: FrameType | None) -> None:
        """Checks the time; calls an existing alarm when that is due."""
        if 0.0 < self._remaining <= time.monotonic() - self._started_at and callable(self._before):
            self._remaining, self._started_at = self._interval, time.monotonic()
            self._before(number, frame)
        now = self._now()
        self._unchanged_checks = self._unchanged_checks + 1 if now == self._progressed_at else 0
        self._progressed_at = now
        if self._unchanged_checks >= self._maximum_checks and not self.has_expired:
            self.has_expired, self.holder = True, _name(_foreign(frame, self._caller))
        if self.has_expired:
            raise StuckInterrupt


def _foreign(frame: FrameType | None, end: FrameType | None) -> FrameType | None:
    """The innermost call within `end` that is neither Python's nor lfield's own."""
    while frame is not None and frame is not end:
        file = frame.f_code.co_filename
        if not file.startswith(_INNOCENT) or any(part in file for part in _INSTALLED):
            return frame
        frame = frame.f_back
    return None


def _name(frame: FrameType | None) -> str:
    if frame is None:
        return ""
    return f"{frame.f_code.co_qualname} ({Path(frame.f_code.co_filename).name}:{frame.f_lineno})"
