"""What a decoder is to a fuzzer: bytes go in, and only its own errors come out, soon and without much memory.

An input is bounded by the processor's time that it takes, which no other program makes longer, and by what it
allocates. More of either is a crash, as is every exception that is no sentence of ours.
"""

from __future__ import annotations

import signal
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

#: Seconds of the processor that one input may take, and bytes that it may take at once.
SECONDS, BYTES = 5.0, 64 << 20
#: Longer inputs are made by no mutation.
LONGEST = 1 << 16


@dataclass(frozen=True)
class Target:
    """One decoder: `seeds` gives good inputs, `decode` decodes one, and raises nothing whatever it is.

    `tokens` are names that mean something to it. Where `packed`, its inputs are msgpack and changed as such.
    """

    name: str
    seeds: Callable[[], Sequence[bytes]]
    decode: Callable[[bytes], None]
    packed: bool = False
    tokens: Sequence[object] = field(default=())
    #: One that plays whole stories takes every so manieth input only.
    share: int = 1

    @cached_property
    def good(self) -> Sequence[bytes]:
        """The seeds, made once."""
        return self.seeds()


class Hang(BaseException):
    """An input took too much time. Nothing that catches exceptions takes it for one of its own."""


@contextmanager
def bounded(seconds: float = SECONDS) -> Iterator[None]:
    """Raises Hang in whatever takes longer, in seconds of the processor."""

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
