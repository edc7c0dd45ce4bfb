"""MAVLink 2 packets to messages and back, by pymavlink's ardupilotmega dialect."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

#: The parser keeps what it has read until the buffer is empty, which on a stream may be never.
KEPT = 4096


class Reader:
    """The bytes of one peer to messages; what is broken or unknown is left out."""

    def __init__(self) -> None:
        self._parser: Any = dialect.MAVLink(None)
        self._parser.robust_parsing = True

    def feed(self, data: bytes) -> Iterator[Any]:
        """The messages that these bytes complete; never raises."""
        parser = self._parser
        for message in parser.parse_buffer(data) or ():
            if message.get_msgId() >= 0 and not isinstance(message, dialect.MAVLink_unknown):
                yield message
        if parser.buf_index > KEPT:
            parser.buf = parser.buf[parser.buf_index :]
            parser.buf_index = 0


class Writer:
    """Messages of one component to packets, with its own sequence numbers."""

    def __init__(self, system: int, component: int) -> None:
        self._mavlink: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, message: Any) -> bytes:
        """One packet."""
        data: bytes = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return data
