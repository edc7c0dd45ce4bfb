"""Whether bytes from a peer are a sound block: checked before they run, so that the engine need not.

Everything on the heap is walked once: sizes must tile the block, every reference must lead to the start of
a thing of the type its slot or field has, frames must form one chain that stands at a portal call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.bytecode.program import RESERVED, MethodRecord, Program
from lfield.errors import BlockError
from lfield.vm.memory import layout
from lfield.vm.memory.block import INITIAL_WORDS, Block
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import (
    COUNT_LIMIT,
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    FRAME_SLOTS,
    HEADER_WORDS,
    OBJECT,
    PROXY_MEMBER,
    PROXY_START,
    THREAD,
    THREAD_CALL,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_NEXT,
    THREAD_PC,
    THREAD_STATE,
    TICKET_NUMBER,
    Layouts,
)
from lfield.vm.memory.parcels import WORD
from lfield.vm.memory.shapes import SENTINEL, Shapes, Stances
from lfield.vm.memory.space import SEPARATE, Buffer, Space
from lfield.vm.memory.tickets import check_ticket

STATES = len(layout.STATE_NAMES)
#: More migrations than any coordinator makes; so that counting them never leaves a word.
MOST_HOPS = 1 << 48
_MAGIC, _EARLIER_MAGIC, _OLD_MAGIC = (
    layout.MAGIC | version << 32 for version in (layout.VERSION, layout.EARLIER_VERSION, layout.OLD_VERSION)
)
#: The low half of no header.
_NOTHING = 0xFF
_WRONG = "wrong magic or version"
#: The bytes of a block before its top.
_BEFORE_TOP = 8 * layout.W_TOP


class Soundness:
    """The checks for blocks of one program; `members` are the types of the team's agents by number.

    A block that is sound has its bytes from `space`.
    """

    def __init__(
        self, program: Program, layouts: Layouts, members: Sequence[str], space: Space = SEPARATE
    ) -> None:
        self.program, self._layouts, self._space = program, layouts, space
        self.shapes = Shapes(program, layouts, members)
        self.stances = Stances(self.shapes)
        #: What a block of this program begins with.
        self._beginning = _MAGIC.to_bytes(8, "little") + program.digest
        #: The numbers of the resources.
        self._resources = {
            i
            for i, of in enumerate(self.shapes.members)
            if of >= 0 and program.core.classes[of].kind == "resource"
        }

    def check(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        """A travelling coordinator's block from its bytes (`limit` in words); raises BlockError."""
        size = len(image)
        if size <= 8 * limit and not size % 8 and image[:_BEFORE_TOP] == self._beginning:
            data = self._copied(image, limit)
            if self._space.travels(data, size // 8, self.stances):
                block = Block(data, size // 8, limit, self._space)
                block.packed = block.top
                return block
        # It is of an earlier version, or not sound, or nobody is sure.
        block = self._adopt(image, limit)
        if block.w[layout.W_MAGIC] not in (_MAGIC, _EARLIER_MAGIC):
            raise BlockError(_WRONG, word=layout.W_MAGIC)
        self._check_coordinator(block, self._things(block))
        if block.w[layout.W_MAGIC] == _EARLIER_MAGIC:
            # It is moved, and has the header of today afterwards.
            collect(block, self._layouts)
        block.packed = block.top
        return block

    def is_parcel(self, parcel: bytes, thrown: bool) -> bool:
        """Whether bytes are what a call gave, or what it has thrown (`lfield.vm.memory.parcels`)."""
        if len(parcel) == WORD:
            return not thrown
        try:
            block = self._adopt(parcel, len(parcel) // 8)
            if block.w[layout.W_MAGIC] != _MAGIC:
                return False
            starts = self._things(block)
        except BlockError:
            return False
        root = starts.get(block.w[layout.W_SELF], 0) & 0xFF
        return root == OBJECT or (not thrown and root in (layout.ARRAY, layout.STRING, layout.PROXY))

    def check_heap(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        """Any agent's block from its bytes, sound enough to be read; raises BlockError.

        Blocks of both versions before are read too: they only lack the last words of the header, and those
        of 0.3 the second one of a proxy.
        """
        block = self._adopt(image, limit)
        sizes = self.shapes.sizes
        if block.w[layout.W_MAGIC] == _OLD_MAGIC:
            sizes = {
                half: PROXY_START if half & 0xFF == layout.PROXY else size for half, size in sizes.items()
            }
        elif block.w[layout.W_MAGIC] not in (_MAGIC, _EARLIER_MAGIC):
            raise BlockError(_WRONG, word=layout.W_MAGIC)
        starts = self._walk(block, sizes)
        self._check_references(block, starts)
        self._check_threads(block, starts)
        return block

    def _check_threads(self, block: Block, starts: dict[int, int]) -> None:
        """The roots, and that every thread and every chain of frames ends."""
        w = block.w
        classes = self.program.core.classes
        if not 0 <= w[layout.W_CLASS] < len(classes):
            raise BlockError("its class is unknown", word=layout.W_CLASS)
        for word, half in ((layout.W_SELF, OBJECT | w[layout.W_CLASS] << 8), (layout.W_ID, layout.STRING)):
            if w[word] and starts.get(w[word]) != half:
                raise BlockError("its roots are not sound", word=word)
        seen: set[int] = set()
        thread = w[layout.W_THREADS]
        while thread:
            if starts.get(thread) != THREAD or thread in seen or not 0 <= w[thread + THREAD_STATE] < STATES:
                raise BlockError("its threads are no list", word=thread)
            seen.add(thread)
            self._check_chain(w, starts, w[thread + THREAD_FRAME])
            thread = w[thread + THREAD_NEXT]

    def _check_chain(self, w: memoryview[int], starts: dict[int, int], frame: int) -> None:
        depth = 0
        while frame:
            if starts.get(frame, 0) & 0xFF != FRAME or (depth and w[frame + FRAME_DEPTH] != depth - 1):
                raise BlockError("its frames are no chain", word=frame)
            depth = w[frame + FRAME_DEPTH]
            frame = w[frame + FRAME_CALLER]

    def _adopt(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        size = len(image)
        if size % 8 or size < 8 * layout.HEADERS[layout.OLD_VERSION]:
            raise BlockError(f"{size} bytes are no whole block")
        if size > 8 * limit:
            raise BlockError(f"{size} bytes are over the limit of {8 * limit}")
        block = Block(self._copied(image, limit), size // 8, limit, self._space)
        w, heap = block.w, block.heap
        if image[8 * layout.W_PROGRAM : 8 * layout.W_PROGRAM + 32] != self.program.digest:
            raise BlockError("it belongs to another program", word=layout.W_PROGRAM)
        if w[layout.W_TOP] != size // 8 or block.top < heap:
            raise BlockError("its size is not what it says", word=layout.W_TOP)
        if not 0 <= block.interval <= layout.MOST_INTERVAL / 1000:
            raise BlockError("its heartbeat interval is not sound", word=layout.W_INTERVAL)
        if heap > layout.W_TICKETS and not (
            0 <= w[layout.W_CLOCK] < COUNT_LIMIT and 0 <= w[layout.W_TICKETS] < COUNT_LIMIT
        ):
            raise BlockError("its clock is not sound", word=layout.W_CLOCK)
        return block

    def _copied(self, image: bytes | bytearray | memoryview, limit: int) -> Buffer:
        """The bytes with room for what it will soon need: what a portal gives it, say."""
        size = len(image)
        data = self._space.room(max(size, 8 * min(limit, max(INITIAL_WORDS, size // 8 * 3 // 2))))
        data[:size] = image
        return data

    def _things(self, block: Block) -> Mapping[int, int]:
        """The places of all things, each with the low half of its header; all their references are sound."""
        if block.heap == HEADER_WORDS:
            found = block.space.walked(block.data, block.heap, block.top, self.shapes)
            if found is not None:
                known, tickets = found
                for place in tickets:
                    check_ticket(self.program, block.w, known, place)
                return known
        starts = self._walk(block, self.shapes.sizes)
        self._check_references(block, starts)
        return starts

    def _walk(self, block: Block, sizes: dict[int, int]) -> dict[int, int]:
        """The places of all things, each with the low half of its header."""
        w, top = block.w, block.top
        starts: dict[int, int] = {}
        place = block.heap
        while place < top:
            head = w[place]
            half, words = head & 0xFFFFFFFF, head >> 32
            size = sizes.get(half)
            if size is None or words <= 0 or place + words > top or (size and size != words):
                raise BlockError("a thing on the heap has no sound header", word=place)
            if half == layout.STRING and not self._is_text(block, place, words):
                raise BlockError("a string is no text", word=place)
            if half & 0xFF == layout.PROXY and not self._is_proxy(
                # Of a proxy of the version before, the last word is the number again.
                w[place + PROXY_MEMBER],
                w[place + words - 1],
                half >> 8,
            ):
                raise BlockError("a proxy leads to no resource of its type", word=place)
            starts[place] = half
            place += words
        return starts

    def _is_proxy(self, number: int, start: int, record: int) -> bool:
        return (
            0 <= number < len(self.shapes.members)
            and self.shapes.members[number] == record
            and 0 <= start < layout.START_LIMIT
        )

    def _is_text(self, block: Block, place: int, words: int) -> bool:
        if words < 2 or not 0 <= block.w[place + 1] <= 8 * (words - 2):
            return False
        try:
            block.string(place)
        except UnicodeDecodeError:
            return False
        return True

    def _check_references(self, block: Block, starts: dict[int, int]) -> None:
        w, shapes = block.w, self.shapes
        for place in starts:
            for offset, expected in shapes.references(w[place]):
                target = w[place + offset]
                if not target:
                    continue
                found = starts.get(target, _NOTHING)
                if found != expected and not shapes.is_kind(found, expected):
                    raise BlockError("a reference leads to no thing of its type", word=place + offset)
                if expected == SENTINEL and w[target + TICKET_NUMBER]:
                    raise BlockError("a together is held by one of its calls", word=place + offset)
        for place, half in starts.items():
            if half & 0xFF == layout.TICKET:
                if block.heap < HEADER_WORDS:
                    raise BlockError("its version knows no tickets", word=place)
                check_ticket(self.program, w, starts, place)

    def _check_coordinator(self, block: Block, starts: Mapping[int, int]) -> None:
        """One thread, its frames one chain, standing at the portal call it travels for."""
        w = block.w
        core = self.program.core
        record = w[layout.W_CLASS]
        if not 0 <= record < len(core.classes) or core.classes[record].kind != "coordinator":
            raise BlockError("it is no coordinator's", word=layout.W_CLASS)
        if (
            starts.get(w[layout.W_SELF]) != OBJECT | record << 8
            or starts.get(w[layout.W_ID]) != layout.STRING
        ):
            raise BlockError("its roots are not sound", word=layout.W_SELF)
        thread = w[layout.W_THREADS]
        if starts.get(thread) != THREAD or w[thread + THREAD_NEXT] or w[thread + THREAD_CALL]:
            raise BlockError("it has not exactly one thread", word=layout.W_THREADS)
        if w[layout.W_OWNER] not in (0, w[thread + THREAD_ID]) or not 0 <= w[layout.W_HOPS] < MOST_HOPS:
            raise BlockError("its header is not sound", word=layout.W_OWNER)
        self._check_frames(w, starts, w[thread + THREAD_FRAME], w[thread + THREAD_PC])

    def _check_frames(self, w: memoryview[int], starts: Mapping[int, int], frame: int, pc: int) -> None:
        if pc not in self.stances.portal_calls:
            raise BlockError("it does not stand at a portal call", word=frame)
        methods = self.program.core.methods
        callee = -1
        depth = 0
        while True:
            half = starts.get(frame, 0)
            if half & 0xFF != FRAME:
                raise BlockError("its frames are no chain", word=frame)
            method = methods[half >> 8]
            if not method.entry < pc < method.end or (depth and w[frame + FRAME_DEPTH] != depth - 1):
                raise BlockError("a frame stands outside its method", word=frame)
            if callee >= 0 and self.stances.calls.get(pc - 1) != callee:
                raise BlockError("a frame does not stand behind its call", word=frame)
            self._check_reserved(w, method, frame, pc if callee < 0 else pc - 1)
            depth, callee, pc = w[frame + FRAME_DEPTH], half >> 8, w[frame + FRAME_RETURN]
            frame = w[frame + FRAME_CALLER]
            if not frame and depth == 1:
                return
            if depth < 1:
                raise BlockError("its frames are no chain", word=frame)

    def _check_reserved(self, w: memoryview[int], method: MethodRecord, frame: int, pc: int) -> None:
        """What the blocks around an instruction of a frame keep: resources, each once, and numbers."""
        for row in method.handlers:
            array = w[frame + FRAME_SLOTS + row.slot] if row.kind == RESERVED else 0
            if not array or not row.start <= pc < row.end:
                continue
            members, numbers = (w[i : array + (w[array] >> 32)].tolist()[::2] for i in (array + 1, array + 2))
            known = len(members) == len(numbers) == len(set(members))
            if not (known and self._resources.issuperset(members) and all(map(_is_count, numbers))):
                raise BlockError("what it has reserved is not sound", word=array)


def _is_count(number: int) -> bool:
    return 0 <= number < COUNT_LIMIT
