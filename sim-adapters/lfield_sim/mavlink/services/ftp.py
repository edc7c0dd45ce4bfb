"""MAVLink FTP server: requests in, replies out, over a file tree in memory. Pure.

Protocol: https://mavlink.io/en/services/ftp.html. A repeated request is answered again but executed once,
since a reply may be lost. A burst is sent some packets per step, as on a link with a limit.
"""

from __future__ import annotations

import struct
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from enum import IntEnum

from msgspec import Struct, field
from msgspec.structs import replace

from lfield_sim.mavlink.services.file_tree import FileTree, FileTreeError, FtpError

#: Bytes of a payload, of its header, and of its data.
PAYLOAD, HEADER = 251, struct.Struct("<HBBBBBxI")
DATA = PAYLOAD - HEADER.size
ACK, NAK = 128, 129
#: Open files at a time, of all peers (both autopilots have one); peers whose last reply is stored.
MAX_SESSIONS, MAX_PEERS = 1, 16
#: Packets of a burst per step, and of one burst until the client must continue it.
BURST_STEP, BURST_LENGTH = 10, 200

Peer = tuple[int, int]


class FtpOpcode(IntEnum):
    """MAV_FTP_OPCODE."""

    NONE = 0
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
    OPEN_WRITE = 11
    TRUNCATE = 12
    RENAME = 13
    CRC32 = 14
    BURST_READ = 15


class FtpPacket(Struct, frozen=True):
    """One request or reply. `request_opcode` is that of the answered request, `size` the length of the data
    or of the requested data.
    """

    number: int
    session: int
    opcode: int
    size: int = 0
    request_opcode: int = 0
    burst_over: int = 0
    offset: int = 0
    data: bytes = b""

    @classmethod
    def read(cls, payload: bytes) -> FtpPacket | None:
        """The packet in the payload of message 110; None if invalid."""
        if len(payload) < HEADER.size:
            return None
        number, session, opcode, size, request_opcode, over, offset = HEADER.unpack_from(payload)
        data = payload[HEADER.size : HEADER.size + size]
        return cls(number, session, opcode, size, request_opcode, over, offset, data)

    def write(self) -> bytes:
        """The payload of message 110."""
        head = (self.number, self.session, self.opcode, self.size, self.request_opcode)
        return (HEADER.pack(*head, self.burst_over, self.offset) + self.data).ljust(PAYLOAD, b"\0")

    @property
    def path(self) -> str:
        """The data as a path; invalid bytes become characters that no file name has."""
        return self.data.split(b"\0", 1)[0].decode("utf-8", "replace")

    def ack(self, data: bytes = b"", *, session: int | None = None) -> FtpPacket:
        """A positive answer; `session` is a newly opened one."""
        number = (self.number + 1) & 0xFFFF
        own = self.session if session is None else session
        return FtpPacket(number, own, ACK, len(data), self.opcode, 0, self.offset, data)

    def nak(self, error: FileTreeError) -> FtpPacket:
        """A refusal."""
        with_errno = error.error is FtpError.FAIL_ERRNO
        data = bytes([error.error, error.number] if with_errno else [error.error])
        return replace(self.ack(data), opcode=NAK)


class _Session(Struct):
    """An open file: its content when it was opened, or the place to write to."""

    path: str
    content: bytes | None = None


class _Burst(Struct):
    """The answer to a burst read: pieces of the file in sequence, until its end or a pause."""

    request: FtpPacket
    content: bytes
    offset: int
    sent: int = 0

    def next(self) -> FtpPacket:
        """The next packet; the last one pauses the burst, or refuses at the end of the file."""
        piece = self.content[self.offset : self.offset + (self.request.size or DATA)]
        reply = self.request.ack(piece) if piece else self.request.nak(FileTreeError(FtpError.EOF))
        number = (reply.number + self.sent) & 0xFFFF
        reply = replace(reply, number=number, offset=self.offset)
        self.sent, self.offset = self.sent + 1, self.offset + len(piece)
        return replace(reply, burst_over=1) if piece and self.sent == BURST_LENGTH else reply


class FtpStyle(Struct, frozen=True):
    """File service of an autopilot.

    own_sessions     the autopilot assigns session numbers, else the client does
    unknown          the error for an unknown opcode
    unknown_text     the text for an unknown opcode, '' for none
    busy             the error for too many open files
    no_session       the error for an unknown session; `lenient`: closing one is accepted
    empty_is_root    an empty folder name is the root, else invalid
    entry_end        terminator of a list entry
    creates          opening a file to write creates it; creating and writing return a size
    """

    own_sessions: bool
    unknown: FtpError
    unknown_text: str
    busy: FtpError
    no_session: FtpError
    lenient: bool
    empty_is_root: bool
    entry_end: bytes
    creates: bool


ARDUPILOT = FtpStyle(
    own_sessions=False,
    unknown=FtpError.FAIL,
    unknown_text="Unsupported FTP: {opcode}",
    busy=FtpError.FAIL,
    no_session=FtpError.NOT_FOUND,
    lenient=True,
    empty_is_root=False,
    entry_end=b"\0\0",
    creates=False,
)
PX4 = FtpStyle(
    own_sessions=True,
    unknown=FtpError.UNKNOWN_COMMAND,
    unknown_text="",
    busy=FtpError.NO_SESSIONS,
    no_session=FtpError.INVALID_SESSION,
    lenient=False,
    empty_is_root=True,
    entry_end=b"\0",
    creates=True,
)


def _silence(_: str) -> None:
    pass


class FtpServer(Struct):
    """The files of one vehicle; `say` sends a text."""

    tree: FileTree
    style: FtpStyle = PX4
    say: Callable[[str], None] = _silence
    _sessions: OrderedDict[tuple[Peer, int], _Session] = field(default_factory=OrderedDict)
    _bursts: dict[tuple[Peer, int], _Burst] = field(default_factory=dict)
    _last: OrderedDict[Peer, tuple[FtpPacket, FtpPacket]] = field(default_factory=OrderedDict)

    def receive(self, peer: Peer, payload: bytes) -> list[bytes]:
        """Answers a payload; an invalid one has no answer."""
        request = FtpPacket.read(payload)
        if request is None or request.opcode in (ACK, NAK):
            return []
        if peer in self._last and self._last[peer][0] == request:
            return [self._last[peer][1].write()]
        try:
            reply = self._execute(peer, request)
        except FileTreeError as error:
            reply = request.nak(error)
        if reply is None:
            return []
        self._last[peer] = request, reply
        self._last.move_to_end(peer)
        if len(self._last) > MAX_PEERS:
            self._last.popitem(last=False)
        return [reply.write()]

    def advance(self) -> list[tuple[Peer, bytes]]:
        """The next packets of running bursts."""
        return [(key[0], packet.write()) for key in list(self._bursts) for packet in self._next_of_burst(key)]

    def forget(self) -> None:
        """Closes all files."""
        self._sessions.clear()
        self._bursts.clear()
        self._last.clear()

    def _execute(self, peer: Peer, request: FtpPacket) -> FtpPacket | None:
        if request.size > DATA:
            raise FileTreeError(FtpError.INVALID_DATA_SIZE)
        handler = _HANDLERS.get(request.opcode)
        if handler is None or (request.opcode == FtpOpcode.TRUNCATE and not self.style.creates):
            if self.style.unknown_text:
                self.say(self.style.unknown_text.format(opcode=request.opcode))
            raise FileTreeError(self.style.unknown)
        return handler(self, peer, request)

    # -- folders and whole files ----------------------------------------------------------------------

    def _list(self, _: Peer, request: FtpPacket) -> FtpPacket:
        if not request.path and not self.style.empty_is_root:
            raise FileTreeError(FtpError.INVALID_DATA_SIZE)
        data = b""
        for entry in self.tree.entries(request.path)[request.offset :]:
            text = entry.encode() + self.style.entry_end
            if len(data) + len(text) > DATA:
                break
            data += text
        if not data:
            raise FileTreeError(FtpError.EOF)
        return request.ack(data)

    def _remove(self, _: Peer, request: FtpPacket) -> FtpPacket:
        self.tree.remove(request.path)
        return request.ack()

    def _make_folder(self, _: Peer, request: FtpPacket) -> FtpPacket:
        self.tree.make_folder(request.path)
        return request.ack()

    def _remove_folder(self, _: Peer, request: FtpPacket) -> FtpPacket:
        self.tree.remove_folder(request.path)
        return request.ack()

    def _crc32(self, _: Peer, request: FtpPacket) -> FtpPacket:
        return request.ack(struct.pack("<I", ftp_crc32(self.tree.checked(request.path))))

    def _rename(self, _: Peer, request: FtpPacket) -> FtpPacket:
        old, new = [*request.data.split(b"\0"), b""][:2]
        self.tree.rename(_text(old), _text(new))
        return request.ack()

    def _truncate(self, _: Peer, request: FtpPacket) -> FtpPacket:
        self.tree.truncate(request.path, request.offset)
        return request.ack()

    # -- sessions -------------------------------------------------------------------------------------

    def _open_read(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        content = self.tree.read(request.path)
        session = self._open(peer, request, _Session(request.path, content))
        return request.ack(struct.pack("<I", self.tree.size(request.path)), session=session)

    def _open_write(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        if self.style.creates and not self.tree.has(request.path):
            self.tree.create(request.path)
        self.tree.write(request.path, 0, b"")
        session = self._open(peer, request, _Session(request.path))
        return request.ack(self._size(0), session=session)

    def _create(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        self.tree.create(request.path)
        session = self._open(peer, request, _Session(request.path))
        return request.ack(self._size(0), session=session)

    def _size(self, size: int) -> bytes:
        return struct.pack("<I", size) if self.style.creates else b""

    def _open(self, peer: Peer, request: FtpPacket, session: _Session) -> int:
        used = {number for _, number in self._sessions}
        number = request.session
        if self.style.own_sessions:
            number = min(set(range(MAX_SESSIONS + 1)) - used)
        if len(self._sessions) >= MAX_SESSIONS:
            raise FileTreeError(self.style.busy)
        self._sessions[peer, number] = session
        return number

    def _session(self, peer: Peer, request: FtpPacket) -> _Session:
        if (peer, request.session) not in self._sessions:
            raise FileTreeError(self.style.no_session)
        return self._sessions[peer, request.session]

    def _content(self, peer: Peer, request: FtpPacket) -> bytes:
        """Data of the open file; FileTreeError at its end, and for one open for writing."""
        content = self._session(peer, request).content
        if content is None:
            raise FileTreeError(FtpError.FAIL)
        if request.offset >= len(content):
            raise FileTreeError(FtpError.EOF)
        return content

    def _read(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        content = self._content(peer, request)
        return request.ack(content[request.offset : request.offset + (request.size or DATA)])

    def _burst_read(self, peer: Peer, request: FtpPacket) -> None:
        content = self._content(peer, request)
        self._bursts[peer, request.session] = _Burst(request, content, request.offset)

    def _next_of_burst(self, key: tuple[Peer, int]) -> list[FtpPacket]:
        burst = self._bursts[key]
        packets: list[FtpPacket] = []
        for _ in range(BURST_STEP):
            packets.append(burst.next())
            if packets[-1].burst_over or packets[-1].opcode == NAK:
                del self._bursts[key]
                break
        return packets

    def _write(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        session = self._session(peer, request)
        if session.content is not None:
            raise FileTreeError(FtpError.FAIL)
        self.tree.write(session.path, request.offset, request.data)
        return request.ack(self._size(len(request.data)))

    def _terminate(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        if self.style.lenient and (peer, request.session) not in self._sessions:
            return request.ack()
        self._session(peer, request)
        del self._sessions[peer, request.session]
        self._bursts.pop((peer, request.session), None)
        return request.ack()

    def _reset(self, peer: Peer, request: FtpPacket) -> FtpPacket:
        for table in (self._sessions, self._bursts):
            for key in [key for key in table if key[0] == peer]:
                del table[key]
        return request.ack()

    def _acknowledge(self, _: Peer, request: FtpPacket) -> FtpPacket:
        return request.ack()


def _text(data: bytes) -> str:
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def ftp_crc32(data: bytes) -> int:
    """The CRC-32 of FTP: the usual one, starting from 0 and not inverted."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


_HANDLERS: Mapping[int, Callable[[FtpServer, Peer, FtpPacket], FtpPacket | None]] = {
    FtpOpcode.NONE: FtpServer._acknowledge,
    FtpOpcode.TERMINATE: FtpServer._terminate,
    FtpOpcode.RESET: FtpServer._reset,
    FtpOpcode.LIST: FtpServer._list,
    FtpOpcode.OPEN_READ: FtpServer._open_read,
    FtpOpcode.READ: FtpServer._read,
    FtpOpcode.CREATE: FtpServer._create,
    FtpOpcode.WRITE: FtpServer._write,
    FtpOpcode.REMOVE: FtpServer._remove,
    FtpOpcode.MAKE_FOLDER: FtpServer._make_folder,
    FtpOpcode.REMOVE_FOLDER: FtpServer._remove_folder,
    FtpOpcode.OPEN_WRITE: FtpServer._open_write,
    FtpOpcode.TRUNCATE: FtpServer._truncate,
    FtpOpcode.RENAME: FtpServer._rename,
    FtpOpcode.CRC32: FtpServer._crc32,
    FtpOpcode.BURST_READ: FtpServer._burst_read,
}
