"""Segment files: a magic number, then frames of one record each. Pure.

    frame: length (4 bytes, little endian), CRC-32 of the record (4 bytes), record (msgpack)

A segment is append-only. One that ends within a frame, as after a crash, is valid up to its last complete
frame. A frame with a wrong checksum ends the readable part as well: its length cannot be trusted either.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import NamedTuple
from zlib import crc32

#: The first bytes of each segment; the last one is the version of this format and of all records.
MAGIC = b"LFREC\x00\x00\x02"
#: The largest record, in bytes: a checkpoint of a host with many large blocks.
MAX_RECORD = 1 << 28
_HEADER = Struct("<II")
_CUT = "it ends within a record"


class SegmentEnd(NamedTuple):
    """Where the readable part of a segment ends, in bytes, and why: '' if it is complete.

    `is_cut`: nothing follows, as after a crash.
    """

    offset: int
    reason: str
    is_cut: bool = False


def frame(record: bytes) -> bytes:
    """A record as a frame."""
    return _HEADER.pack(len(record), crc32(record)) + record


def format_problem(data: bytes) -> str:
    """Why a file that begins like this cannot be read, '' if it can; a shorter one has no record."""
    own = MAGIC[-1]
    if not data.startswith(MAGIC[:-1]):
        return "" if MAGIC.startswith(data) else "it is no recording"
    if data[: len(MAGIC)] in (MAGIC, MAGIC[:-1]):
        return ""
    version = data[len(MAGIC) - 1]
    which = "a newer lfield" if version > own else "the lfield that recorded it"
    return f"it has format {version}, and this lfield reads format {own}: use {which}"


class SegmentReader:
    """The records of one segment; `end` says where and why reading ended."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self.end = SegmentEnd(len(data), "")

    def __iter__(self) -> Iterator[bytes]:
        data, offset = self._data, len(MAGIC)
        while offset < len(data):
            start = offset + _HEADER.size
            if start > len(data):
                self.end = SegmentEnd(offset, _CUT, is_cut=True)
                return
            size, checksum = _HEADER.unpack_from(data, offset)
            if size > MAX_RECORD:
                self.end = SegmentEnd(offset, "the length of a record is damaged")
                return
            if start + size > len(data):
                self.end = SegmentEnd(offset, _CUT, is_cut=True)
                return
            record = bytes(data[start : start + size])
            if crc32(record) != checksum:
                self.end = SegmentEnd(offset, "the checksum of a record is wrong")
                return
            yield record
            offset = start + size
        self.end = SegmentEnd(offset, "")
