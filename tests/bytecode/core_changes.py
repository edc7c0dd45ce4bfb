"""Changes of the core of a compiled program, each of which makes it unsound in one way."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Core, Program, Quad, encode_quads
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError

Change = Callable[[Core], Core]
_PUSH = BY_NAME["push"].code


def change_class(index: int, **fields: object) -> Change:
    return lambda core: _with_record(core, "classes", index, fields)


def change_method(index: int, **fields: object) -> Change:
    return lambda core: _with_record(core, "methods", index, fields)


def _with_record(core: Core, part: str, index: int, fields: dict[str, object]) -> Core:
    records = list(getattr(core, part))
    records[index] = msgspec.structs.replace(records[index], **fields)
    return msgspec.structs.replace(core, **{part: tuple(records)})


def position(quads: list[Quad], name: str, which: int = 0) -> int:
    """The index of an instruction of this name: the first one, or the one number `which`."""
    return [pc for pc, quad in enumerate(quads) if quad.op == BY_NAME[name].code][which]


class SoundCode:
    """The code of a sound program, and changes of it."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.debug = msgspec.structs.replace(program.debug, methods=())

    def accepted(self, change: Change) -> None:
        verify(Program(change(self.program.core), self.debug, b""))

    def refused(self, change: Change, reason: str) -> None:
        core = change(self.program.core)
        with pytest.raises(ProgramFileError, match=reason):
            verify(Program(core, self.debug, b""))

    def change(self, change: Callable[[list[Quad]], None]) -> Change:
        def changed(core: Core) -> Core:
            quads = list(self.program.quads)
            change(quads)
            return msgspec.structs.replace(core, code=encode_quads(quads))

        return changed

    def put(self, place: str | int, name: str, a: int = 0, *, after: int = 0) -> Change:
        """Replace an instruction: `after` instructions after an index, or after the first one of a name."""

        def change(quads: list[Quad]) -> None:
            at = place if isinstance(place, int) else position(quads, place)
            quads[at + after] = Quad(BY_NAME[name].code, a, 0, 0)

        return self.change(change)

    def push(self, name: str, back: int, operand: int, which: int = 0) -> Change:
        """Change the operand of the push that is `back` instructions before an instruction."""

        def change(quads: list[Quad]) -> None:
            pc = position(quads, name, which) - back
            assert quads[pc].op == _PUSH
            quads[pc] = Quad(_PUSH, operand, 0, 0)

        return self.change(change)

    def with_slot(self, name: str, distance: int, kind: int) -> Change:
        """Make the push or pop at a distance from an instruction use a new slot of another type."""

        def changed(core: Core) -> Core:
            quads = list(self.program.quads)
            pc = position(quads, name) + distance
            index, method = next((i, m) for i, m in enumerate(core.methods) if m.entry <= pc < m.end)
            assert quads[pc].op == BY_NAME["push" if distance < 0 else "pop"].code
            core = change_method(index, slots=(*method.slots, kind))(core)
            return self.put(pc, "push" if distance < 0 else "pop", len(method.slots))(core)

        return changed
