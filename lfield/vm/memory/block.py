"""The block: the execution state of one agent in contiguous bytes."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from contextlib import contextmanager

from lfield.vm.memory import layout
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator, Buffer
from lfield.vm.memory.layout import (
    ARRAY,
    GROWABLE,
    GROWABLE_ARRAY,
    GROWABLE_LENGTH,
    GROWABLE_WORDS,
    HEADER_WORDS,
    STRING,
    elements,
    header,
)

#: Words of a new block; it grows with use.
INITIAL_WORDS = 512
#: Words above the limit, reserved for the exception that reports the limit.
RESERVE_WORDS = 256
#: The minimum number of elements by which a full array grows.
LEAST_GROWTH = 4

_ZEROS = memoryview(bytes(8 * 4096)).cast("q")


class HeapFull(Exception):
    """The heap lacks `words` words; the machine collects and repeats the instruction."""

    def __init__(self, words: int) -> None:
        self.words = words
        super().__init__(words)


def template(kind: int, index: int, words: int) -> memoryview[int]:
    """The words of a new object of that kind, for `Block.place_template`."""
    return memoryview(array("q", [header(kind, index, words), *[0] * (words - 1)]))


class ThreadPlaces(dict[int, int]):
    """The places of the threads of a block by id; `ids` are in the order of creation."""

    __slots__ = ("ids",)

    ids: list[int]


class Block:
    """A block in memory: its bytes as ints (`w`) and as reals (`r`), allocated from `space`.

    `top` is the first unused word, `end` the first word out of bounds, `limit` the maximum words of the heap,
    `packed` the top when there was no garbage (0: never). The views belong to the present bytes: after a
    collection or growth they must be read again. The same applies to `places`, None until first used
    (`lfield.vm.memory.threads`).
    """

    __slots__ = ("data", "end", "limit", "packed", "places", "r", "space", "top", "w")

    def __init__(
        self, data: Buffer, top: int, limit: int, space: BlockAllocator = HEAP_ALLOCATOR, *, packed: int = 0
    ) -> None:
        self.limit, self.space, self.packed = limit, space, packed
        self.data, self.top = data, top
        self.places: ThreadPlaces | None = None
        view = memoryview(data)
        self.w, self.r = view.cast("q"), view.cast("d")
        self.end = min(len(self.w), limit)

    @classmethod
    def empty(cls, digest: bytes, limit: int, space: BlockAllocator = HEAP_ALLOCATOR) -> Block:
        """A block with a header and an empty heap."""
        block = cls(space.allocate(8 * INITIAL_WORDS), HEADER_WORDS, limit, space)
        block.w[:HEADER_WORDS] = _ZEROS[:HEADER_WORDS]
        block.w[layout.W_MAGIC] = layout.MAGIC | layout.VERSION << 32
        block.data[8 * layout.W_PROGRAM : 8 * layout.W_PROGRAM + 32] = digest
        block.w[layout.W_NEXT_THREAD] = 1
        return block

    def replace(self, data: Buffer, top: int) -> None:
        """Replace the bytes of the block by compacted ones."""
        self.data, self.top, self.packed, self.places = data, top, top, None
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
    def use_reserve(self) -> Iterator[None]:
        """Permit words above the limit, for the exception that reports the limit."""
        self.end = len(self.w)
        try:
            yield
        finally:
            self.end = min(len(self.w), self.limit)

    def image(self) -> memoryview:
        """The used bytes: the content of a transfer, a shadow and a dump."""
        self.w[layout.W_TOP] = self.top
        return memoryview(self.data)[: 8 * self.top]

    def set_top(self, top: int) -> None:
        """Set the first unused word, after writes above the old top or a release below it."""
        self.top = top

    def index_threads(self) -> ThreadPlaces:
        """The places of the threads, indexed again after the heap has moved."""
        places = self.places
        if places is None:
            w = self.w
            place, youngest_first = w[layout.W_THREADS], []
            while place:
                youngest_first.append((w[place + layout.THREAD_ID], place))
                place = w[place + layout.THREAD_NEXT]
            places = self.places = ThreadPlaces(reversed(youngest_first))
            places.ids = list(places)
        return places

    def require(self, words: int) -> None:
        """Raise HeapFull unless `words` words are free; called before the first write."""
        if self.top + words > self.end:
            raise HeapFull(words)

    def missing_words(self, start: int, full: HeapFull) -> int:
        """The minimum free words for an operation that has written up to the present top, from the top at its
        start.
        """
        return self.top - start + full.words

    def allocate(self, kind: int, index: int, words: int) -> int:
        """A new object of `words` words, zero except its header. Raises HeapFull."""
        place = self.top
        end = place + words
        if end > self.end:
            raise HeapFull(words)
        w = self.w
        w[place] = header(kind, index, words)
        start = place + 1
        while end - start > 4096:
            w[start : start + 4096] = _ZEROS
            start += 4096
        w[start:end] = _ZEROS[: end - start]
        self.top = end
        return place

    def place_template(self, template: memoryview[int]) -> int:
        """A copy of a template on the heap. Raises HeapFull."""
        place = self.top
        end = place + len(template)
        if end > self.end:
            raise HeapFull(len(template))
        self.w[place:end] = template
        self.top = end
        return place

    def new_thread(self, template: memoryview[int], words: list[int], call: int) -> int:
        """A ready thread from a template (`threads.thread_template`), with arguments (the object first);
        returns its id.

        Raises HeapFull before any write.
        """
        frame = self.place_template(template)
        w = self.w
        slot = frame + layout.FRAME_SLOTS
        for word in words:
            w[slot] = word
            slot += 1
        place = frame + (w[frame] >> 32)
        identity: int = w[layout.W_NEXT_THREAD]
        w[layout.W_NEXT_THREAD] = identity + 1
        w[place + layout.THREAD_ID] = identity
        w[place + layout.THREAD_FRAME] = frame
        w[place + layout.THREAD_CALL] = call
        w[place + layout.THREAD_NEXT] = w[layout.W_THREADS]
        w[layout.W_THREADS] = place
        if (places := self.places) is not None:
            places[identity] = place
            places.ids.append(identity)
        return identity

    def new_array(self, kind: int, plain: int, length: int) -> int:
        """A new array of a type (by index) with `length` elements, all 0. Raises HeapFull before any write.

        `plain` is the type of the ARRAY with its elements. If `kind` is another type, the array may grow: it
        has its length and a reference to an ARRAY, whose size is the capacity.
        """
        if plain == kind:
            return self.allocate(ARRAY, kind, 1 + length)
        self.require(GROWABLE_WORDS + 1 + length)
        place = self.allocate(GROWABLE, kind, GROWABLE_WORDS)
        self.w[place + GROWABLE_LENGTH] = length
        self.w[place + GROWABLE_ARRAY] = self.allocate(ARRAY, plain, 1 + length)
        return place

    def insert_element(self, place: int, at: int, word: int, maximum: int) -> None:
        """Insert an element into a growable array, before the element at an index, which is at most the
        length.

        If the array is full, its elements move to an ARRAY with half as many more, at most `maximum`: an
        insertion at the end takes a constant time on average. Raises HeapFull before any write.
        """
        w = self.w
        array, length = w[place + GROWABLE_ARRAY], w[place + GROWABLE_LENGTH]
        if length + 1 >= w[array] >> 32:
            capacity = min(length + (length >> 1) + LEAST_GROWTH, maximum)
            larger = self.allocate(ARRAY, w[array] >> 8 & 0xFFFFFF, 1 + capacity)
            w[larger + 1 : larger + 1 + length] = w[array + 1 : array + 1 + length]
            w[place + GROWABLE_ARRAY] = array = larger
        first = array + 1
        if at < length:
            w[first + at + 1 : first + length + 1] = w[first + at : first + length]
        w[first + at] = word
        w[place + GROWABLE_LENGTH] = length + 1

    def remove_element(self, place: int, at: int) -> int:
        """Remove and return the element at a valid index of a growable array. Spare words are 0."""
        w = self.w
        first, end = elements(w, place)
        word = w[first + at]
        w[first + at : end - 1] = w[first + at + 1 : end]
        w[end - 1] = 0
        w[place + GROWABLE_LENGTH] -= 1
        return word

    def new_string(self, text: str) -> int:
        """A string on the heap; invalid Unicode becomes '?'. Raises HeapFull."""
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
        """The last hosts, oldest first, numbered from 0 in the order of the deployment."""
        hops = self.w[layout.W_HOPS]
        start = max(0, hops + 1 - layout.TRAIL_LENGTH)
        ring = (self.w[layout.W_TRAIL + i % layout.TRAIL_LENGTH] for i in range(start, hops + 1))
        return [number - 1 for number in ring if number]

    def append_trail(self, host: int) -> None:
        """Record the host (numbered from 0) of the current hop."""
        self.w[layout.W_TRAIL + self.w[layout.W_HOPS] % layout.TRAIL_LENGTH] = host + 1
