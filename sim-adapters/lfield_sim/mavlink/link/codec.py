"""MAVLink 2 packets to messages and back, by pymavlink's `all` dialect."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from typing import Any

from pymavlink.dialects.v20 import all as dialect

#: The parser keeps what it has read until the buffer is empty, which on a stream may be never.
KEPT = 4096
#: At most so many peers are remembered; the one that was silent longest is forgotten.
MAX_PEERS = 16


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


class Readers:
    """A reader for every peer."""

    def __init__(self) -> None:
        self._readers: OrderedDict[Hashable, Reader] = OrderedDict()

    def __len__(self) -> int:
        return len(self._readers)

    def feed(self, peer: Hashable, data: bytes) -> Iterator[Any]:
        """The messages that these bytes of a peer complete; never raises."""
        reader = self._readers.setdefault(peer, Reader())
        self._readers.move_to_end(peer)
        if len(self._readers) > MAX_PEERS:
            self._readers.popitem(last=False)
        return reader.feed(data)


class Writer:
    """Messages of one component to packets, with its own sequence numbers."""

    def __init__(self, system: int, component: int) -> None:
        self.packer: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, message: Any) -> bytes:
        """One packet."""
        data: bytes = bytes(message.pack(self.packer))
        self.packer.seq = (self.packer.seq + 1) % 256
        return data
