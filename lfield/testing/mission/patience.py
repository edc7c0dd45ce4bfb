"""A test takes no longer than it may, also where something in it blocks: that is interrupted, and named."""

from __future__ import annotations

import inspect
import signal
import sysconfig
import threading
import time
from pathlib import Path
from types import FrameType

import lfield

#: Seconds after which it is interrupted once more, since it may have caught the first time.
AGAIN = 1.0
#: Where code is that never holds anybody: it only waits for what others do.
_INNOCENT = (str(Path(lfield.__file__).parent), sysconfig.get_path("stdlib"))
#: Of it, what others have brought.
_BROUGHT = ("site-packages", "dist-packages")


class Held(KeyboardInterrupt):
    """Time is over. No `except Exception` catches it, and the loops of asyncio let it through."""


class Patience:
    """For so many seconds of real time what runs within goes on; then `Held` is raised in it.

    It is an alarm of the main thread, and so breaks into whatever waits there, but into no code in C that
    never comes back to Python. One that somebody else has set, as pytest-timeout does, is left in place where
    it rings first; in other threads there is none.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        #: Whether time is over, and who has held it then, as in `Depot.take (test_depot.py:12)`.
        self.over, self.holder = False, ""

    def __enter__(self) -> Patience:
        """Begin to wait."""
        self._caller, self._began = _foreign(inspect.currentframe(), None), time.monotonic()
        self._left, self._interval = signal.getitimer(signal.ITIMER_REAL)
        in_main = threading.current_thread() is threading.main_thread()
        self._set = in_main and not 0.0 < self._left <= self._seconds
        if self._set:
            self._before = signal.signal(signal.SIGALRM, self._ring)
            signal.setitimer(signal.ITIMER_REAL, self._seconds, AGAIN)
        return self

    def __exit__(self, *_: object) -> None:
        """It is done."""
        if not self._set:
            return
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._before)
        if self._left:
            rest = self._left - (time.monotonic() - self._began)
            signal.setitimer(signal.ITIMER_REAL, max(rest, AGAIN), self._interval)

    def _ring(self, _: int, frame: FrameType | None) -> None:
        if not self.over:
            self.over, self.holder = True, _name(_foreign(frame, self._caller))
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
