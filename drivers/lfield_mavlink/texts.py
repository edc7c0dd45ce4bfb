"""STATUSTEXT: chunks joined, and the newest texts kept as reasons for refusals."""

from __future__ import annotations

from collections import deque

#: Characters of one message; a longer text comes in chunks with one id.
CHUNK = 50
#: Unfinished texts that are kept; a lost chunk must not cost memory for ever.
UNFINISHED = 8


class Texts:
    """The texts of one vehicle."""

    def __init__(self) -> None:
        self._chunks: dict[int, list[str]] = {}
        self._recent: deque[tuple[float, str]] = deque(maxlen=32)

    def add(self, text: str, text_id: int, sequence: int, now: float) -> str | None:
        """Take one message in; the whole text when this completes one."""
        if text_id == 0:
            return self._complete(text, now)
        if sequence == 0:
            self._chunks[text_id] = []
            while len(self._chunks) > UNFINISHED:
                del self._chunks[next(iter(self._chunks))]
        chunks = self._chunks.get(text_id)
        if chunks is None or len(chunks) != sequence:
            # A chunk is missing: what remains would be nonsense.
            self._chunks.pop(text_id, None)
            return None
        chunks.append(text)
        if len(text) == CHUNK:
            return None
        del self._chunks[text_id]
        return self._complete("".join(chunks), now)

    def since(self, start: float) -> list[str]:
        """The texts completed from `start` on."""
        return [text for at, text in self._recent if at >= start]

    def _complete(self, text: str, now: float) -> str:
        self._recent.append((now, text))
        return text
