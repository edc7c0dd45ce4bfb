"""Files on a vehicle by MAVLink FTP: listed, read in bursts with the gaps filled, written and checked.

https://mavlink.io/en/services/ftp.html. A vehicle has few sessions, PX4 a single one, so each is ended
whatever happens, and those that a client which died has left are reset first.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.services.file_packets import (
    DATA,
    Entry,
    Opcode,
    Packet,
    Refusal,
    crc32,
    decode,
    entries,
    refusal_words,
)
from lfield_mavlink.services.peer import Inbox, Peer

#: Seconds to wait for an answer, and how often to ask; in the middle of a file there is somebody who
#: answers, so it is worth while to ask for longer.
PATIENCE, QUESTIONS, PERSISTENT = 0.5, 10, 16
#: Bytes of the largest file, entries of the largest folder, bytes of the longest path.
MAX_FILE, MAX_ENTRIES, MAX_PATH = 1 << 20, 5000, 200
#: How the names of files begin that are no files, but made anew by each reading.
MADE = "@"
#: Packets of one burst that are taken in; more is a vehicle gone mad.
MAX_BURST = MAX_FILE // 32


class FileTransfer:
    """The files of one vehicle; one transfer at a time."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._inbox = Inbox(peer, dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL)
        self._lock = asyncio.Lock()
        self._sequence = 0
        self._reset = False

    async def list_folder(self, path: str) -> list[Entry]:
        """What is in a folder, in the vehicle's order. Raises DeviceError."""
        async with self._transfer(path):
            found = await self._list(Opcode.LIST_WITH_TIME, path)
            return found if found is not None else await self._list(Opcode.LIST, path) or []

    async def read(self, path: str, most: int = MAX_FILE) -> bytes:
        """The bytes of a file, if they are not more than `most`, and as its checksum says if there is one.

        ArduPilot makes what begins with @ while it is read: it ends where it ends, whatever size was told,
        and the checksum is that of another reading. Raises DeviceError.
        """
        what, made = f"reading {path}", path.startswith(MADE)
        async with self._transfer(path) as name:
            async with self._session(what, Opcode.OPEN_READ, name) as opened:
                data = await self._read(what, opened, most, made=made)
            if not made:
                await self._check(path, name, data)
        return data

    async def write(self, path: str, data: bytes) -> None:
        """Make a file or replace one; its checksum is compared if the vehicle tells one.

        Raises DeviceError.
        """
        what = f"writing {path}"
        if len(data) > MAX_FILE:
            raise self._peer.error(f"{what}: {len(data)} bytes are more than the {MAX_FILE} that may be")
        async with self._transfer(path) as name:
            async with self._session(what, Opcode.CREATE, name) as created:
                for start in range(0, len(data), DATA):
                    piece = data[start : start + DATA]
                    await self._do(what, Opcode.WRITE, session=created.session, offset=start, data=piece)
            await self._check(path, name, data)

    async def remove(self, path: str) -> None:
        """Remove a file. Raises DeviceError."""
        async with self._transfer(path) as name:
            await self._do(f"removing {path}", Opcode.REMOVE, data=name)

    async def make_folder(self, path: str) -> None:
        """Make a folder. Raises DeviceError."""
        async with self._transfer(path) as name:
            await self._do(f"making {path}", Opcode.MAKE_FOLDER, data=name)

    # -- steps ------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def _transfer(self, path: str) -> AsyncIterator[bytes]:
        """The vehicle's file service for one transfer; yields the path in bytes."""
        name = path.encode()
        if not 0 < len(name) <= MAX_PATH or b"\0" in name:
            raise self._peer.error(f"'{path}' cannot be a path: 1 to {MAX_PATH} bytes, none of them 0")
        async with self._lock:
            with self._inbox.open() as self._mail:
                if not self._reset:
                    await self._do("beginning with files", Opcode.RESET)
                    self._reset = True
                yield name

    @asynccontextmanager
    async def _session(self, what: str, opcode: Opcode, name: bytes) -> AsyncIterator[Packet]:
        """An open file; yields the answer to its opening. Raises DeviceError."""
        try:
            opened = self._opened(what, await self._ask(opcode, data=name))
        except BaseException:
            # It may have been opened all the same, in a session that nobody knows of.
            self._reset = False
            raise
        try:
            yield opened
        except BaseException:
            # Without waiting for an answer: the call may have been cancelled. Where this is lost, the file
            # stays open, and ArduPilot and PX4 open no second one: the next transfer begins anew.
            self._request(Opcode.TERMINATE, session=opened.session)
            self._reset = False
            raise
        await self._ask(Opcode.TERMINATE, session=opened.session)

    def _opened(self, what: str, answer: Packet | None) -> Packet:
        """Of an opening. ArduPilot has one session, and says of a second only that it failed."""
        if answer is not None and answer.refusal in (Refusal.FAIL, Refusal.NO_SESSIONS):
            raise self._peer.error(
                f"{what} refused: {refusal_words(answer)}; it opens one file at a time, and another client "
                "may have one: try again"
            )
        return self._checked(what, answer)

    async def _list(self, opcode: Opcode, path: str) -> list[Entry] | None:
        """The entries by one kind of request; None when the vehicle does not know this kind."""
        found: list[Entry] = []
        place = 0
        while True:
            answer = await self._ask(opcode, offset=place, data=path.encode())
            if answer is not None and answer.refusal == Refusal.END_OF_FILE:
                return found
            if opcode is Opcode.LIST_WITH_TIME and (answer is None or answer.opcode == Opcode.NAK):
                return None
            more, taken = entries(self._checked(f"listing {path}", answer).data)
            found += more
            place += taken
            if not taken:
                return found
            if place > MAX_ENTRIES:
                raise self._peer.error(f"listing {path}: it has more than {MAX_ENTRIES} entries")

    async def _read(self, what: str, opened: Packet, most: int, *, made: bool) -> bytes:
        """The whole of an open file: in bursts to its end, then one by one what the bursts have left out."""
        size, session = opened.number, opened.session
        if size is None:
            raise self._peer.error(f"{what}: the autopilot does not tell its size")
        if made:
            size = min(size, most + 1)
        elif size > most:
            raise self._peer.error(f"{what}: its {size} bytes are more than the {most} that may be")
        file = Pieces(size)
        while file.reached < size and await self._burst(file, session):
            pass
        while (gap := file.first_gap()) is not None:
            start, length = gap[0], min(DATA, gap[1] - gap[0])
            answer = await self._ask(Opcode.READ, session=session, offset=start, size=length)
            if answer is not None and answer.refusal == Refusal.END_OF_FILE:
                break
            if not file.put(start, self._checked(what, answer).data):
                raise self._peer.error(f"{what}: an empty answer at byte {start}")
        data = file.until_gap()
        if len(data) > most:
            raise self._peer.error(f"{what}: it has more than the {most} bytes that may be")
        return data

    async def _burst(self, file: Pieces, session: int) -> bool:
        """Have the vehicle send what comes after the farthest byte yet; whether anything came."""
        before = file.reached
        request = self._request(Opcode.BURST_READ, session=session, offset=before, size=DATA)

        def is_of_burst(packet: Packet) -> bool:
            # Its packets are numbered on from the request.
            newer = 0 < (packet.sequence - request.sequence) % 0x10000 < 0x8000
            return packet.requested == Opcode.BURST_READ and packet.session == session and newer

        for _ in range(MAX_BURST):
            packet = await self._find(is_of_burst)
            if packet is None or packet.opcode == Opcode.NAK:
                break
            self._sequence = packet.sequence
            file.put(packet.offset, packet.data)
            if packet.burst_complete or file.first_gap() is None:
                break
        return file.reached > before

    async def _check(self, path: str, name: bytes, data: bytes) -> None:
        """Compare what was transferred with the checksum of what is there, if it can be had."""
        answer = await self._ask(Opcode.CRC32, data=name)
        if answer is None or answer.opcode == Opcode.NAK or answer.number is None:
            return
        if answer.number != crc32(data):
            raise self._peer.error(f"{path} on the vehicle differs from what was transferred; try again")

    # -- requests ---------------------------------------------------------------------------------------

    async def _do(
        self, what: str, opcode: Opcode, *, session: int = 0, offset: int = 0, data: bytes = b""
    ) -> Packet:
        """Ask for something that must succeed. Raises DeviceError with the refusal in words."""
        return self._checked(what, await self._ask(opcode, session=session, offset=offset, data=data))

    def _checked(self, what: str, answer: Packet | None) -> Packet:
        if answer is None:
            raise self._peer.error(f"{what}: the autopilot did not answer", timeout=True)
        if answer.opcode == Opcode.NAK:
            raise self._peer.error(f"{what} refused: {refusal_words(answer)}")
        return answer

    async def _ask(
        self,
        opcode: Opcode,
        *,
        session: int = 0,
        offset: int = 0,
        size: int | None = None,
        data: bytes = b"",
    ) -> Packet | None:
        """The answer to a request, which is repeated as it is; None when nobody answers."""
        request = self._request(opcode, session=session, offset=offset, size=size, data=data)
        number = (request.sequence + 1) % 0x10000
        for attempt in range(PERSISTENT if opcode in (Opcode.READ, Opcode.WRITE) else QUESTIONS):
            if attempt:
                self._send(request)
            answer = await self._find(lambda p: p.requested == opcode and p.sequence == number)
            if answer is not None:
                return answer
        return None

    def _request(
        self,
        opcode: Opcode,
        *,
        session: int = 0,
        offset: int = 0,
        size: int | None = None,
        data: bytes = b"",
    ) -> Packet:
        """Send a new request. Its answer has the next number, so the request after it is two on."""
        self._sequence = (self._sequence + 2) % 0x10000
        length = len(data) if size is None else size
        request = Packet(self._sequence, opcode, session, length, offset, data)
        self._send(request)
        return request

    def _send(self, packet: Packet) -> None:
        self._peer.send(
            dialect.MAVLink_file_transfer_protocol_message(0, self._peer.system, AUTOPILOT, packet.encode())
        )

    async def _find(self, wanted: Callable[[Packet], bool]) -> Packet | None:
        """The next answer that is wanted; None when it does not come within PATIENCE."""
        found: list[Packet] = []

        def is_wanted(message: Any) -> bool:
            packet = decode(message.payload)
            if packet is None or packet.opcode not in (Opcode.ACK, Opcode.NAK) or not wanted(packet):
                return False
            found.append(packet)
            return True

        await self._mail.find(is_wanted, PATIENCE)
        return found[0] if found else None


class Pieces:
    """A file of `size` bytes that arrives in pieces, in any order."""

    def __init__(self, size: int) -> None:
        self._data = bytearray(size)
        self._gaps = [(0, size)] if size else []
        #: The end of the farthest piece yet.
        self.reached = 0

    def first_gap(self) -> tuple[int, int] | None:
        """Where the first missing bytes begin and end; None when none are missing."""
        return self._gaps[0] if self._gaps else None

    def put(self, start: int, piece: bytes) -> int:
        """Take a piece in; how many bytes of it lie within the file."""
        end = min(start + len(piece), len(self._data))
        if end <= start:
            return 0
        self._data[start:end] = piece[: end - start]
        self.reached = max(self.reached, end)
        parts = (
            part for gap in self._gaps for part in ((gap[0], min(gap[1], start)), (max(gap[0], end), gap[1]))
        )
        self._gaps = [part for part in parts if part[0] < part[1]]
        return end - start

    def until_gap(self) -> bytes:
        """The file up to the first gap, which is its end when the vehicle says so."""
        return bytes(self._data[: self._gaps[0][0] if self._gaps else len(self._data)])
