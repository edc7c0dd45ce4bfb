"""A decoder for a fuzzer: any bytes give a value or an lfield error, in bounded time and memory.

An input is limited in CPU time, which does not depend on other programs, and in allocated memory.
Exceeding a limit is a crash, as is every exception that is not an lfield error.
"""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

#: Limits of one input: CPU seconds and allocated bytes.
SECONDS, BYTES = 5.0, 64 << 20
#: The length limit of mutations.
LONGEST = 1 << 16


@dataclass(frozen=True)
class Target:
    """One decoder: `seeds` gives valid inputs; `decode` decodes an input and must not raise for any input.

    `tokens` are valid names for mutations. If `packed`, the inputs are msgpack and mutated as such.
    """

    name: str
    seeds: Callable[[], Sequence[bytes]]
    decode: Callable[[bytes], None]
    packed: bool = False
    tokens: Sequence[object] = field(default=())
    #: A slow target decodes only one of this many inputs.
    share: int = 1

    @cached_property
    def good(self) -> Sequence[bytes]:
        """The seeds, created once."""
        return self.seeds()


class Hang(BaseException):
    """An input exceeded its CPU time. No handler of exceptions catches it."""


@contextmanager
def bounded(seconds: float = SECONDS) -> Iterator[None]:
    """Raise Hang when the block exceeds this CPU time in seconds."""

    def over(number: int, frame: object) -> None:
        raise Hang(f"over {seconds:g} s of the processor")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def peak_of(target: Target, data: bytes) -> int:
    """Peak bytes of Python's allocator while an input is decoded."""
    tracemalloc.start()
    try:
        target.decode(data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
