"""What one agent may use. Every limit ends in a `LimitException` that L code can catch."""

from __future__ import annotations

from dataclasses import dataclass

#: A heap is addressed by 32-bit offsets; below a page not even an empty agent fits.
MIN_HEAP, MAX_HEAP = 1 << 12, 1 << 31


@dataclass(frozen=True, slots=True)
class Limits:
    """`heap` in bytes; `call_depth` in calls; lengths in elements and characters; `threads` at one time."""

    heap: int = 1 << 20
    call_depth: int = 1000
    array_length: int = 1 << 20
    string_length: int = 1 << 20
    threads: int = 64
