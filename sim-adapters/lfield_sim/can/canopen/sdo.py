"""An object dictionary and its SDO server (CiA 301, 7.2.4 and 7.4)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from msgspec import Struct

Key = tuple[int, int]

#: Abort codes (CiA 301, table 22).
TOGGLE, COMMAND = 0x05030000, 0x05040001
WRITE_ONLY, READ_ONLY = 0x06010001, 0x06010002
NO_OBJECT, NO_SUBINDEX = 0x06020000, 0x06090011
NOT_MAPPABLE, PDO_LENGTH = 0x06040041, 0x06040042
TOO_LONG, TOO_SHORT = 0x06070012, 0x06070013
TOO_HIGH, TOO_LOW = 0x06090031, 0x06090032
RANGE, STATE = 0x06090030, 0x08000022

#: Type -> length in bytes and whether it is signed; text has neither.
TYPES: Mapping[str, tuple[int, bool]] = {
    "u8": (1, False),
    "i8": (1, True),
    "u16": (2, False),
    "i16": (2, True),
    "u32": (4, False),
    "i32": (4, True),
}
#: Maximum bytes of a segmented download.
LONGEST_DOWNLOAD = 64


class SdoAbort(Exception):
    """A refused access, with its abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code


class ObjectEntry(Struct, frozen=True):
    """One object: type, access (ro, rw, wo), reset value, range of writes, PDO or not."""

    type: str
    access: str
    default: int | str = 0
    low: int | None = None
    high: int | None = None
    mappable: bool = False
    choices: tuple[int, ...] = ()


class ObjectDictionary:
    """Entries with their values. `guard` may refuse a write, `watch` is called after it."""

    def __init__(self, entries: Mapping[Key, ObjectEntry]) -> None:
        self.entries = entries
        self._indexes = {index for index, _ in entries}
        self._values: dict[Key, int | str] = {}
        self._guards: list[Callable[[Key, int], None]] = []
        self._watchers: list[Callable[[Key, int], None]] = []
        self.reset()

    def reset(self) -> None:
        """Sets all power-up values."""
        self._values = {key: entry.default for key, entry in self.entries.items()}

    def guard(self, check: Callable[[Key, int], None]) -> None:
        """Calls `check` before every write; it raises SdoAbort to refuse."""
        self._guards.append(check)

    def watch(self, on_write: Callable[[Key, int], None]) -> None:
        """Calls `on_write` after every write from the bus."""
        self._watchers.append(on_write)

    def get(self, index: int, subindex: int = 0) -> int:
        """The number in an object."""
        value = self._values[index, subindex]
        assert isinstance(value, int)
        return value

    def put(self, index: int, value: float, subindex: int = 0) -> None:
        """Sets a number internally, saturated to its type."""
        length, signed = TYPES[self.entries[index, subindex].type]
        low, high = _bounds(length, signed)
        self._values[index, subindex] = max(low, min(high, round(value)))

    def read(self, key: Key) -> bytes:
        """The bytes of an object, for the bus. Raises SdoAbort."""
        entry = self._entry(key)
        if entry.access == "wo":
            raise SdoAbort(WRITE_ONLY)
        return self.encoded(key)

    def encoded(self, key: Key) -> bytes:
        """The bytes of a known object."""
        value, entry = self._values[key], self.entries[key]
        if isinstance(value, str):
            return value.encode()
        length, signed = TYPES[entry.type]
        return value.to_bytes(length, "little", signed=signed)

    def write(self, key: Key, data: bytes) -> None:
        """Sets an object from the bus. Raises SdoAbort."""
        value = self.check(key, data)
        self._values[key] = value
        for watcher in self._watchers:
            watcher(key, value)

    def write_all(self, writes: Mapping[Key, bytes]) -> None:
        """Sets the values of a PDO before any callback; refused ones are skipped."""
        accepted: dict[Key, int] = {}
        for key, data in writes.items():
            try:
                accepted[key] = self.check(key, data)
            except SdoAbort:
                continue
        self._values.update(accepted)
        for key, value in accepted.items():
            for watcher in self._watchers:
                watcher(key, value)

    def check(self, key: Key, data: bytes) -> int:
        """The number of a write. Raises SdoAbort when the object refuses it."""
        length = self.check_writable(key)
        entry = self.entries[key]
        if len(data) != length:
            raise SdoAbort(TOO_LONG if len(data) > length else TOO_SHORT)
        value = int.from_bytes(data, "little", signed=TYPES[entry.type][1])
        if entry.choices and value not in entry.choices:
            raise SdoAbort(RANGE)
        if entry.high is not None and value > entry.high:
            raise SdoAbort(TOO_HIGH)
        if entry.low is not None and value < entry.low:
            raise SdoAbort(TOO_LOW)
        for check in self._guards:
            check(key, value)
        return value

    def check_writable(self, key: Key) -> int:
        """The length in bytes of a writable object. Raises SdoAbort for others."""
        entry = self._entry(key)
        if entry.access == "ro":
            raise SdoAbort(READ_ONLY)
        return TYPES[entry.type][0]

    def _entry(self, key: Key) -> ObjectEntry:
        entry = self.entries.get(key)
        if entry is None:
            raise SdoAbort(NO_SUBINDEX if key[0] in self._indexes else NO_OBJECT)
        return entry


def _bounds(length: int, signed: bool) -> tuple[int, int]:
    bits = 8 * length
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)


class SdoServer:
    """Answers requests, expedited and segmented; block transfers are refused."""

    def __init__(self, objects: ObjectDictionary) -> None:
        self._objects = objects
        self._key: Key = (0, 0)
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """The answer to a request; None for an abort, or not 8 bytes."""
        if len(request) != 8 or request[0] >> 5 == 4:
            self._upload = self._download = None
            return None
        try:
            return self._answer(request).ljust(8, b"\0")
        except SdoAbort as abort:
            self._upload = self._download = None
            index, subindex = self._key
            return struct.pack("<BHBL", 0x80, index, subindex, abort.code)

    def _answer(self, request: bytes) -> bytes:
        kind = request[0] >> 5
        if kind == 0:
            return self._on_segment(request)
        if kind == 3:
            return self._next_segment(request)
        index, subindex = struct.unpack_from("<HB", request, 1)
        self._key = (index, subindex)
        self._upload = self._download = None
        self._toggle = 0
        if kind == 1:
            return self._start_download(request)
        if kind == 2:
            return self._start_upload(request)
        raise SdoAbort(COMMAND)

    def _start_upload(self, request: bytes) -> bytes:
        data, head = self._objects.read(self._key), request[1:4]
        if 0 < len(data) <= 4:
            return bytes([0x43 | (4 - len(data)) << 2]) + head + data
        self._upload = data
        return b"\x41" + head + struct.pack("<L", len(data))

    def _next_segment(self, request: bytes) -> bytes:
        if self._upload is None:
            raise SdoAbort(COMMAND)
        self._check_toggle(request)
        segment, remaining = self._upload[:7], self._upload[7:]
        head = (request[0] & 0x10) | (7 - len(segment)) << 1 | (not remaining)
        self._upload = remaining or None
        return bytes([head]) + segment

    def _start_download(self, request: bytes) -> bytes:
        expedited, sized = request[0] & 2, request[0] & 1
        if expedited:
            length = 4 - (request[0] >> 2 & 3) if sized else self._objects.check_writable(self._key)
            self._objects.write(self._key, request[4 : 4 + length])
        else:
            self._objects.check_writable(self._key)
            self._download = bytearray()
        return b"\x60" + request[1:4]

    def _on_segment(self, request: bytes) -> bytes:
        if self._download is None:
            raise SdoAbort(COMMAND)
        self._check_toggle(request)
        self._download += request[1 : 8 - (request[0] >> 1 & 7)]
        if len(self._download) > LONGEST_DOWNLOAD:
            raise SdoAbort(TOO_LONG)
        if request[0] & 1:
            data, self._download = bytes(self._download), None
            self._objects.write(self._key, data)
        return bytes([0x20 | request[0] & 0x10])

    def _check_toggle(self, request: bytes) -> None:
        if request[0] & 0x10 != self._toggle:
            raise SdoAbort(TOGGLE)
        self._toggle ^= 0x10
