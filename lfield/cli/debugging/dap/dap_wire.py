"""Frames of the Debug Adapter Protocol: a header with the length, an empty line, JSON (base protocol)."""

from __future__ import annotations

import json
from typing import Any, BinaryIO

from lfield.errors import UsageError

#: The largest message that is read, in bytes, and the longest header.
MAX_MESSAGE, MAX_HEADER = 16 << 20, 4096
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
