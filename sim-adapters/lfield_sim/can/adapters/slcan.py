r"""The serial line protocol of a CANable adapter: bytes in, frames and bytes out. Pure.

Commands end with \r and are answered by \r, or \a on an error: S0..S8 bit rate, s.. timing registers, Y2 and
Y5 data bit rate, O open, L listen only, C close, M and m filters (accepted, without effect), V version, N
serial number, F status flags; t T r R frames, d D FD frames, b B FD frames with bit rate switch, answered by
z\r (11-bit identifiers) or Z\r (29-bit identifiers).
"""

from __future__ import annotations

from collections.abc import Callable

from lfield_sim.can.can_bus import (
    BUS_OFF,
    EXTENDED_MASK,
    FD_LENGTHS,
    PASSIVE,
    STANDARD_MASK,
    WARNING,
    CanFrame,
)

OK, BAD = b"\r", b"\a"
#: The longest command is an FD frame of 64 bytes.
LONGEST = 1 + 8 + 1 + 128
BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000, 83_300)
DATA_BITRATES = (b"2", b"5")

#: Letter -> extended, remote, fd, bit rate switch.
_LETTERS: dict[str, tuple[bool, bool, bool, bool]] = {
    "t": (False, False, False, False),
    "T": (True, False, False, False),
    "r": (False, True, False, False),
    "R": (True, True, False, False),
    "d": (False, False, True, False),
    "D": (True, False, True, False),
    "b": (False, False, True, True),
    "B": (True, False, True, True),
}
_LETTER = {flags: letter for letter, flags in _LETTERS.items()}
_HEX = frozenset(b"0123456789abcdefABCDEF")


class SlcanProtocol:
    """One adapter. `bitrate` is 0 until it is set: that of the bus. `errors` returns its transmit errors."""

    def __init__(self, errors: Callable[[], int] = lambda: 0) -> None:
        self._errors = errors
        self.opened = False
        self._listening = False
        self.bitrate = 0

    def command(self, text: bytes) -> tuple[bytes, CanFrame | None]:
        """Executes a command (without its end): the answer and the frame to send."""
        letter, argument = chr(text[0]) if text else "", text[1:]
        if not letter:
            return b"", None
        if letter in _LETTERS:
            return self._transmit(letter, argument)
        setting = self._settings.get(letter)
        return (setting(self, argument) if setting else BAD), None

    @staticmethod
    def encode(frame: CanFrame) -> bytes:
        """A received frame; error frames are omitted (F reports errors)."""
        if frame.error:
            return b""
        letter = _LETTER[frame.extended, frame.remote, frame.fd, frame.switch]
        digits = 8 if frame.extended else 3
        code = frame.dlc if frame.remote else FD_LENGTHS.index(len(frame.data))
        return f"{letter}{frame.identifier:0{digits}X}{code:X}{frame.data.hex().upper()}\r".encode()

    def _transmit(self, letter: str, argument: bytes) -> tuple[bytes, CanFrame | None]:
        frame = _parse(letter, argument)
        if frame is None or not self.opened or self._listening:
            return BAD, None
        return (b"Z\r" if frame.extended else b"z\r"), frame

    def _open(self, argument: bytes) -> bytes:
        return self._start(argument, listening=False)

    def _listen(self, argument: bytes) -> bytes:
        return self._start(argument, listening=True)

    def _start(self, argument: bytes, *, listening: bool) -> bytes:
        if argument or self.opened:
            return BAD
        self.opened, self._listening = True, listening
        return OK

    def _close(self, argument: bytes) -> bytes:
        if argument or not self.opened:
            return BAD
        self.opened = False
        return OK

    def _set_bitrate(self, argument: bytes) -> bytes:
        if self.opened or len(argument) != 1 or not argument.isdigit():
            return BAD
        self.bitrate = BITRATES[int(argument)]
        return OK

    def _set_registers(self, argument: bytes) -> bytes:
        return BAD if self.opened or len(argument) != 4 or not _HEX.issuperset(argument) else OK

    def _set_data_bitrate(self, argument: bytes) -> bytes:
        return BAD if self.opened or argument not in DATA_BITRATES else OK

    def _set_filter(self, argument: bytes) -> bytes:
        return BAD if self.opened or len(argument) != 8 or not _HEX.issuperset(argument) else OK

    def _version(self, argument: bytes) -> bytes:
        return BAD if argument else b"V1013\r"

    def _serial(self, argument: bytes) -> bytes:
        return BAD if argument else b"NF4K3\r"

    def _flags(self, argument: bytes) -> bytes:
        """LAWICEL's status byte: bit 2 error warning, bit 5 error passive, bit 7 bus error."""
        if argument or not self.opened:
            return BAD
        count = self._errors()
        flags = 0x04 * (count >= WARNING) | 0x20 * (count >= PASSIVE) | 0x80 * (count >= BUS_OFF)
        return f"F{flags:02X}\r".encode()

    _settings: dict[str, Callable[[SlcanProtocol, bytes], bytes]] = {
        "O": _open,
        "L": _listen,
        "C": _close,
        "S": _set_bitrate,
        "s": _set_registers,
        "Y": _set_data_bitrate,
        "M": _set_filter,
        "m": _set_filter,
        "V": _version,
        "N": _serial,
        "F": _flags,
    }


def next_command(buffer: bytearray) -> bytes | None:
    r"""Removes the next command from a client's input, without its \r; None if incomplete."""
    while True:
        end = buffer.find(b"\r")
        if end < 0:
            if len(buffer) > LONGEST:
                buffer.clear()
            return None
        command = bytes(buffer[:end])
        del buffer[: end + 1]
        if end <= LONGEST:
            return command


def _parse(letter: str, argument: bytes) -> CanFrame | None:
    """The frame of a send command, or None."""
    extended, remote, fd, switch = _LETTERS[letter]
    digits = 8 if extended else 3
    if len(argument) <= digits or not _HEX.issuperset(argument):
        return None
    identifier, code = int(argument[:digits], 16), int(argument[digits : digits + 1], 16)
    if identifier > (EXTENDED_MASK if extended else STANDARD_MASK) or (code > 8 and not fd):
        return None
    data = argument[digits + 1 :]
    if len(data) != (0 if remote else 2 * FD_LENGTHS[code]):
        return None
    payload = bytes.fromhex(data.decode())
    return CanFrame(identifier, payload, extended, remote, code if remote else 0, fd, switch)
