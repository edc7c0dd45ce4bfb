"""The failure of a host, by a bug of lfield or a lack of memory: no agent runs any more, and the process
ends.
"""

from __future__ import annotations

import asyncio
import errno
import os
import traceback
from collections.abc import Callable
from contextlib import suppress
from mmap import mmap
from typing import Any, Protocol

from lfield.devices.guard_process import STOPPING
from lfield.errors import HostFailure
from lfield.host.events.event_recorder import EventRecorder
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: Bytes reserved for ending a host without memory; until then it is address space only.
RESERVE_BYTES = 4 << 20
#: The resource that is exhausted when a socket call fails.
SCARCE_ERRNOS = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class NoteLine(Protocol):
    """Writes a log line, see `Host.note`."""

    def __call__(self, line: LogLine, *, lines: bool = False) -> None: ...


class HostFailures:
    """The failure of the host `name`; `on_failure` is called first when it fails."""

    def __init__(
        self, name: str, on_failure: Callable[[], None], recorder: EventRecorder, note: NoteLine
    ) -> None:
        self._name, self._on_failure, self._recorder, self._note = name, on_failure, recorder, note
        #: Set when the host has failed; `failure` is the exception.
        self.failed = asyncio.Event()
        self.failure: HostFailure | None = None
        self._reserve = mmap(-1, RESERVE_BYTES)

    def fail(self, error: BaseException) -> None:
        """The host has failed: guards get no heartbeat, and the process ends."""
        if self.failure is not None:
            return
        self._reserve.close()
        # First: no other fault may prevent the end of the process.
        self._on_failure()
        self.failure = HostFailure(self._name, error)
        self.failed.set()
        # The log itself may have the bug, and must not prevent the end of the process either.
        with suppress(Exception):
            self._recorder.on_host_stopping(str(self.failure), STOPPING)
            self._note(log_messages.HOST_FAILED.line(host=self._name, reason=self.failure.reason))
            if os.environ.get("LFIELD_TRACEBACK"):
                text = "".join(traceback.format_exception(error))
                self._note(log_messages.TRACEBACK.line(text=text), lines=True)

    def on_unhandled(self, context: dict[str, Any], log_once: Callable[[LogLine], object]) -> None:
        """An exception in a task or callback outside the core."""
        if reason := _scarce_resource(context):
            log_once(log_messages.NO_DESCRIPTORS.line(reason=reason))
            return
        error = context.get("exception")
        self.fail(error if isinstance(error, BaseException) else RuntimeError(context["message"]))


def _scarce_resource(context: dict[str, Any]) -> str:
    """The exhausted resource, if a socket call in the event loop failed for lack of it; '' for any other
    exception.
    """
    error = context.get("exception")
    is_scarce = isinstance(error, OSError) and error.errno in SCARCE_ERRNOS and "socket" in context
    return str(error.strerror) if is_scarce and error is not None else ""
