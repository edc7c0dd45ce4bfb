"""Heap schema of a program: the size of every object, and the types of its references."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from lfield.bytecode.opcodes import BY_NAME, SEQUENCING
from lfield.bytecode.program import ANY, ARRAYS, PROXY, REFERENCES, RESERVED, STRING, TICKET, Program
from lfield.bytecode.program import GROWABLE as GROWABLE_TYPE
from lfield.bytecode.program import OBJECT as OBJECT_TYPE
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    FRAME,
    FRAME_SLOTS,
    GROWABLE,
    GROWABLE_ARRAY,
    GROWABLE_WORDS,
    OBJECT,
    PROXY_WORDS,
    THREAD,
    THREAD_WORDS,
    TICKET_REFERENCES,
    TICKET_VALUE,
    TICKET_WORDS,
    Layouts,
)

#: For a reference: the lower half of its target's header, or one of these: any object, any proxy, any frame,
#: any array, any ticket, the sentinel of a `together`.
ANY_OBJECT, ANY_PROXY, ANY_FRAME, ANY_ARRAY, ANY_TICKET, SENTINEL = range(-1, -7, -1)
_KINDS = {ANY_PROXY: layout.PROXY, ANY_FRAME: FRAME, ANY_ARRAY: layout.ARRAY, ANY_TICKET: layout.TICKET}
_TICKET_EXPECTS = dict(
    zip(TICKET_REFERENCES, (ANY_PROXY, ANY_FRAME, ANY_ARRAY, ANY_OBJECT, ANY_TICKET), strict=True)
)
_PUSH, _CALL = BY_NAME["push"].code, BY_NAME["call"].code
#: Opcodes at which coordinators migrate, and at which they are stored.
_MIGRATING = frozenset(
    BY_NAME[name].code
    for name in ("pcall", "start", "fetch", "leave", "take", "launch", "next", "ended", "cancel", *SEQUENCING)
)
#: Offsets of references in words, each with its target type.
Expected = tuple[tuple[int, int], ...]


class HeapSchema:
    """The schema of one program's heaps; `members` are the types of the team's agents by number."""

    def __init__(self, program: Program, layouts: Layouts, members: Sequence[str]) -> None:
        self.program = program
        self._types = members
        core = program.core
        #: By type, the target of its references; None for types without references.
        self.of_type = [self._expected(i) for i in range(len(core.types))]
        #: By the lower half of a header: the size (0: any), and the targets of references; arrays of
        #: references have no such entry.
        self.sizes: dict[int, int] = {layout.STRING: 0, THREAD: THREAD_WORDS, layout.TICKET: TICKET_WORDS}
        self.expects: dict[int, Expected] = {layout.STRING: (), THREAD: ()}
        self.expects[layout.TICKET] = tuple(_TICKET_EXPECTS.items())
        for i, record in enumerate(core.classes):
            self.sizes[OBJECT | i << 8] = layouts.class_words[i]
            self.sizes[layout.PROXY | i << 8] = PROXY_WORDS
            self.expects[layout.PROXY | i << 8] = ()
            self.expects[OBJECT | i << 8] = self._references([f.type for f in record.fields], 1)
        for i, method in enumerate(core.methods):
            self.sizes[FRAME | i << 8] = layouts.frame_words[i]
            self.expects[FRAME | i << 8] = self._references(method.slots, FRAME_SLOTS)
        for i, kind in enumerate(core.types):
            if kind.kind not in ARRAYS:
                continue
            if kind.kind == GROWABLE_TYPE:
                self.sizes[GROWABLE | i << 8] = GROWABLE_WORDS
                self.expects[GROWABLE | i << 8] = ((GROWABLE_ARRAY, layout.ARRAY | kind.of << 8),)
            else:
                self.sizes[layout.ARRAY | i << 8] = 0
                if self.of_type[kind.of] is None:
                    self.expects[layout.ARRAY | i << 8] = ()
            self.sizes[layout.TICKET | i << 8] = TICKET_WORDS
            self.expects[layout.TICKET | i << 8] = self._of_ticket(i, core.element(i))

    @cached_property
    def members(self) -> Sequence[int]:
        """Class index by member number; -1 for an unknown class."""
        return [self.program.class_index.get(name, -1) for name in self._types]

    def references(self, head: int) -> Expected:
        """The references of an object of known size, by its header word."""
        half = head & 0xFFFFFFFF
        expects = self.expects.get(half)
        if expects is not None:
            return expects
        expected = self.of_elements(half)
        return tuple((i, expected) for i in range(1, head >> 32))

    def of_elements(self, half: int) -> int:
        """The target of the elements of an array of references, by the lower half of its header."""
        expected = self.of_type[self.program.core.types[half >> 8].of]
        assert expected is not None, "arrays without references have a row"
        return expected

    def is_kind(self, found: int, expected: int) -> bool:
        """Whether a target is of a kind, or is an object of a subclass of the class `expected`."""
        if expected == SENTINEL:
            return found == layout.TICKET
        if expected in _KINDS:
            return found & 0xFF == _KINDS[expected]
        if found & 0xFF != OBJECT:
            return False
        return expected == ANY_OBJECT or (
            expected & 0xFF == OBJECT and expected >> 8 in self.program.kinds[found >> 8]
        )

    def _expected(self, kind: int) -> int | None:
        """The expected header half for references of a type, None for types without references."""
        record = self.program.core.types[kind]
        if record.kind not in REFERENCES:
            return None
        if record.kind == STRING:
            return layout.STRING
        if record.kind in ARRAYS:
            return self._array(kind)
        if record.kind == OBJECT_TYPE:
            return layout.OBJECT | record.of << 8
        if record.kind == PROXY:
            return layout.PROXY | record.of << 8
        if record.kind == TICKET:
            return SENTINEL
        return ANY_OBJECT if record.kind == ANY else 0

    def _array(self, kind: int) -> int:
        """The lower half of the header of an array of a type."""
        is_growable = self.program.core.types[kind].kind == GROWABLE_TYPE
        return (GROWABLE if is_growable else layout.ARRAY) | kind << 8

    def _of_ticket(self, array: int, element: int) -> Expected:
        """The targets of the references of a ticket whose array has a type (by index)."""
        expects = {**_TICKET_EXPECTS, layout.TICKET_ARRAY: self._array(array)}
        value = self.of_type[element]
        return tuple((expects if value is None else {**expects, TICKET_VALUE: value}).items())

    def _references(self, kinds: Sequence[int], first: int) -> Expected:
        pairs = ((first + i, self.of_type[kind]) for i, kind in enumerate(kinds))
        return tuple((offset, expected) for offset, expected in pairs if expected is not None)


class SuspensionPoints:
    """Instructions at which frames of a migrating coordinator may be, for a program with `schema`."""

    def __init__(self, schema: HeapSchema) -> None:
        self.schema, self.program = schema, schema.program
        core = self.program.core
        #: The classes of coordinators.
        self.coordinators = frozenset(
            i for i, record in enumerate(core.classes) if record.kind == "coordinator"
        )
        #: The instructions for the youngest frame: the first of each migrating group.
        self.portal_calls = self._portal_calls()
        #: The called method, by instruction.
        self.calls = {pc: quad.a for pc, quad in enumerate(self.program.quads) if quad.op == _CALL}
        #: The methods that reserve resources.
        self.reserve = frozenset(
            i for i, method in enumerate(core.methods) if any(row.kind == RESERVED for row in method.handlers)
        )

    def _portal_calls(self) -> frozenset[int]:
        quads, found = self.program.quads, set()
        for pc, quad in enumerate(quads):
            if quad.op not in _MIGRATING:
                continue
            while quads[pc - 1].op == _PUSH:
                pc -= 1
            found.add(pc)
        return frozenset(found)
