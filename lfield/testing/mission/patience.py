"""A test ends, also where something in it blocks or never comes to an end: that is interrupted, and named.

A mission's time tells it: a computer that is slow lets that go on, and who blocks does not.
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

#: Seconds between two looks at the mission's time, at most; and after which who has caught the first
#: interruption is interrupted once more.
LOOK = 1.0
#: Where code is that never holds anybody: it only waits for what others do.
_INNOCENT = (str(Path(lfield.__file__).parent), sysconfig.get_path("stdlib"))
#: Of it, what others have brought.
_BROUGHT = ("site-packages", "dist-packages")


class Held(KeyboardInterrupt):
    """Time stands still for too long. No `except Exception` catches it, and loops of asyncio let it pass."""


class Patience:
    """When `now` has told one time for so many seconds of real time, `Held` is raised in what runs within.

    Those are counted in looks: a computer that is stopped or has no time for this process does not look.

    It is an alarm of the main thread, and so breaks into whatever waits there, but into no code in C that
    never comes back to Python. One that somebody else has set, as pytest-timeout does, rings when it is due,
    and is left in place where it would end Python; in other threads there is none.
    """

    def __init__(self, seconds: float, now: Callable[[], float]) -> None:
        self._now, self._look = now, min(LOOK, seconds / 4)
        #: How many looks may find one time, how many have, and which.
        self._most, self._same, self._seen = round(seconds / self._look), 0, now()
        #: Whether it was too long, and who has held it, as in `Depot.take (test_depot.py:12)`.
        self.over, self.holder = False, ""

    def __enter__(self) -> Patience:
        """Begin to wait."""
        self._caller, self._began = _foreign(inspect.currentframe(), None), time.monotonic()
        self._left, self._interval = signal.getitimer(signal.ITIMER_REAL)
        self._before = signal.getsignal(signal.SIGALRM)
        in_main = threading.current_thread() is threading.main_thread()
        self._set = in_main and (callable(self._before) or not self._left)
        if self._set:
            signal.signal(signal.SIGALRM, self._ring)
            first = min(self._look, self._left or self._look)
            signal.setitimer(signal.ITIMER_REAL, first, self._look)
        return self

    def __exit__(self, *_: object) -> None:
        """It is done."""
        if not self._set:
            return
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._before)
        if self._left:
            rest = self._left - (time.monotonic() - self._began)
            signal.setitimer(signal.ITIMER_REAL, max(rest, 1e-3), self._interval)

    def _ring(self, number: int, frame: FrameType | None) -> None:
        """Look at the time; and ring for somebody else, when that is due."""
        if 0.0 < self._left <= time.monotonic() - self._began and callable(self._before):
            self._left, self._began = self._interval, time.monotonic()
            self._before(number, frame)
        now = self._now()
        self._same = self._same + 1 if now == self._seen else 0
        self._seen = now
        if self._same >= self._most and not self.over:
            self.over, self.holder = True, _name(_foreign(frame, self._caller))
        if self.over:
            raise Held


def _foreign(frame: FrameType | None, end: FrameType | None) -> FrameType | None:
    """The innermost of the calls within `end` that is neither Python's nor lfield's own."""
    while frame is not None and frame is not end:
        file = frame.f_code.co_filename
        if not file.startswith(_INNOCENT) or any(part in file for part in _BROUGHT):
            return frame
        frame = frame.f_back
    return None


def _name(frame: FrameType | None) -> str:
    if frame is None:
        return ""
    return f"{frame.f_code.co_qualname} ({Path(frame.f_code.co_filename).name}:{frame.f_lineno})"
