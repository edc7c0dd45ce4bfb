"""SDO client, one transfer at a time (CiA 301, 7.2.4). Pure: answers and time-outs in, frames out.

Uploads are expedited or segmented, downloads expedited (at most four bytes). An answer is accepted only for
the requested object, kind and, for a segment, toggle bit. Other frames are ignored.

Two answers about one object look alike, even if the first is late. A server answers in order. So an object
whose answer was missed is *unsynchronized*: before it is requested again, another object, the *probe*, is
requested; its answer may be an abort. After that answer, no older answer can follow.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import Enum, auto
from itertools import count

from msgspec import Struct

#: Attempts of one transfer, and seconds to wait for each answer.
TRIES, ANSWER = 3, 0.3
#: Answers with more bytes are invalid here.
LONGEST = 64

#: Index and subindex of an object.
Key = tuple[int, int]

# Kinds of requests and answers: the upper three bits of the first byte.
_DOWNLOAD, _UPLOAD, _SEGMENT = 0x20, 0x40, 0x60
_UPLOADED, _DOWNLOADED, _SEGMENT_UPLOADED = 0x40, 0x60, 0x00
_KIND = 0xE0
#: The first byte of an abort, from either side; it has no answer.
ABORT = 0x80
# Other bits of the first byte.
_EXPEDITED, _SIZED, _TOGGLE, _LAST = 0x02, 0x01, 0x10, 0x01

#: Our abort codes (CiA 301, table 22): time-out, too long, wrong length, not needed.
TIMED_OUT, NO_MEMORY, WRONG_LENGTH, GENERAL_ERROR = 0x05040000, 0x05040005, 0x06070010, 0x08000000

#: Probes: the identity of the node, which is mandatory (CiA 301, 7.5.2.19), with optional subindexes. There
#: are so many that no late answer can be mistaken for the answer to a later probe of the same object.
PROBES: Sequence[Key] = [(0x1018, subindex) for subindex in range(16)]


class Send(Struct, frozen=True):
    """Effect: a frame for the server; an answer is awaited for `within` seconds, None for none."""

    data: bytes
    within: float | None = None


class Done(Struct, frozen=True):
    """Effect: the transfer is complete; `data` of an upload."""

    data: bytes = b""


class Refused(Struct, frozen=True):
    """Effect: the server has aborted the transfer, with an abort code of CiA 301, table 22."""

    code: int


class Failed(Struct, frozen=True):
    """Effect: there is no valid answer. `silent`: none arrived in time."""

    reason: str
    silent: bool = False


Result = Done | Refused | Failed
Effect = Send | Result


class _Phase(Enum):
    IDLE = auto()
    PROBING = auto()
    INITIATED = auto()
    SEGMENTS = auto()


class SdoClient:
    """The transfers with one server. Every method returns effects in order.

    `upload` and `download` start a transfer when none is running; a result ends it.
    """

    def __init__(self) -> None:
        self._phase = _Phase.IDLE
        self._key: Key = (0, 0)
        self._request = b""
        #: The expected object of the answer, or a probe.
        self._expected_key: Key = (0, 0)
        self._attempts_left = self._toggle = 0
        self._data, self._size = b"", 0
        #: Objects whose answer was missed, with the sequence number of their last request.
        self._unsynchronized: dict[Key, int] = {}
        self._order = count()

    # -- events -----------------------------------------------------------------------------------------

    def upload(self, key: Key) -> list[Effect]:
        """Reads an object."""
        return self._start(key, _frame(_UPLOAD, key))

    def download(self, key: Key, data: bytes) -> list[Effect]:
        """Writes an object; 1 to 4 bytes."""
        assert 1 <= len(data) <= 4, "only numbers of 1 to 4 bytes are written"
        command = _DOWNLOAD | (4 - len(data)) << 2 | _EXPEDITED | _SIZED
        return self._start(key, _frame(command, key, data))

    def on_response(self, frame: bytes) -> list[Effect]:
        """Handles a frame of the server, eight bytes of any content."""
        if self._phase is _Phase.IDLE or len(frame) != 8:
            return []
        if (
            self._phase is _Phase.SEGMENTS
            and frame[0] & (_KIND | _TOGGLE) == _SEGMENT_UPLOADED | self._toggle
        ):
            return self._on_segment(frame)
        command, index, subindex = struct.unpack_from("<BHB", frame)
        if (index, subindex) != self._expected_key:
            return []
        if self._phase is _Phase.PROBING:
            return self._on_probe(command)
        if command == ABORT:
            return [self._finish(Refused(int.from_bytes(frame[4:], "little")))]
        if self._phase is not _Phase.INITIATED:
            return []
        is_upload = self._request[0] & _KIND == _UPLOAD
        if is_upload and command & _KIND == _UPLOADED:
            return self._on_upload(frame)
        if not is_upload and command & _KIND == _DOWNLOADED:
            return [self._finish(Done())]
        return []

    def on_timeout(self) -> list[Effect]:
        """Handles a late answer: the transfer is repeated, or has failed."""
        self._attempts_left -= 1
        abort_request = self._abandon(TIMED_OUT)
        if not self._attempts_left:
            return [
                abort_request,
                self._finish(Failed(f"no answer within {ANSWER:g} s, {TRIES} times", silent=True)),
            ]
        return [abort_request, self._probe() if self._phase is _Phase.PROBING else self._send_request()]

    def on_cancelled(self) -> list[Effect]:
        """Aborts a transfer whose result is no longer needed."""
        if self._phase is _Phase.IDLE:
            return []
        abort_request = self._abandon(GENERAL_ERROR)
        self._phase = _Phase.IDLE
        return [abort_request]

    # -- a transfer -------------------------------------------------------------------------------------

    def _start(self, key: Key, request: bytes) -> list[Effect]:
        assert self._phase is _Phase.IDLE, "one transfer at a time"
        self._key, self._request, self._attempts_left = key, request, TRIES
        return [self._probe() if key in self._unsynchronized else self._send_request()]

    def _send_request(self) -> Send:
        """The first request of the transfer. A late answer to an earlier attempt of it is valid too."""
        self._phase, self._expected_key = _Phase.INITIATED, self._key
        self._data, self._toggle = b"", 0
        return Send(self._request, ANSWER)

    def _on_upload(self, frame: bytes) -> list[Effect]:
        """Handles the start of an upload: all of its data, or their length (0: unknown)."""
        command, value = frame[0], frame[4:]
        if command & _EXPEDITED:
            length = 4 - (command >> 2 & 3) if command & _SIZED else 4
            return [self._finish(Done(value[:length]))]
        self._size = int.from_bytes(value, "little") if command & _SIZED else 0
        if self._size > LONGEST:
            return self._refuse(NO_MEMORY, f"received {self._size} bytes, more than {LONGEST}")
        self._phase = _Phase.SEGMENTS
        return [self._next_segment()]

    def _next_segment(self) -> Send:
        return Send(bytes([_SEGMENT | self._toggle]).ljust(8, b"\0"), ANSWER)

    def _on_segment(self, frame: bytes) -> list[Effect]:
        """Handles at most seven more bytes, and whether they are the last."""
        part, last = frame[1 : 8 - (frame[0] >> 1 & 7)], frame[0] & _LAST
        self._data += part
        if len(self._data) > LONGEST:
            return self._refuse(NO_MEMORY, f"received more than {LONGEST} bytes")
        if not (part or last):
            return self._refuse(WRONG_LENGTH, "received a segment without bytes")
        if not last:
            self._toggle ^= _TOGGLE
            return [self._next_segment()]
        if self._size and len(self._data) != self._size:
            return [self._finish(Failed(f"received {len(self._data)} bytes of {self._size}"))]
        return [self._finish(Done(self._data))]

    def _refuse(self, code: int, reason: str) -> list[Effect]:
        """Ends an invalid transfer; another attempt would be invalid too."""
        return [Send(abort(self._expected_key, code)), self._finish(Failed(reason))]

    def _finish(self, result: Result) -> Result:
        self._phase = _Phase.IDLE
        return result

    # -- missed answers ---------------------------------------------------------------------------------

    def _abandon(self, code: int) -> Send:
        """Aborts a transfer: a late answer must not be accepted; the server may discard the transfer."""
        self._unsynchronized[self._expected_key] = next(self._order)
        return Send(abort(self._expected_key, code))

    def _probe(self) -> Send:
        """Requests a synchronized object, else the one whose answer was missed first."""
        candidates = (key for key in PROBES if key != self._key)
        self._phase = _Phase.PROBING
        self._expected_key = min(candidates, key=lambda key: self._unsynchronized.get(key, -1))
        return Send(_frame(_UPLOAD, self._expected_key), ANSWER)

    def _on_probe(self, command: int) -> list[Effect]:
        """All earlier answers of the server have arrived, or are lost."""
        if command != ABORT and command & _KIND != _UPLOADED:
            return []
        self._unsynchronized.clear()
        return [self._send_request()]


def _frame(command: int, key: Key, data: bytes = b"") -> bytes:
    """A request or an abort: eight bytes."""
    return struct.pack("<BHB", command, *key) + data.ljust(4, b"\0")


def abort(key: Key, code: int) -> bytes:
    """The abort frame of the client: eight bytes."""
    return _frame(ABORT, key, code.to_bytes(4, "little"))
