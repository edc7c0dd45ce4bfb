"""Layout of a block: its header, and the words of each heap object.

A block is one contiguous run of little-endian 64-bit words (chapter V, Memory Management). A reference is the
index of a word from the start of the block; 0 is null. Word 0 of each heap object is its header: kind in bits
0-7, record index in bits 8-31, size in words (header included) in bits 32-62. While the collector works, a
negative header is the negated new place of a moved object.

    OBJECT   class index     fields
    ARRAY    type index      elements
    STRING   -               length in bytes, then UTF-8 padded with zeros
    PROXY    class index     see PROXY_* below
    FRAME    method index    caller, return pc, depth, slots
    THREAD   -               see THREAD_* below
    TICKET   type index      see TICKET_* below; the type of its target array, 0 for no target
    GROWABLE type index      length, its ARRAY: the elements, then spare words, which are 0
"""

from __future__ import annotations

from lfield.bytecode.program import ARRAY as ARRAY_TYPE
from lfield.bytecode.program import ARRAYS, REFERENCES, Program, TypeRecord
from lfield.bytecode.program import GROWABLE as GROWABLE_TYPE

MAGIC = int.from_bytes(b"LBLK", "little")
VERSION = 3
#: The version of blocks in dumps of lfield 0.3, whose proxies have no START.
OLD_VERSION = 1
#: The version of blocks without tickets and time limits, which are only read from journals.
EARLIER_VERSION = 2

# The block's header, by word.
W_MAGIC = 0  # magic, version in the upper half
W_PROGRAM = 1  # SHA-256 of the program: four words
W_TOP = 5  # first unused word
W_CLASS = 6  # class index of the agent
W_SELF = 7  # the resource or coordinator object
W_ID = 8  # its id, a string
W_THREADS = 9  # first thread
W_NEXT_THREAD = 10  # id for the next thread
W_OWNER = 11  # id of the thread that holds the monitor, or 0
W_ENTRIES = 12  # number of its acquisitions
W_GENERATION = 13  # identifies the start of the coordinator
W_SEQUENCE = 14  # number of the last attempt to migrate
W_HOPS = 15  # migrations made
W_TRAIL = 16  # the last hosts, as numbers from 1 in the order of the deployment; a ring
TRAIL_LENGTH = 16
W_INTERVAL = W_TRAIL + TRAIL_LENGTH  # heartbeat interval of its shadows in ms, 0 for none (appendix I)
W_CLOCK = W_INTERVAL + 1  # the agent's clock (its age) in ns, when it was last packed
W_TICKETS = W_INTERVAL + 2  # the number of the last ticket
HEADER_WORDS = W_INTERVAL + 3
#: Words before the heap, by version.
HEADERS = {OLD_VERSION: W_INTERVAL, EARLIER_VERSION: W_CLOCK, VERSION: HEADER_WORDS}

#: The longest heartbeat interval: a day, in milliseconds.
MAX_INTERVAL = 86_400_000

#: Header words that hold references: the collector's roots.
ROOTS = (W_SELF, W_ID, W_THREADS)

# Kinds of heap objects.
OBJECT, ARRAY, STRING, PROXY, FRAME, THREAD, TICKET, GROWABLE = 1, 2, 3, 4, 5, 6, 7, 8
#: Kinds of the objects that have elements.
ARRAYS_ON_HEAP = (ARRAY, GROWABLE)

# A proxy. MEMBER is the number of the resource in the deployment, START the incarnation of its host at the
# last call: 0 before the first call, else below START_LIMIT.
PROXY_MEMBER, PROXY_START = 1, 2
PROXY_WORDS = 3
START_LIMIT = 1 << 62

# A growable array. The size of its ARRAY is its capacity; a collection drops the spare words.
GROWABLE_LENGTH, GROWABLE_ARRAY = 1, 2
GROWABLE_WORDS = 3

# A frame (activation record).
FRAME_CALLER, FRAME_RETURN, FRAME_DEPTH, FRAME_SLOTS = 1, 2, 3, 4

# A thread. STATE is one of the THREAD states; CALL is the host's number of the portal call it serves.
THREAD_ID, THREAD_STATE, THREAD_FRAME, THREAD_PC, THREAD_NEXT, THREAD_CALL = 1, 2, 3, 4, 5, 6
THREAD_WORDS = 7
THREAD_REFERENCES = (THREAD_FRAME, THREAD_NEXT)

# A ticket: one portal call of a `together` (decision 46). CALL is a frame of the portal METHOD, with the
# arguments in its slots, until the call has started. The result goes to element INDEX of ARRAY. NEXT is the
# ticket collected before: numbers decrease along this chain. The ticket with NUMBER 0 is the sentinel of a
# `together`: it has only NEXT, the newest. A ticket without a PROXY has no CALL, and is RETURNED: it has the
# result of an offer that was executed synchronously.
TICKET_PROXY, TICKET_CALL, TICKET_METHOD, TICKET_ARRAY, TICKET_INDEX, TICKET_STATE = 1, 2, 3, 4, 5, 6
TICKET_GENERATION, TICKET_NUMBER, TICKET_VALUE, TICKET_THROWN, TICKET_NEXT = 7, 8, 9, 10, 11
TICKET_WORDS = 12
TICKET_REFERENCES = (TICKET_PROXY, TICKET_CALL, TICKET_ARRAY, TICKET_THROWN, TICKET_NEXT)
#: States of a ticket. CANCELLING: the call has started, and its host was informed of the cancellation.
TICKET_COLLECTED, TICKET_STARTED, TICKET_CANCELLING, TICKET_RETURNED = 1, 2, 3, 4
#: Upper limit of numbers and clocks.
COUNT_LIMIT = 1 << 62

# Thread states.
READY, PARKED, SLEEPING, BLOCKED, CALLING, WAITING, DEAD = range(7)
STATE_NAMES = ("ready", "parked", "sleeping", "blocked", "in a portal", "waiting for a device", "dead")


def header(kind: int, index: int, words: int) -> int:
    """The header word of a heap object."""
    return kind | index << 8 | words << 32


def elements(w: memoryview[int], place: int) -> tuple[int, int]:
    """The words of the elements of an array of either kind: the first word, and the word after the
    last one.
    """
    if w[place] & 0xFF == GROWABLE:
        first = w[place + GROWABLE_ARRAY] + 1
        return first, first + w[place + GROWABLE_LENGTH]
    return place + 1, place + (w[place] >> 32)


def length(w: memoryview[int], place: int) -> int:
    """The number of elements of an array of either kind."""
    first, end = elements(w, place)
    return end - first


class Layouts:
    """Positions of references, for every record of one program; computed once when it is loaded."""

    def __init__(self, program: Program) -> None:
        core = program.core
        holds_reference = [t.kind in REFERENCES for t in core.types]
        #: Per class: words of an object, and offsets of its reference fields.
        self.class_words = [1 + len(c.fields) for c in core.classes]
        self.class_references = [
            tuple(1 + i for i, f in enumerate(c.fields) if holds_reference[f.type]) for c in core.classes
        ]
        #: Per type: whether an ARRAY of that type holds references.
        self.array_references = [t.kind == ARRAY_TYPE and holds_reference[t.of] for t in core.types]
        #: Per type: the type of the ARRAY with the elements of an array.
        self.plain_arrays = [core.plain_array(i) for i in range(len(core.types))]
        #: Per method: words of a frame, and offsets of its reference slots.
        self.frame_words = [FRAME_SLOTS + len(m.slots) for m in core.methods]
        self.frame_references = [
            (FRAME_CALLER, *(FRAME_SLOTS + i for i, t in enumerate(m.slots) if holds_reference[t]))
            for m in core.methods
        ]

        #: By the lower half of a header: the reference that is not copied to another block: the suppressed
        #: exceptions of a `together`. This reference may lead to objects that cannot be passed through a
        #: portal.
        self.uncopied = {OBJECT | i << 8: 1 + field for i, field in program.others.items()}
        #: Offsets of the references by the lower half of a header; arrays of references have no entry.
        self.offsets = self._by_half(core.types)

    def _by_half(self, types: tuple[TypeRecord, ...]) -> dict[int, tuple[int, ...]]:
        offsets: dict[int, tuple[int, ...]] = {
            STRING: (),
            THREAD: THREAD_REFERENCES,
            TICKET: TICKET_REFERENCES,
        }
        for i, found in enumerate(self.class_references):
            offsets[OBJECT | i << 8] = found
            offsets[PROXY | i << 8] = ()
        for i, found in enumerate(self.frame_references):
            offsets[FRAME | i << 8] = found
        for i, record in enumerate(types):
            if record.kind not in ARRAYS:
                continue
            holds_references = self.array_references[self.plain_arrays[i]]
            if record.kind == GROWABLE_TYPE:
                offsets[GROWABLE | i << 8] = (GROWABLE_ARRAY,)
            elif not holds_references:
                offsets[ARRAY | i << 8] = ()
            value = (TICKET_VALUE,) if holds_references else ()
            offsets[TICKET | i << 8] = (*TICKET_REFERENCES, *value)
        return offsets

    def references(self, head: int) -> tuple[int, ...] | range:
        """Offsets of the references in an object with that header word."""
        found = self.offsets.get(head & 0xFFFFFFFF)
        return range(1, head >> 32) if found is None else found
