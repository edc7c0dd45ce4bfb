"""Status texts as messages: long ones in chunks."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

#: Characters of a STATUSTEXT; longer texts go out in chunks, of which there are so many at most.
CHUNK, CHUNKS = 50, 256


class Texts:
    """Numbers the texts that need it."""

    def __init__(self) -> None:
        self._number = 0

    def messages(self, severity: int, text: str) -> list[Any]:
        """The STATUSTEXTs (253) of one text."""
        data = text.encode("ascii", "replace")
        if len(data) <= CHUNK:
            return [dialect.MAVLink_statustext_message(severity, data)]
        self._number = self._number % 0xFFFF + 1
        # A last chunk that is full would not end the text: an empty one must follow.
        chunks = [data[i : i + CHUNK] for i in range(0, len(data) + 1, CHUNK)]
        return [
            dialect.MAVLink_statustext_message(severity, chunk, self._number, place)
            for place, chunk in enumerate(chunks[:CHUNKS])
        ]
