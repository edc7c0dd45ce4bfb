"""Segment files: a magic number, then frames of one record each.

    frame: length (4 bytes, little endian), CRC-32 of the record (4 bytes), record (msgpack)

A segment is append-only. A segment that ends within a frame, as after a crash, is valid up to its last
complete frame. A frame with a wrong checksum also ends the readable part, because its length cannot be
trusted.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import BinaryIO, NamedTuple
from zlib import crc32

from lfield.text.input_files import error_reason, read_up_to

#: The first bytes of each segment; the last one is the version of this format and of all records.
MAGIC = b"LFREC\x00\x00\x02"
#: The largest record, in bytes: a checkpoint of a host with many large blocks.
MAX_RECORD = 1 << 28
_HEADER = Struct("<II")
_CUT = "it ends within a record"
#: The number of bytes per read if contents are not relevant.
_PIECE = 1 << 20


class SegmentEnd(NamedTuple):
    """The end of the readable part of a segment, in bytes, and the reason: '' if it is complete.

    `is_cut`: no bytes follow, as after a crash.
    """

    offset: int
    reason: str
    is_cut: bool = False


def frame(record: bytes) -> bytes:
    """A record as a frame."""
    return _HEADER.pack(len(record), crc32(record)) + record


def format_problem(data: bytes) -> str:
    """The reason why a file with this beginning cannot be read, '' if it can; a shorter one has no record."""
    own = MAGIC[-1]
    if not data.startswith(MAGIC[:-1]):
        return "" if MAGIC.startswith(data) else "it is no recording"
    if data[: len(MAGIC)] in (MAGIC, MAGIC[:-1]):
        return ""
    version = data[len(MAGIC) - 1]
    which = "a newer lfield" if version > own else "the lfield that recorded it"
    return f"it has format {version}, and this lfield reads format {own}: use {which}"


class SegmentReader:
    """The records of one segment, read from `stream` one by one; `end` is the position and the reason of the
    end of reading.

    `problem` is the reason why the segment cannot be read at all, '' if it can. The reader never reads more
    than one record ahead, so a file of any size is harmless.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        head = stream.read(len(MAGIC))
        self.problem = format_problem(head)
        self.end = SegmentEnd(len(head), "")

    def __iter__(self) -> Iterator[bytes]:
        while True:
            try:
                record = self._next()
            except OSError as error:
                self.end = SegmentEnd(self.end.offset, f"it cannot be read: {error_reason(error)}")
                return
            if record is None:
                return
            yield record
            self.end = SegmentEnd(self.end.offset + _HEADER.size + len(record), "")

    def _next(self) -> bytes | None:
        """The next record; None if there is none, with the reason in `end`."""
        stream, offset = self._stream, self.end.offset
        header = stream.read(_HEADER.size)
        if not header:
            return None
        if len(header) < _HEADER.size:
            return self._cut()
        size, checksum = _HEADER.unpack(header)
        if not (size or checksum or self._has_data()):
            # The bytes are as after a power failure: the file system has stored its length before its
            # contents.
            return self._cut()
        if not 0 < size <= MAX_RECORD:
            self.end = SegmentEnd(offset, "the length of a record is damaged")
            return None
        record = read_up_to(stream, size)
        if len(record) < size:
            return self._cut()
        if crc32(record) != checksum:
            self.end = SegmentEnd(offset, "the checksum of a record is wrong")
            return None
        return record

    def _cut(self) -> bytes | None:
        self.end = SegmentEnd(self.end.offset, _CUT, is_cut=True)
        return None

    def _has_data(self) -> bool:
        """Whether a byte other than zero follows, or more zero bytes than a record has."""
        for _ in range(MAX_RECORD // _PIECE):
            piece = self._stream.read(_PIECE)
            if not piece or piece.count(0) < len(piece):
                return bool(piece)
        return True
