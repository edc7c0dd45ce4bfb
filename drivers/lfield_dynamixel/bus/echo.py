"""The echo of an adapter that does not switch its receiver off while it sends. Pure.

Such an adapter gives back every byte that is sent, before the answers. In protocol 1.0 an instruction looks
like an answer: the ping of servo 1 is, byte for byte, its answer with a voltage error. So whether there is an
echo must be known before anybody is asked, and each echo is taken out by what was sent.
"""

from __future__ import annotations

from collections import deque

#: Packets whose echo may still come; a packet without answer does not wait for its own.
MOST_AWAITED = 8


class EchoFilter:
    """Takes the echoes of sent packets out of what comes in.

    An echo with a wrong byte is passed on: no checksum fits it, so it is noise for the reader.
    """

    def __init__(self) -> None:
        self._awaited: deque[bytes] = deque(maxlen=MOST_AWAITED)
        self._held = b""

    def on_sent(self, packet: bytes) -> None:
        """A packet leaves."""
        self._awaited.append(packet)

    def strip(self, data: bytes) -> bytes:
        """What of the incoming bytes is no echo; the beginning of one is held back until it is decided."""
        self._held += data
        passed = b""
        while self._awaited:
            echo = self._awaited[0]
            if (at := self._held.find(echo)) >= 0:
                # What stands before it is noise, or the rest of a damaged echo.
                passed += self._held[:at]
                self._held = self._held[at + len(echo) :]
            elif len(self._held) < len(echo):
                return passed
            self._awaited.popleft()
        passed, self._held = passed + self._held, b""
        return passed
