"""Block decoder with debug information: agent, threads, stack, locals, heap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield.bytecode.program import (
    ANY,
    BOOLEAN,
    DEVICE,
    INT,
    PROXY,
    REAL,
    REFERENCES,
    RESERVED,
    STRING,
    TICKET,
    MethodRecord,
    Program,
)
from lfield.text.terminal_escape import escape_line, truncate
from lfield.vm.inspection.traceback import stack
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.call_tickets import tickets_of
from lfield.vm.memory.layout import (
    FRAME_SLOTS,
    STATE_NAMES,
    THREAD_CALL,
    THREAD_ID,
    THREAD_STATE,
)
from lfield.vm.memory.threads import threads
from lfield.vm.memory.word_codec import real_from_bits, real_text

#: Maximum characters of a string, and elements or fields, that are shown.
SHOWN_CHARACTERS = 60
SHOWN_PARTS = 8
#: The fields of a map (`lfield/lang/standard_library/map.L`), in their order.
MAP_FIELDS = ("keys", "values", "next", "buckets", "count")
_MAP_PREFIX = "map<"
_TICKET_STATES = {
    layout.TICKET_COLLECTED: "not started",
    layout.TICKET_STARTED: "started",
    layout.TICKET_CANCELLING: "to be cancelled",
    layout.TICKET_RETURNED: "returned",
}


class FrameView(Struct, frozen=True):
    """One activation record: `Owner.method`, position, source line, named slots.

    `calls`: the calls of each enclosing `together` with their states; `reserved`: the resources of each
    `reserve`.
    """

    method: str
    file: str
    line: int
    text: str
    locals: tuple[tuple[str, str], ...]
    calls: tuple[str, ...] = ()
    reserved: tuple[str, ...] = ()


class ThreadView(Struct, frozen=True):
    """One thread, its frames innermost first. `call` is the portal call it serves, 0 for none."""

    id: int
    state: str
    call: int
    frames: tuple[FrameView, ...]


class BlockView(Struct, frozen=True):
    """A decoded block. `heap` has the number and bytes of each kind of heap object.

    `interval` is the heartbeat interval in seconds, 0 for none.
    """

    id: str
    type: str
    kind: str
    hops: int
    trail: tuple[int, ...]
    interval: float
    used: int
    fields: tuple[tuple[str, str], ...]
    threads: tuple[ThreadView, ...]
    heap: tuple[tuple[str, int, int], ...]


def view(block: Block, program: Program, members: Sequence[str] = ()) -> BlockView:
    """Decode a valid block; `members` are the ids of the deployment, for proxies."""
    return _Decoder(block, program, members).view()


def fields_of(block: Block, program: Program, place: int, members: Sequence[str] = ()) -> str:
    """The fields of an object, to show beside a variable: `{7, "late"}`."""
    return _Decoder(block, program, members).parts(_field_types(program, place, block), place)


def value_text(block: Block, program: Program, kind: int, word: int, members: Sequence[str] = ()) -> str:
    """A value of a type (by index), one level deep."""
    return _Decoder(block, program, members).value_text(kind, word)


def _field_types(program: Program, place: int, block: Block) -> list[int]:
    """Types of an object's fields, except the fields added by the machine."""
    fields = program.core.classes[block.w[place] >> 8 & 0xFFFFFF].fields
    return [field.type for field in fields if not field.is_hidden]


# --- maps ---------------------------------------------------------------------------------------------


def is_map_class(program: Program, index: int) -> bool:
    """Whether objects of a class are maps."""
    record = program.core.classes[index]
    return record.name.startswith(_MAP_PREFIX) and tuple(f.name for f in record.fields[:5]) == MAP_FIELDS


def is_map(block: Block, program: Program, place: int) -> bool:
    """Whether the object at a place is a map."""
    head = block.w[place]
    return head & 0xFF == layout.OBJECT and is_map_class(program, head >> 8 & 0xFFFFFF)


def entry_types(program: Program, index: int) -> tuple[int, int]:
    """The types of the keys and values of a class of maps."""
    keys, values = program.core.classes[index].fields[:2]
    return program.core.element(keys.type), program.core.element(values.type)


def map_entries(block: Block, place: int) -> list[tuple[int, int]]:
    """The words of the keys and values of a map, in the order of their insertion."""
    w = block.w
    keys, values, following, buckets = (w[place + 1 + field] for field in range(4))
    if not (keys and values and following and buckets):
        return []
    # A map without buckets has only keys and values: a test has made it.
    links = (
        w[slice(*layout.elements(w, following))]
        if layout.length(w, buckets)
        else [0] * layout.length(w, keys)
    )
    first_key, first_value = layout.elements(w, keys)[0], layout.elements(w, values)[0]
    return [(w[first_key + i], w[first_value + i]) for i, link in enumerate(links) if link >= 0]


class _Decoder:
    def __init__(self, block: Block, program: Program, members: Sequence[str]) -> None:
        self.block, self.program, self.members = block, program, members

    def view(self) -> BlockView:
        w, core = self.block.w, self.program.core
        record = core.classes[w[layout.W_CLASS]]
        own = w[layout.W_SELF]
        fields = tuple(
            (f.name, self.value_text(f.type, w[own + 1 + i])) for i, f in enumerate(record.fields) if own
        )
        return BlockView(
            self.block.text(w[layout.W_ID]),
            record.name,
            record.kind,
            w[layout.W_HOPS],
            tuple(self.block.trail()),
            self.block.interval,
            8 * self.block.top,
            fields,
            tuple(self.thread(place) for place in threads(self.block)),
            self.heap(),
        )

    def thread(self, place: int) -> ThreadView:
        w = self.block.w
        frames = []
        for at in stack(self.block, self.program, place):
            method = self.program.core.methods[at.method]
            names = self.program.debug.methods[at.method].names if self.program.debug.methods else ()
            local_texts = tuple(
                (name, self.value_text(method.slots[slot], w[at.frame + FRAME_SLOTS + slot]))
                for slot, name in names
            )
            frames.append(
                FrameView(
                    self.program.method_name(at.method),
                    at.file,
                    at.line,
                    self.source(at.method, at.line),
                    local_texts,
                    tuple(self.calls(method, at.frame)),
                    tuple(self.reserved(method, at.frame)),
                )
            )
        return ThreadView(
            w[place + THREAD_ID], STATE_NAMES[w[place + THREAD_STATE]], w[place + THREAD_CALL], tuple(frames)
        )

    def calls(self, method: MethodRecord, frame: int) -> Iterator[str]:
        """The calls of the togethers of a frame, each in order of collection."""
        for slot, kind in enumerate(method.slots):
            sentinel = self.block.w[frame + FRAME_SLOTS + slot]
            if self.program.core.types[kind].kind == TICKET and sentinel:
                yield from (self.call(ticket) for ticket in tickets_of(self.block, sentinel))

    def reserved(self, method: MethodRecord, frame: int) -> Iterator[str]:
        """The reservations of a frame; ungranted and lost ones are omitted."""
        w = self.block.w
        for row in method.handlers:
            array = w[frame + FRAME_SLOTS + row.slot] if row.kind == RESERVED else 0
            for place in range(array + 1, array + (w[array] >> 32) - 1, 2) if array else ():
                if w[place + 1] and 0 <= w[place] < len(self.members):
                    yield f"{self.members[w[place]]}, by number {w[place + 1]}"

    def call(self, ticket: int) -> str:
        """One call of a together: its portal and state."""
        w = self.block.w
        if not w[ticket + layout.TICKET_PROXY]:
            return "an offer that was executed synchronously returned"
        number = w[w[ticket + layout.TICKET_PROXY] + layout.PROXY_MEMBER]
        name = self.members[number] if number < len(self.members) else str(number)
        portal = self.program.core.methods[w[ticket + layout.TICKET_METHOD]].name
        state = _TICKET_STATES[w[ticket + layout.TICKET_STATE]]
        if thrown := w[ticket + layout.TICKET_THROWN]:
            state += f" with {self.program.core.classes[w[thrown] >> 8 & 0xFFFFFF].name}"
        return f"{name}.{portal}() {state}"

    def source(self, method: int, line: int) -> str:
        if not line:
            return ""
        text = self.program.debug.sources[self.program.debug.methods[method].source].text.splitlines()
        return escape_line(text[line - 1].strip()) if line <= len(text) else ""

    def value_text(self, kind: int, word: int, inner: bool = False) -> str:
        """A value of a type (by index), one level deep."""
        record = self.program.core.types[kind]
        if record.kind == BOOLEAN:
            return "true" if word else "false"
        if record.kind == REAL:
            return real_text(real_from_bits(word))
        if record.kind == DEVICE:
            return self.device(word)
        if record.kind == INT or record.kind not in REFERENCES:
            members = self.program.core.enum_members(kind)
            return members[word] if 0 <= word < len(members) else str(word)
        if not word:
            return "null"
        if record.kind == TICKET:
            return ", ".join(self.call(ticket) for ticket in tickets_of(self.block, word)) or "no call"
        if record.kind == STRING:
            text = self.block.string(word)
            return f'"{escape_line(truncate(text, SHOWN_CHARACTERS + 1))}"'
        if record.kind == PROXY:
            number = self.block.w[word + layout.PROXY_MEMBER]
            name = self.members[number] if number < len(self.members) else number
            return f"proxy of {name}{'' if self.called(word) else ', not called yet'}"
        return self.composite(record.kind, word, inner)

    def device(self, number: int) -> str:
        """The name of a device of the resource."""
        devices = self.program.core.classes[self.block.w[layout.W_CLASS]].devices
        return f"device {devices[number - 1].name}" if 0 < number <= len(devices) else "no device"

    def called(self, proxy: int) -> bool:
        """Whether a proxy was called; unknown for blocks of the previous version."""
        w = self.block.w
        return w[proxy] >> 32 <= layout.PROXY_START or w[proxy + layout.PROXY_START] != 0

    def composite(self, kind: int, word: int, inner: bool) -> str:
        w, core = self.block.w, self.program.core
        head = w[word]
        index = head >> 8 & 0xFFFFFF
        if head & 0xFF in layout.ARRAYS_ON_HEAP:
            size = layout.length(w, word)
            kinds = [core.element(index)] * size
            name = f"[{size}]"
        else:
            kinds = _field_types(self.program, word, self.block)
            name = core.classes[index].name
        if is_map(self.block, self.program, word):
            return self.map(name, word, inner)
        if inner:
            return f"{name} @{word}"
        mark = f" ({core.classes[index].name})" if kind == ANY else ""
        return f"{name}{mark} @{word} {self.parts(kinds, word)}"

    def map(self, name: str, word: int, inner: bool) -> str:
        """A map with its number of entries, and the first ones."""
        found = map_entries(self.block, word)
        if inner:
            return f"{name}[{len(found)}] @{word}"
        key, value = entry_types(self.program, self.block.w[word] >> 8 & 0xFFFFFF)
        parts = [
            f"{self.value_text(key, k)}: {self.value_text(value, v, True)}" for k, v in found[:SHOWN_PARTS]
        ]
        if len(found) > SHOWN_PARTS:
            parts.append("…")
        return f"{name}[{len(found)}] @{word} {{{', '.join(parts)}}}"

    def parts(self, kinds: Sequence[int], word: int) -> str:
        """The first elements or fields of an object, of these types."""
        w = self.block.w
        first, _ = layout.elements(w, word)
        parts = [self.value_text(k, w[first + i], True) for i, k in enumerate(kinds[:SHOWN_PARTS])]
        if len(kinds) > SHOWN_PARTS:
            parts.append("…")
        return f"{{{', '.join(parts)}}}"

    def heap(self) -> tuple[tuple[str, int, int], ...]:
        count: Counter[str] = Counter()
        size: Counter[str] = Counter()
        place, w = self.block.heap, self.block.w
        while place < self.block.top:
            head = w[place]
            name = self.kind_name(head)
            count[name] += 1
            size[name] += 8 * (head >> 32)
            place += head >> 32
        return tuple((name, count[name], size[name]) for name, _ in size.most_common())

    def kind_name(self, head: int) -> str:
        kind, index = head & 0xFF, head >> 8 & 0xFFFFFF
        if kind == layout.OBJECT:
            return self.program.core.classes[index].name
        if kind == layout.FRAME:
            return f"activation record of {self.program.method_name(index)}"
        names = {
            layout.ARRAY: "array",
            layout.GROWABLE: "growable array",
            layout.STRING: "string",
            layout.PROXY: "proxy",
            layout.THREAD: "thread",
            layout.TICKET: "call of a together",
        }
        return names[kind]
