"""Frames of the Debug Adapter Protocol: a header with the length, an empty line, JSON (base protocol)."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Collection
from typing import Any, BinaryIO

from lfield.errors import UsageError

#: The largest message that is read, in bytes, and the longest header.
MAX_MESSAGE, MAX_HEADER = 16 << 20, 4096
#: Requests after which a client sends no other.
LAST = frozenset({"disconnect", "terminate"})
Message = dict[str, Any]


class DapStream:
    """Reads and writes messages; `source` and `sink` are blocking binary streams."""

    def __init__(self, source: BinaryIO, sink: BinaryIO) -> None:
        self._source, self._sink = source, sink
        self._number = 0

    def read(self) -> Message | None:
        """The next message; None at the end of the stream. Raises UsageError for another protocol."""
        size = -1
        while True:
            line = self._source.readline(MAX_HEADER)
            if not line:
                return None
            name, _, value = line.decode("latin-1").strip().partition(":")
            if not name:
                break
            if name.lower() == "content-length" and value.strip().isdigit():
                size = int(value)
        if not 0 <= size <= MAX_MESSAGE:
            raise UsageError("the client does not speak the Debug Adapter Protocol: no valid Content-Length")
        data = self._source.read(size)
        if len(data) < size:
            return None
        try:
            message = json.loads(data)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            raise UsageError("a message of the client is not a JSON object")
        return message

    def write(self, message: Message) -> None:
        """Send a message with the next number."""
        self._number += 1
        data = json.dumps({"seq": self._number, **message}).encode()
        self._sink.write(b"Content-Length: %d\r\n\r\n" % len(data) + data)
        self._sink.flush()


class RequestQueue:
    """The messages of a client, which a thread reads while the session works on an earlier one."""

    def __init__(self, stream: DapStream) -> None:
        self._stream = stream
        self._read: deque[Message | UsageError | None] = deque()
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="requests of the editor", daemon=True).start()

    def next(self) -> Message | None:
        """The next message; None at the end of the stream. Raises UsageError for another protocol."""
        with self._changed:
            self._changed.wait_for(lambda: self._read)
            found = self._read.popleft()
        if isinstance(found, UsageError):
            raise found
        return found

    def has_waiting(self, commands: Collection[str]) -> bool:
        """Whether a request of some commands, or the end of the stream, waits."""
        with self._changed:
            return any(not isinstance(m, dict) or m.get("command") in commands for m in self._read)

    def _run(self) -> None:
        is_open = True
        while is_open:
            message: Message | UsageError | None
            try:
                message = self._stream.read()
            except UsageError as error:
                message = error
            except (OSError, ValueError):  # closed while it is read
                message = None
            # After the last request the stream may be closed, which no thread must be reading then.
            is_open = isinstance(message, dict) and message.get("command") not in LAST
            with self._changed:
                self._read.append(message)
                self._changed.notify()
