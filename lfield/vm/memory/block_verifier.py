"""Verifier of blocks from peers, so that engines need no checks at run time.

One walk over the heap: sizes must tile the block, each reference must lead to the start of an object of the
type of its slot or field, and frames must form one chain that is at a portal call.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import cached_property

from lfield.bytecode.program import RESERVED, MethodRecord, Program
from lfield.errors import BlockError
from lfield.vm.memory import layout
from lfield.vm.memory.block import INITIAL_WORDS, Block
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator, Buffer
from lfield.vm.memory.call_tickets import check_ticket
from lfield.vm.memory.collector import collect
from lfield.vm.memory.heap_schema import SENTINEL, HeapSchema, SuspensionPoints
from lfield.vm.memory.layout import (
    COUNT_LIMIT,
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    FRAME_SLOTS,
    GROWABLE,
    GROWABLE_ARRAY,
    GROWABLE_LENGTH,
    HEADER_WORDS,
    HEADERS,
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
from lfield.vm.memory.serialised_results import WORD_SIZE

STATES = len(layout.STATE_NAMES)
#: A limit of migrations that no coordinator reaches, so that the count fits its word.
MAX_HOPS = 1 << 48
_MAGIC, _EARLIER_MAGIC, _OLD_MAGIC = (
    layout.MAGIC | version << 32 for version in (layout.VERSION, layout.EARLIER_VERSION, layout.OLD_VERSION)
)
#: A number that is not the lower half of any header.
_NOTHING = 0xFF
_WRONG = "wrong magic or version"
#: The bytes of a block before its top.
_BEFORE_TOP = 8 * layout.W_TOP


#: The words W_GENERATION and W_SEQUENCE.
_COUNTS = struct.Struct("<qq")


class BlockVerifier:
    """Verifies blocks of one program; `members` are the types of the team's agents by number.

    A valid block gets its bytes from `space`.
    """

    def __init__(
        self,
        program: Program,
        layouts: Layouts,
        members: Sequence[str],
        space: BlockAllocator = HEAP_ALLOCATOR,
    ) -> None:
        self.program, self._layouts, self._space = program, layouts, space
        self.schema = HeapSchema(program, layouts, members)
        self.suspension_points = SuspensionPoints(self.schema)
        #: The first words of a block of this program.
        self._prefix = _MAGIC.to_bytes(8, "little") + program.digest

    @cached_property
    def _resources(self) -> frozenset[int]:
        """The numbers of the resources."""
        classes = self.program.core.classes
        return frozenset(
            number
            for number, member_class in enumerate(self.schema.members)
            if member_class >= 0 and classes[member_class].kind == "resource"
        )

    def check(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        """A migrating coordinator's block from its bytes (`limit` in words). Raises BlockError."""
        size = len(image)
        may_be_sound = size <= 8 * limit and not size % 8 and image[:_BEFORE_TOP] == self._prefix
        if self._space.is_native and may_be_sound and _has_counts(image):
            data = self._copied(image, limit)
            if self._space.can_migrate(data, size // 8, self.suspension_points):
                return Block(data, size // 8, limit, self._space, packed=size // 8)
        # The block is of an earlier version, invalid, or undecided.
        block = self._adopt(image, limit)
        if block.w[layout.W_MAGIC] not in (_MAGIC, _EARLIER_MAGIC):
            raise BlockError(_WRONG, word=layout.W_MAGIC)
        self._check_coordinator(block, self._objects(block))
        if block.w[layout.W_MAGIC] == _EARLIER_MAGIC:
            # The block is moved, and gets the present header.
            collect(block, self._layouts)
        return block

    def is_result(self, result: bytes, thrown: bool) -> bool:
        """Whether bytes are a valid result or exception of a call (`lfield.vm.memory.serialised_results`)."""
        if len(result) == WORD_SIZE:
            return not thrown
        try:
            block = self._adopt(result, len(result) // 8)
            if block.w[layout.W_MAGIC] != _MAGIC:
                return False
            starts = self._objects(block)
        except BlockError:
            return False
        root = starts.get(block.w[layout.W_SELF], 0) & 0xFF
        return root == OBJECT or (
            not thrown and root in (*layout.ARRAYS_ON_HEAP, layout.STRING, layout.PROXY)
        )

    def check_heap(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        """Any agent's block from its bytes, valid enough to be read. Raises BlockError.

        Accepts both earlier versions: they have no last words of the header, and 0.3 has no second word of a
        proxy.
        """
        block = self._adopt(image, limit)
        sizes = self.schema.sizes
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
        """Check the roots, and that every thread list and frame chain ends."""
        w = block.w
        classes = self.program.core.classes
        if not 0 <= w[layout.W_CLASS] < len(classes):
            raise BlockError("its class is unknown", word=layout.W_CLASS)
        for word, half in ((layout.W_SELF, OBJECT | w[layout.W_CLASS] << 8), (layout.W_ID, layout.STRING)):
            if w[word] and starts.get(w[word]) != half:
                raise BlockError("its roots are not valid", word=word)
        visited: set[int] = set()
        thread = w[layout.W_THREADS]
        while thread:
            if (
                starts.get(thread) != THREAD
                or thread in visited
                or not 0 <= w[thread + THREAD_STATE] < STATES
            ):
                raise BlockError("its threads do not form a list", word=thread)
            visited.add(thread)
            self._check_chain(w, starts, w[thread + THREAD_FRAME])
            thread = w[thread + THREAD_NEXT]

    def _check_chain(self, w: memoryview[int], starts: dict[int, int], frame: int) -> None:
        depth = 0
        while frame:
            if starts.get(frame, 0) & 0xFF != FRAME or (depth and w[frame + FRAME_DEPTH] != depth - 1):
                raise BlockError("its frames do not form a chain", word=frame)
            depth = w[frame + FRAME_DEPTH]
            frame = w[frame + FRAME_CALLER]

    def _adopt(self, image: bytes | bytearray | memoryview, limit: int) -> Block:
        size = len(image)
        if size % 8 or size < 8 * layout.HEADERS[layout.OLD_VERSION]:
            raise BlockError(f"{size} bytes are not a whole block")
        if size > 8 * limit:
            raise BlockError(f"{size} bytes are over the limit of {8 * limit}")
        # A coordinator is packed before it is sent.
        block = Block(self._copied(image, limit), size // 8, limit, self._space, packed=size // 8)
        w = block.w
        heap = HEADERS.get(w[layout.W_MAGIC] >> 32, HEADER_WORDS)
        if image[8 * layout.W_PROGRAM : 8 * layout.W_PROGRAM + 32] != self.program.digest:
            raise BlockError("it belongs to another program", word=layout.W_PROGRAM)
        if w[layout.W_TOP] != size // 8 or block.top < heap:
            raise BlockError("its size does not match its header", word=layout.W_TOP)
        if not (0 <= w[layout.W_GENERATION] < COUNT_LIMIT and 0 <= w[layout.W_SEQUENCE] < COUNT_LIMIT):
            raise BlockError("its counters are not valid", word=layout.W_GENERATION)
        if heap > layout.W_INTERVAL and not 0 <= w[layout.W_INTERVAL] <= layout.MAX_INTERVAL:
            raise BlockError("its heartbeat interval is not valid", word=layout.W_INTERVAL)
        if heap > layout.W_TICKETS and not (
            0 <= w[layout.W_CLOCK] < COUNT_LIMIT and 0 <= w[layout.W_TICKETS] < COUNT_LIMIT
        ):
            raise BlockError("its clock is not valid", word=layout.W_CLOCK)
        return block

    def _copied(self, image: bytes | bytearray | memoryview, limit: int) -> Buffer:
        """A copy of the bytes with space for imminent growth, such as a portal's result."""
        size = len(image)
        data = self._space.allocate(max(size, 8 * min(limit, max(INITIAL_WORDS, size // 8 * 3 // 2))))
        data[:size] = image
        return data

    def _objects(self, block: Block) -> Mapping[int, int]:
        """Positions of all objects with the lower half of their headers; checks all references."""
        if block.space.is_native and block.heap == HEADER_WORDS:
            found = block.space.verify_heap(block.data, block.heap, block.top, self.schema)
            if found is not None:
                known, tickets = found
                for place in tickets:
                    check_ticket(self.program, block.w, known, place)
                return known
        starts = self._walk(block, self.schema.sizes)
        self._check_references(block, starts)
        return starts

    def _walk(self, block: Block, sizes: dict[int, int]) -> dict[int, int]:
        """Positions of all objects with the lower half of their headers."""
        w, top, members = block.w, block.top, self.schema.members
        starts: dict[int, int] = {}
        place = HEADERS.get(w[layout.W_MAGIC] >> 32, HEADER_WORDS)
        while place < top:
            head = w[place]
            half, words = head & 0xFFFFFFFF, head >> 32
            size = sizes.get(half)
            if size is None or words <= 0 or place + words > top or (size and size != words):
                raise BlockError("an object on the heap has an invalid header", word=place)
            if half == layout.STRING and not self._is_text(block, place, words):
                raise BlockError("a string is not valid UTF-8", word=place)
            if half & 0xFF == layout.PROXY:
                # In a proxy of the previous version, the last word repeats the number.
                number, start = w[place + PROXY_MEMBER], w[place + words - 1]
                known = 0 <= number < len(members) and members[number] == half >> 8
                if not (known and 0 <= start < layout.START_LIMIT):
                    raise BlockError("a proxy does not refer to a resource of its type", word=place)
            starts[place] = half
            place += words
        return starts

    def _is_text(self, block: Block, place: int, words: int) -> bool:
        if words < 2 or not 0 <= (length := block.w[place + 1]) <= 8 * (words - 2):
            return False
        start = 8 * (place + 2)
        try:
            str(block.data[start : start + length], "utf-8")
        except UnicodeDecodeError:
            return False
        return True

    def _check_references(self, block: Block, starts: dict[int, int]) -> None:
        w, schema, expects = block.w, self.schema, self.schema.expects
        for place, half in starts.items():
            references = expects.get(half)
            for offset, expected in schema.references(w[place]) if references is None else references:
                target = w[place + offset]
                if not target:
                    continue
                found = starts.get(target, _NOTHING)
                if found != expected and not schema.is_kind(found, expected):
                    raise BlockError(
                        "a reference does not refer to an object of its type", word=place + offset
                    )
                if expected == SENTINEL and w[target + TICKET_NUMBER]:
                    raise BlockError("the sentinel of a together is one of its calls", word=place + offset)
        for place, half in starts.items():
            if half & 0xFF == GROWABLE:
                array = w[place + GROWABLE_ARRAY]
                if not array or not 0 <= w[place + GROWABLE_LENGTH] < w[array] >> 32:
                    raise BlockError("an array is longer than its elements", word=place)
            if half & 0xFF == layout.TICKET:
                if block.heap < HEADER_WORDS:
                    raise BlockError("its version has no tickets", word=place)
                check_ticket(self.program, w, starts, place)

    def _check_coordinator(self, block: Block, starts: Mapping[int, int]) -> None:
        """Check that the block has one thread with one chain of frames, at the portal call of the
        migration.
        """
        w = block.w
        core = self.program.core
        record = w[layout.W_CLASS]
        if not 0 <= record < len(core.classes) or core.classes[record].kind != "coordinator":
            raise BlockError("it is not a coordinator's", word=layout.W_CLASS)
        if (
            starts.get(w[layout.W_SELF]) != OBJECT | record << 8
            or starts.get(w[layout.W_ID]) != layout.STRING
        ):
            raise BlockError("its roots are not valid", word=layout.W_SELF)
        thread = w[layout.W_THREADS]
        if starts.get(thread) != THREAD or w[thread + THREAD_NEXT] or w[thread + THREAD_CALL]:
            raise BlockError("it has not exactly one thread", word=layout.W_THREADS)
        if w[layout.W_OWNER] not in (0, w[thread + THREAD_ID]) or not 0 <= w[layout.W_HOPS] < MAX_HOPS:
            raise BlockError("its header is not valid", word=layout.W_OWNER)
        self._check_frames(w, starts, w[thread + THREAD_FRAME], w[thread + THREAD_PC])

    def _check_frames(self, w: memoryview[int], starts: Mapping[int, int], frame: int, pc: int) -> None:
        if pc not in self.suspension_points.portal_calls:
            raise BlockError("it is not at a portal call", word=frame)
        methods = self.program.core.methods
        callee = -1
        depth = 0
        while True:
            half = starts.get(frame, 0)
            if half & 0xFF != FRAME:
                raise BlockError("its frames do not form a chain", word=frame)
            method = methods[half >> 8]
            if not method.entry < pc < method.end or (depth and w[frame + FRAME_DEPTH] != depth - 1):
                raise BlockError("a frame is outside its method", word=frame)
            if callee >= 0 and self.suspension_points.calls.get(pc - 1) != callee:
                raise BlockError("a frame is not after its call", word=frame)
            if method.handlers:
                self._check_reserved(w, method, frame, pc if callee < 0 else pc - 1)
            depth, callee, pc = w[frame + FRAME_DEPTH], half >> 8, w[frame + FRAME_RETURN]
            frame = w[frame + FRAME_CALLER]
            if not frame and depth == 1:
                return
            if depth < 1:
                raise BlockError("its frames do not form a chain", word=frame)

    def _check_reserved(self, w: memoryview[int], method: MethodRecord, frame: int, pc: int) -> None:
        """Check the reservations around an instruction of a frame: distinct resources, and numbers."""
        for row in method.handlers:
            array = w[frame + FRAME_SLOTS + row.slot] if row.kind == RESERVED else 0
            if not array or not row.start <= pc < row.end:
                continue
            members, numbers = (w[i : array + (w[array] >> 32)].tolist()[::2] for i in (array + 1, array + 2))
            known = len(members) == len(numbers) == len(set(members))
            if not (known and self._resources.issuperset(members) and all(map(_is_count, numbers))):
                raise BlockError("its reservations are not valid", word=array)


def _is_count(number: int) -> bool:
    return 0 <= number < COUNT_LIMIT


def _has_counts(image: bytes | bytearray | memoryview) -> bool:
    """Whether generation and sequence are counts; the native check accepts any number."""
    generation, sequence = _COUNTS.unpack_from(image, 8 * layout.W_GENERATION)
    return bool(0 <= generation < COUNT_LIMIT and 0 <= sequence < COUNT_LIMIT)
