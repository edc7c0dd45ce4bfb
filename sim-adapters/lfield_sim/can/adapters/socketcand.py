"""The text protocol of socketcand, server side: bytes in, frames and bytes out. Pure.

Commands are `< word ... >`. The greeting is `< hi >`; `< open can0 >` and `< rawmode >` are each answered by
`< ok >`; then `< send ID LENGTH BYTE.. >` sends and `< frame ID SECONDS.MICROS DATA >` reports frames. An
identifier of 8 hexadecimal digits is extended. There are no remote and no FD frames.
"""

from __future__ import annotations

from lfield_sim.can.can_bus import EXTENDED_MASK, STANDARD_MASK, CanFrame

GREETING = b"< hi >"
OK = b"< ok >"
UNKNOWN = b"< error unknown command >"
#: Longer commands are invalid and discarded.
LONGEST = 256


class SocketcandProtocol:
    """One client. `channel` is the only bus; `raw` becomes true when the client requests frames."""

    def __init__(self, channel: str = "can0") -> None:
        self._channel = channel
        self._open = False
        self.raw = False

    def command(self, text: bytes) -> tuple[bytes, CanFrame | None]:
        """Executes the text between `<` and `>`: the answer and the frame to send."""
        fields = text.split()
        match fields:
            case [b"echo"]:
                return b"< echo >", None
            case [b"open", name] if not self._open:
                self._open = name.decode("ascii", "replace") == self._channel
                return (OK if self._open else b"< error could not open bus >"), None
            case [b"rawmode"] if self._open:
                self.raw = True
                return OK, None
            case [b"send", identifier, length, *data] if self.raw:
                return b"", _parse(identifier, length, data)
        return UNKNOWN, None

    @staticmethod
    def encode(frame: CanFrame, seconds: float) -> bytes:
        """A frame on the bus at a time of day; empty when the protocol does not support it."""
        micros = round(seconds * 1e6)
        stamp = f"{micros // 1_000_000}.{micros % 1_000_000:06d}"
        if frame.error:
            return f"< error {frame.identifier:03X} {stamp} >".encode()
        if frame.remote or frame.fd:
            return b""
        digits = 8 if frame.extended else 3
        return f"< frame {frame.identifier:0{digits}X} {stamp} {frame.data.hex().upper()} >".encode()


def next_command(buffer: bytearray) -> bytes | None:
    """Removes the next command from a client's input: the text between `<` and `>`; None if incomplete."""
    while True:
        end = buffer.find(b">")
        if end < 0:
            if len(buffer) > LONGEST:
                buffer.clear()
            return None
        message = bytes(buffer[:end])
        del buffer[: end + 1]
        start = message.rfind(b"<")
        if start >= 0 and end - start <= LONGEST:
            return message[start + 1 :]


def _parse(identifier: bytes, length: bytes, data: list[bytes]) -> CanFrame | None:
    """The frame of `send`; None for invalid input, which socketcand ignores."""
    try:
        number, count = int(identifier, 16), int(length, 16)
        payload = bytes(int(byte, 16) for byte in data)
    except ValueError:
        return None
    extended = len(identifier) == 8
    if not 0 <= number <= (EXTENDED_MASK if extended else STANDARD_MASK):
        return None
    if count != len(payload) or count > 8:
        return None
    return CanFrame(number, payload, extended=extended)
