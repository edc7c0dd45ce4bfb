"""Packets of MAVLink FTP, the 251 bytes of FILE_TRANSFER_PROTOCOL.

https://mavlink.io/en/services/ftp.html. Pure: bytes in, packets out.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from enum import IntEnum

from msgspec import Struct

#: sequence, session, opcode, size, requested opcode, burst complete, padding, offset
_HEAD = struct.Struct("<HBBBBBxI")
#: Bytes of a whole packet, and of its data.
PACKET, DATA = 251, 251 - _HEAD.size


class Opcode(IntEnum):
    """The requests, and the two answers."""

    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN_READ = 4
    READ = 5
    CREATE = 6
    WRITE = 7
    REMOVE = 8
    MAKE_FOLDER = 9
    REMOVE_FOLDER = 10
    CRC32 = 14
    BURST_READ = 15
    LIST_WITH_TIME = 16
    ACK = 128
    NAK = 129


class NakCode(IntEnum):
    """NAK codes with their own text."""

    FAIL = 1
    FAIL_ERRNO = 2
    NO_SESSIONS = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    EXISTS = 8
    PROTECTED = 9
    NOT_FOUND = 10


_REFUSAL_TEXTS: Mapping[int, str] = {
    NakCode.FAIL: "it failed",
    3: "the packet had a wrong size",
    4: "the session is not open",
    NakCode.NO_SESSIONS: "no session is free",
    NakCode.END_OF_FILE: "the end of the file",
    NakCode.UNKNOWN_COMMAND: "the autopilot does not support this",
    NakCode.EXISTS: "it already exists",
    NakCode.PROTECTED: "it is write-protected",
    NakCode.NOT_FOUND: "no such file or folder",
}


class Packet(Struct, frozen=True):
    """One request or answer. `size` is the length of `data`; in reads the requested length."""

    sequence: int
    opcode: int
    session: int = 0
    size: int = 0
    offset: int = 0
    data: bytes = b""
    requested: int = 0
    burst_complete: bool = False

    def encode(self) -> list[int]:
        """The payload of a FILE_TRANSFER_PROTOCOL message."""
        complete = int(self.burst_complete)
        head = _HEAD.pack(
            self.sequence, self.session, self.opcode, self.size, self.requested, complete, self.offset
        )
        return list((head + self.data).ljust(PACKET, b"\0"))

    @property
    def refusal(self) -> int:
        """The code of a NAK; 0 without one."""
        return self.data[0] if self.opcode == Opcode.NAK and self.data else 0

    @property
    def number(self) -> int | None:
        """The 32-bit number in an answer (a file size, a checksum), or None."""
        return int.from_bytes(self.data[:4], "little") if len(self.data) >= 4 else None


def decode(payload: Sequence[int]) -> Packet | None:
    """The packet in a payload; None if invalid."""
    raw = bytes(payload)
    if len(raw) != PACKET:
        return None
    sequence, session, opcode, size, requested, complete, offset = _HEAD.unpack_from(raw)
    if size > DATA:
        return None
    data = raw[_HEAD.size : _HEAD.size + size]
    return Packet(sequence, opcode, session, size, offset, data, requested, bool(complete))


def refusal_text(answer: Packet) -> str:
    """Describes a NAK."""
    code = answer.refusal
    if code == NakCode.FAIL_ERRNO and len(answer.data) > 1:
        return f"{os.strerror(answer.data[1])} (errno {answer.data[1]})"
    return f"{_REFUSAL_TEXTS.get(code, 'for an unknown reason')} ({code})"


def crc32(data: bytes) -> int:
    """The checksum of the CRC32 request: the usual polynomial, starting at 0 and not inverted."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


class FileEntry(Struct, frozen=True):
    """A file with its size in bytes, or a folder."""

    name: str
    folder: bool
    size: int = 0


def entries(data: bytes) -> tuple[list[FileEntry], int]:
    """The entries in the answer to a list request, and the number of listing positions they take.

    Skipped and invalid entries count too.
    """
    listed: list[FileEntry] = []
    texts = [part for part in data.split(b"\0") if part]
    for text in texts:
        kind, (name, _, attributes) = text[:1], text[1:].decode(errors="replace").partition("\t")
        size = attributes.partition("\t")[0]
        if kind == b"D" and name not in ("", ".", ".."):
            listed.append(FileEntry(name, True))
        elif kind == b"F" and name:
            listed.append(FileEntry(name, False, int(size) if size.isascii() and size.isdigit() else 0))
    return listed, len(texts)
