"""The client's side of SDO, one transfer at a time (CiA 301, 7.2.4). Pure: answers and waits in, frames out.

Uploads are expedited or in segments, downloads expedited: what is written here has at most four bytes. An
answer is taken only if it is about the object that was asked for, of the kind that was asked for, and for a
segment with its toggle bit. Everything else that comes is no answer, and the wait for one goes on.

Two answers about one object look alike, also when the first of them is late. A server answers in order. So an
object whose answer did not come is in *doubt*: before it is asked about again, the server is asked about
another one, the *probe*, be it only to say that there is no such object. Once that answer is here, older ones
cannot follow.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import count

#: Tries of one transfer, and seconds to wait for each answer.
TRIES, ANSWER = 3, 0.3
#: More bytes than this are no answer to anything that is asked here.
LONGEST = 64

#: Index and subindex of an object.
Key = tuple[int, int]

# The kinds of requests and of their answers: the upper three bits of the first byte.
_DOWNLOAD, _UPLOAD, _SEGMENT = 0x20, 0x40, 0x60
_UPLOADED, _DOWNLOADED, _GIVEN = 0x40, 0x60, 0x00
_KIND = 0xE0
#: The first byte of what ends a transfer, from either side; it has no answer.
ABORT = 0x80
# Other bits of the first byte.
_EXPEDITED, _SIZED, _TOGGLE, _LAST = 0x02, 0x01, 0x10, 0x01

#: Why we end a transfer (CiA 301, table 22): too late, too long, no length that it can have, not wanted.
TIMED_OUT, NO_MEMORY, WRONG_LENGTH, NOT_WANTED = 0x05040000, 0x05040005, 0x06070010, 0x08000000

#: Probes: the identity of the node, which it must have (CiA 301, 7.5.2.19), with subindexes that it need not
#: have. So many of them, that no answer is late enough to be taken for that to a later probe of the same one.
PROBES: Sequence[Key] = [(0x1018, subindex) for subindex in range(16)]


@dataclass(frozen=True, slots=True)
class Send:
    """A frame for the server; `within` so many seconds an answer is awaited, None for no answer at all."""

    data: bytes
    within: float | None = None


@dataclass(frozen=True, slots=True)
class Done:
    """The transfer is over; `data` of an upload."""

    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Refused:
    """The server has ended it, with an abort code of CiA 301, table 22."""

    code: int


@dataclass(frozen=True, slots=True)
class Failed:
    """There is no answer that could be used. `silent`: none came in time."""

    why: str
    silent: bool = False


Result = Done | Refused | Failed
Effect = Send | Result


class _Phase(Enum):
    IDLE = auto()
    PROBING = auto()
    BEGUN = auto()
    SEGMENTS = auto()


class SdoClient:
    """The transfers with one server. Every method returns what is to be done, in this order.

    `upload` and `download` begin one, when none is under way; a result ends it.
    """

    def __init__(self) -> None:
        self._phase = _Phase.IDLE
        self._key: Key = (0, 0)
        self._request = b""
        #: What the answer is to be about: the object, or a probe.
        self._asked: Key = (0, 0)
        self._left = self._toggle = 0
        self._data, self._size = b"", 0
        #: Objects in doubt, and when they were asked about last: the greater, the later.
        self._doubted: dict[Key, int] = {}
        self._order = count()

    # -- events -----------------------------------------------------------------------------------------

    def upload(self, key: Key) -> list[Effect]:
        """Read an object."""
        return self._begin(key, _frame(_UPLOAD, key))

    def download(self, key: Key, data: bytes) -> list[Effect]:
        """Write an object; 1 to 4 bytes."""
        assert 1 <= len(data) <= 4, "a number is written: nothing longer is, and nothing empty"
        command = _DOWNLOAD | (4 - len(data)) << 2 | _EXPEDITED | _SIZED
        return self._begin(key, _frame(command, key, data))

    def answered(self, frame: bytes) -> list[Effect]:
        """The server has said something, eight bytes of whatever value."""
        if self._phase is _Phase.IDLE or len(frame) != 8:
            return []
        if self._phase is _Phase.SEGMENTS and frame[0] & (_KIND | _TOGGLE) == _GIVEN | self._toggle:
            return self._on_segment(frame)
        command, index, subindex = struct.unpack_from("<BHB", frame)
        if (index, subindex) != self._asked:
            return []
        if self._phase is _Phase.PROBING:
            return self._on_probe(command)
        if command == ABORT:
            return [self._end(Refused(int.from_bytes(frame[4:], "little")))]
        if self._phase is not _Phase.BEGUN:
            return []
        uploads = self._request[0] & _KIND == _UPLOAD
        if uploads and command & _KIND == _UPLOADED:
            return self._on_upload(frame)
        if not uploads and command & _KIND == _DOWNLOADED:
            return [self._end(Done())]
        return []

    def expired(self) -> list[Effect]:
        """The answer did not come in time. The transfer begins anew, or has failed."""
        self._left -= 1
        given_up = self._given_up(TIMED_OUT)
        if not self._left:
            return [given_up, self._end(Failed(f"no answer within {ANSWER:g} s, {TRIES} times", silent=True))]
        return [given_up, self._probe() if self._phase is _Phase.PROBING else self._ask()]

    def cancelled(self) -> list[Effect]:
        """Nobody wants the result any more."""
        if self._phase is _Phase.IDLE:
            return []
        given_up = self._given_up(NOT_WANTED)
        self._phase = _Phase.IDLE
        return [given_up]

    # -- a transfer -------------------------------------------------------------------------------------

    def _begin(self, key: Key, request: bytes) -> list[Effect]:
        assert self._phase is _Phase.IDLE, "one transfer at a time"
        self._key, self._request, self._left = key, request, TRIES
        return [self._probe() if key in self._doubted else self._ask()]

    def _ask(self) -> Send:
        """Begin at the server. A late answer to an earlier try of this transfer is as good as one to this."""
        self._phase, self._asked = _Phase.BEGUN, self._key
        self._data, self._toggle = b"", 0
        return Send(self._request, ANSWER)

    def _on_upload(self, frame: bytes) -> list[Effect]:
        """An upload has begun: here is all of it, or how much there will be (0: the server does not say)."""
        command, value = frame[0], frame[4:]
        if command & _EXPEDITED:
            length = 4 - (command >> 2 & 3) if command & _SIZED else 4
            return [self._end(Done(value[:length]))]
        self._size = int.from_bytes(value, "little") if command & _SIZED else 0
        if self._size > LONGEST:
            return self._refuse(NO_MEMORY, f"{self._size} bytes came, more than {LONGEST}")
        self._phase = _Phase.SEGMENTS
        return [self._next_segment()]

    def _next_segment(self) -> Send:
        return Send(bytes([_SEGMENT | self._toggle]).ljust(8, b"\0"), ANSWER)

    def _on_segment(self, frame: bytes) -> list[Effect]:
        """At most seven bytes more, and whether they are the last."""
        part, last = frame[1 : 8 - (frame[0] >> 1 & 7)], frame[0] & _LAST
        self._data += part
        if len(self._data) > LONGEST:
            return self._refuse(NO_MEMORY, f"more than {LONGEST} bytes came")
        if not (part or last):
            return self._refuse(WRONG_LENGTH, "a segment without bytes came")
        if not last:
            self._toggle ^= _TOGGLE
            return [self._next_segment()]
        if self._size and len(self._data) != self._size:
            return [self._end(Failed(f"{len(self._data)} bytes came, and {self._size} were announced"))]
        return [self._end(Done(self._data))]

    def _refuse(self, code: int, why: str) -> list[Effect]:
        """End a transfer that makes no sense; another try would make none either."""
        return [Send(abort(self._asked, code)), self._end(Failed(why))]

    def _end(self, result: Result) -> Result:
        self._phase = _Phase.IDLE
        return result

    # -- doubt ------------------------------------------------------------------------------------------

    def _given_up(self, code: int) -> Send:
        """An answer that may still come must not be believed; the server may forget the transfer."""
        self._doubted[self._asked] = next(self._order)
        return Send(abort(self._asked, code))

    def _probe(self) -> Send:
        """Ask about an object that is in no doubt itself, or else about the one in doubt for longest."""
        candidates = (key for key in PROBES if key != self._key)
        self._phase = _Phase.PROBING
        self._asked = min(candidates, key=lambda key: self._doubted.get(key, -1))
        return Send(_frame(_UPLOAD, self._asked), ANSWER)

    def _on_probe(self, command: int) -> list[Effect]:
        """Whatever the server has said before is here, or lost."""
        if command != ABORT and command & _KIND != _UPLOADED:
            return []
        self._doubted.clear()
        return [self._ask()]


def _frame(command: int, key: Key, data: bytes = b"") -> bytes:
    """A request or an abort: eight bytes."""
    return struct.pack("<BHB", command, *key) + data.ljust(4, b"\0")


def abort(key: Key, code: int) -> bytes:
    """The frame that ends a transfer, from the client's side: eight bytes."""
    return _frame(ABORT, key, code.to_bytes(4, "little"))
