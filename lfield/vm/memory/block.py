"""The block: the whole execution state of one agent as one run of bytes."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from lfield.vm.memory import layout
from lfield.vm.memory.layout import HEADER_WORDS, STRING, header
from lfield.vm.memory.space import SEPARATE, Buffer, Space

#: Words of a new block; it grows with use.
INITIAL_WORDS = 512
#: Words above the limit that only the machine uses, to say in an exception that the limit is reached.
RESERVE_WORDS = 256

_ZEROS = memoryview(bytes(8 * 4096)).cast("q")


class Full(Exception):
    """The heap has no room for `words` more; the machine collects and runs the instruction again."""

    def __init__(self, words: int) -> None:
        self.words = words
        super().__init__(words)


def template(kind: int, index: int, words: int) -> memoryview[int]:
    """The words of a new thing of that kind, for `Block.stamp`."""
    return memoryview(array("q", [header(kind, index, words), *[0] * (words - 1)]))


class Places(dict[int, int]):
    """Where the threads of a block are, by id; `ids` has these from the oldest on, which is their order."""

    __slots__ = ("ids",)

    def __init__(self, found: Iterable[tuple[int, int]] = ()) -> None:
        super().__init__(found)
        self.ids = list(self)


class Block:
    """A block in memory: its bytes, seen as ints (`w`) and as reals (`r`), from a `space` that has more.

    `top` is the first unused word, `end` the first one that may not be used, `limit` the most words the heap
    may have, `packed` where the top was when there was no garbage, 0 if never. The views belong to the bytes
    of the moment: whoever collects or grows a block must take them again. So do `places`, None until somebody
    looks for a thread (`lfield.vm.memory.threads`).
    """

    __slots__ = ("data", "end", "limit", "packed", "places", "r", "space", "top", "w")

    def __init__(self, data: Buffer, top: int, limit: int, space: Space = SEPARATE) -> None:
        self.limit, self.space, self.packed = limit, space, 0
        self.replace(data, top)

    @classmethod
    def empty(cls, digest: bytes, limit: int, space: Space = SEPARATE) -> Block:
        """A block with a header and nothing on its heap."""
        block = cls(space.room(8 * INITIAL_WORDS), HEADER_WORDS, limit, space)
        block.w[:HEADER_WORDS] = _ZEROS[:HEADER_WORDS]
        block.w[layout.W_MAGIC] = layout.MAGIC | layout.VERSION << 32
        block.data[8 * layout.W_PROGRAM : 8 * layout.W_PROGRAM + 32] = digest
        block.w[layout.W_NEXT_THREAD] = 1
        return block

    def replace(self, data: Buffer, top: int) -> None:
        """Let the block be these bytes from now on."""
        self.data = data
        self.top = top
        self.places: Places | None = None
        view = memoryview(data)
        self.w = view.cast("q")
        self.r = view.cast("d")
        self.end = min(len(self.w), self.limit)

    @property
    def heap(self) -> int:
        """The first word of the heap."""
        return layout.HEADERS.get(self.w[layout.W_MAGIC] >> 32, HEADER_WORDS)

    @property
    def interval(self) -> float:
        """The heartbeat interval of an agent's shadows in seconds, 0 for none (appendix I)."""
        return self.w[layout.W_INTERVAL] / 1000 if self.heap > layout.W_INTERVAL else 0.0

    @contextmanager
    def reserve(self) -> Iterator[None]:
        """Allow what is above the limit too, for as long as it takes to say that the limit is reached."""
        self.end = len(self.w)
        try:
            yield
        finally:
            self.end = min(len(self.w), self.limit)

    def image(self) -> memoryview:
        """The used bytes: what a hop sends, a shadow keeps and a dump holds."""
        self.w[layout.W_TOP] = self.top
        return memoryview(self.data)[: 8 * self.top]

    def require(self, words: int) -> None:
        """Raise Full unless there is room for so many words: for all that is written, before any of it is."""
        if self.top + words > self.end:
            raise Full(words)

    def lacking(self, start: int, full: Full) -> int:
        """How much room a work needs at least that has come so far, from where the top was when it began."""
        return self.top - start + full.words

    def allocate(self, kind: int, index: int, words: int) -> int:
        """Room for a thing of so many words, all 0 behind its header; raises Full."""
        place = self.top
        end = place + words
        if end > self.end:
            raise Full(words)
        w = self.w
        w[place] = header(kind, index, words)
        start = place + 1
        while end - start > 4096:
            w[start : start + 4096] = _ZEROS
            start += 4096
        w[start:end] = _ZEROS[: end - start]
        self.top = end
        return place

    def stamp(self, template: memoryview[int]) -> int:
        """A copy of a template on the heap: its header and zeros, written at once; raises Full."""
        place = self.top
        end = place + len(template)
        if end > self.end:
            raise Full(len(template))
        self.w[place:end] = template
        self.top = end
        return place

    def new_string(self, text: str) -> int:
        """A string on the heap; raises Full. Text that is no valid Unicode keeps its place as '?'."""
        raw = text.encode("utf-8", "replace")
        place = self.allocate(STRING, 0, 2 + (len(raw) + 7 >> 3))
        self.w[place + 1] = len(raw)
        start = 8 * (place + 2)
        self.data[start : start + len(raw)] = raw
        return place

    def string(self, place: int) -> str:
        """The text of a string on the heap."""
        start = 8 * (place + 2)
        return str(self.data[start : start + self.w[place + 1]], "utf-8")

    def text(self, place: int) -> str:
        """The text of a string on the heap, '' for null."""
        return self.string(place) if place else ""

    def trail(self) -> list[int]:
        """The last hosts, oldest first, as numbers from 0 in the order of the deployment."""
        hops = self.w[layout.W_HOPS]
        start = max(0, hops + 1 - layout.TRAIL_LENGTH)
        ring = (self.w[layout.W_TRAIL + i % layout.TRAIL_LENGTH] for i in range(start, hops + 1))
        return [number - 1 for number in ring if number]

    def visit(self, host: int) -> None:
        """Note the host (a number from 0) as the place of the current hop."""
        self.w[layout.W_TRAIL + self.w[layout.W_HOPS] % layout.TRAIL_LENGTH] = host + 1
