"""Signing key and timestamps that are never reused, not even after a crash.

A vehicle refuses a packet that is not newer than the last one of its stream, so the timestamp must survive
this process. It is stored in a file beside the key, written ahead of use: a crash skips a few seconds of
timestamps. All links and processes with the same key share the file.

https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from lfield.driver import Clock, DeviceError, read_within

#: Timestamps count units of 10 us since 1 January 2015.
PER_SECOND, EPOCH = 100_000, 1_420_070_400
#: The time ahead of use to which the timestamp is written, and the reserve that triggers the next write.
AHEAD, LOW = 20 * PER_SECOND, 10 * PER_SECOND
#: Bytes of a key.
KEY = 32
#: A timestamp has 48 bits.
LAST = (1 << 48) - 1


def load_key(path: Path) -> bytes:
    """The key in a file: 32 bytes, or 64 hexadecimal digits. Raises DeviceError.

    A file readable by others is refused: the key gives control of the vehicle.
    """
    try:
        data = read_within(path, 4 * KEY)
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _error(f"the signing key {path} cannot be read: {reason}") from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise _error(f"the signing key {path} is open to others; run: chmod 600 {path}")
    key = data if len(data) == KEY else _from_hex(data)
    if len(key) != KEY or not any(key):
        raise _error(
            f"{path} contains no signing key: {KEY} bytes, or {2 * KEY} hexadecimal digits, not all 0"
        )
    return key


class SigningTimestamps:
    """Increasing timestamps of one key. `open`, `extend` and `close` access the file and may block."""

    def __init__(self, key_path: Path, clock: Clock) -> None:
        self._key_path, self._clock = key_path, clock
        self._path = key_path.with_name(key_path.name + ".timestamp")
        self._last = self._written = self._start = 0
        self._opened = 0.0

    def open(self) -> None:
        """Continues after the last process with this key. Raises DeviceError."""
        wall = int((self._clock.time() - EPOCH) * PER_SECOND)
        with self._locked():
            self._start = self._last = max(wall, self._read(), 0)
            self._write(self._last + AHEAD)
        self._opened = self._clock.monotonic()

    def next(self) -> int:
        """The next timestamp, later than every one before."""
        self._last = max(self._last + 1, min(self.due, self._written))
        return self._last

    def on_timestamp(self, timestamp: int) -> None:
        """Handles a `timestamp` of a peer with the key: ours must not be older."""
        self._start += max(timestamp - self.due, 0)

    @property
    def latest(self) -> int:
        """The last timestamp."""
        return self._last

    @property
    def is_low(self) -> bool:
        """Whether `extend` must be called."""
        return self._written - max(self.due, self._last) < LOW

    def extend(self, due: int) -> None:
        """Writes further ahead of `due`; callable from any thread, so it reads no clock. Raises
        DeviceError.
        """
        with self._locked():
            self._write(max(due, self._last, self._read()) + AHEAD)

    @property
    def due(self) -> int:
        """The timestamp of now, by the monotonic clock: setting the wall clock must not affect it."""
        return self._start + int((self._clock.monotonic() - self._opened) * PER_SECOND)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Exclusive access among the processes with this key. Raises DeviceError."""
        try:
            with self._key_path.open("rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                yield
        except OSError as error:
            raise _error(
                f"the timestamp of the signing key cannot be stored in {self._path}: {error}"
            ) from None

    def _read(self) -> int:
        """The last written value; 0 without one."""
        try:
            text = read_within(self._path, 64)
        except FileNotFoundError:
            return 0
        number = text.strip()
        if not number.isdigit() or int(number) > LAST:
            raise _error(
                f"{self._path} contains no timestamp; remove it if this computer's clock is right, otherwise "
                "the vehicle refuses every packet as old"
            )
        return int(number)

    def _write(self, timestamp: int) -> None:
        """Replaces the file atomically, on the disk before it is used."""
        new_file = self._path.with_name(self._path.name + ".new")
        with new_file.open("wb") as file:
            file.write(b"%d\n" % timestamp)
            file.flush()
            os.fsync(file.fileno())
        new_file.replace(self._path)
        self._written = timestamp


def _from_hex(data: bytes) -> bytes:
    try:
        return bytes.fromhex(data.decode("ascii"))
    except ValueError:
        return b""


def _error(reason: str) -> DeviceError:
    return DeviceError("signing_key", reason)
