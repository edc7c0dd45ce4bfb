"""MCAP files (https://mcap.dev/spec) with JSON messages, through the package `mcap`. Pure.

The file consists of chunks, each complete in itself, and a summary with indexes at the end. A file with
`END_WITHOUT_SUMMARY` after its chunks is valid too: readers read it from its beginning.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

import msgspec

from lfield import __version__
from lfield.errors import PluginError
from lfield.export.channels import Channel, ChannelMessage, MessageSchema, nanoseconds
from lfield.export.export_input import NO_INFO, MissionInfo, StreamItem
from lfield.export.message_stream import MessageStream

if TYPE_CHECKING:
    from mcap.writer import Writer


#: The end of a file without a summary: the end of the data, a footer without references, and the magic.
END_WITHOUT_SUMMARY = struct.pack("<BQIBQQQI8s", 0x0F, 4, 0, 0x02, 20, 0, 0, 0, b"\x89MCAP0\r\n")
#: The most channels of a file: hosts may report any names.
MAX_CHANNELS = 8192


class ByteSink(Protocol):
    """The destination of the file, from its beginning to its end."""

    def write(self, data: bytes, /) -> object:
        """Append bytes."""

    def flush(self) -> object:
        """Called when the bytes so far are a readable beginning of the file."""


class _CountingSink:
    """The file functions that the package `mcap` uses; `size` is the number of bytes written."""

    def __init__(self, out: ByteSink) -> None:
        self._out, self.size = out, 0
        self.flush = out.flush

    def write(self, data: bytes) -> None:
        """Append bytes."""
        self._out.write(data)
        self.size += len(data)

    def tell(self) -> int:
        """The position at the end."""
        return self.size


class McapRecording:
    """An MCAP file under construction: items in, bytes to `out`.

    `messages` counts those in the file, `dropped` those of channels beyond `MAX_CHANNELS`.
    """

    def __init__(self, info: MissionInfo, out: ByteSink) -> None:
        """Raises PluginError without the package `mcap`."""
        self._stream, self._out = MessageStream(info), _CountingSink(out)
        self._writer = _writer(self._out)
        self._channels: dict[Channel, int] = {}
        self._schemas: dict[int, tuple[MessageSchema, int]] = {}
        self.messages = self.dropped = 0
        self._writer.start(library=f"lfield {__version__}")
        facts = {"mission": info.name, "lfield": __version__}
        if info.origin is not None:
            facts["origin"] = str(info.origin)
        self._writer.add_metadata("lfield", facts)

    @property
    def size(self) -> int:
        """The number of bytes so far."""
        return self._out.size

    @property
    def channels(self) -> int:
        """The number of channels so far."""
        return len(self._channels)

    def add(self, item: StreamItem) -> None:
        """Add the next item of the stream."""
        for message in self.messages_of(item):
            self.add_message(message, message.time)

    def messages_of(self, item: StreamItem) -> Iterator[ChannelMessage]:
        """The messages of the next item of the stream, for `add_message`."""
        return self._stream.messages(item)

    def flush(self) -> None:
        """End the chunk, so that all items so far are in the file even if its end is never written."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap has types, but not here

    def finish(self) -> None:
        """Write the summary; no item can be added after it."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # as above

    def add_message(self, message: ChannelMessage, log_time: float) -> None:
        """Write a message with that log time, in seconds since 1970, and its own time as publish time."""
        channel = self._channels.get(message.channel)
        if channel is None and len(self._channels) >= MAX_CHANNELS:
            self.dropped += 1
            return
        if channel is None:
            channel = self._channels[message.channel] = self._register(message.channel)
        logged, published = nanoseconds(log_time), nanoseconds(message.time)
        self._writer.add_message(
            channel, logged, msgspec.json.encode(message.data), published, self.messages & 0xFFFFFFFF
        )
        self.messages += 1

    def _register(self, channel: Channel) -> int:
        schema = channel.schema
        if id(schema) not in self._schemas:
            number = self._writer.register_schema(schema.name, "jsonschema", msgspec.json.encode(schema.json))
            # The schema is kept, so that its id stays its own.
            self._schemas[id(schema)] = schema, number
        _, number = self._schemas[id(schema)]
        return self._writer.register_channel(channel.topic, "json", number, dict(channel.metadata))


def require_mcap() -> None:
    """Raises PluginError when the package `mcap` is not installed."""
    if find_spec("mcap") is None:
        raise PluginError("MCAP files need the package mcap on this computer: pip install 'lfield[mcap]'")


def export_mcap(stream: Iterable[StreamItem], info: MissionInfo = NO_INFO, *, out: ByteSink) -> McapRecording:
    """Write a whole stream as an MCAP file. Raises PluginError, and the errors of the stream and of `out`."""
    recording = McapRecording(info, out)
    for item in stream:
        recording.add(item)
    recording.finish()
    return recording


def _writer(out: _CountingSink) -> Writer:
    require_mcap()
    # The package is only on computers of operators, and its compressors take time to load.
    from mcap.writer import Writer

    return Writer(out)  # type: ignore[arg-type]  # it writes, tells and flushes
