"""A decoder for a fuzzer: bytes go in, and only its own errors come out, in bounded time and memory.

An input is limited in CPU time, which other programs do not influence, and in allocated
memory. Exceeding a limit is a crash, as is every exception that is not an lfield error.
"""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

#: CPU seconds and allocated bytes of one input at most.
SECONDS, BYTES = 5.0, 64 << 20
#: No mutation makes longer inputs.
LONGEST = 1 << 16


@dataclass(frozen=True)
class Target:
    """One decoder: `seeds` gives valid inputs, `decode` decodes one, and must not raise for any input.

    `tokens` are names that it knows. If `packed`, its inputs are msgpack and mutated as such.
    """

    name: str
    seeds: Callable[[], Sequence[bytes]]
    decode: Callable[[bytes], None]
    packed: bool = False
    tokens: Sequence[object] = field(default=())
    #: A slow target takes only one of this many inputs.
    share: int = 1

    @cached_property
    def good(self) -> Sequence[bytes]:
        """The seeds, made once."""
        return self.seeds()


class Hang(BaseException):
    """An input exceeded its CPU time. No handler of exceptions catches it."""


@contextmanager
def bounded(seconds: float = SECONDS) -> Iterator[None]:
    """Raises Hang when the block exceeds this CPU time in seconds."""

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
    """Bytes that Python's allocator gave at once to decode an input."""
    tracemalloc.start()
    try:
        target.decode(data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
