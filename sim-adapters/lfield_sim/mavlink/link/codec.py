"""MAVLink 2 packets to messages and back, by pymavlink's `all` dialect."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from typing import Any

from pymavlink.dialects.v20 import all as dialect

#: The parser keeps its input until the buffer is empty, which may never happen on a stream.
MAX_BUFFER = 4096
#: Peers stored at most; the one that was silent longest is removed.
MAX_PEERS = 16


class PacketReader:
    """Parses the bytes of one peer; broken and unknown packets are skipped."""

    def __init__(self) -> None:
        self._parser: Any = dialect.MAVLink(None)
        self._parser.robust_parsing = True

    def feed(self, data: bytes) -> Iterator[Any]:
        """The messages that these bytes complete; never raises."""
        parser = self._parser
        for message in parser.parse_buffer(data) or ():
            if message.get_msgId() >= 0 and not isinstance(message, dialect.MAVLink_unknown):
                yield message
        if parser.buf_index > MAX_BUFFER:
            parser.buf = parser.buf[parser.buf_index :]
            parser.buf_index = 0


class PacketReaders:
    """A reader for every peer."""

    def __init__(self) -> None:
        self._readers: OrderedDict[Hashable, PacketReader] = OrderedDict()

    def __len__(self) -> int:
        return len(self._readers)

    def feed(self, peer: Hashable, data: bytes) -> Iterator[Any]:
        """The messages that these bytes of a peer complete; never raises."""
        reader = self._readers.setdefault(peer, PacketReader())
        self._readers.move_to_end(peer)
        if len(self._readers) > MAX_PEERS:
            self._readers.popitem(last=False)
        return reader.feed(data)


class PacketWriter:
    """Messages of one component to packets, with its own sequence numbers."""

    def __init__(self, system: int, component: int) -> None:
        self.packer: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, message: Any) -> bytes:
        """One packet."""
        data: bytes = bytes(message.pack(self.packer))
        self.packer.seq = (self.packer.seq + 1) % 256
        return data
