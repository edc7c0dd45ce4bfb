"""try and catch: rows of handlers, no instructions on the way that goes well (chapter V)."""

from __future__ import annotations

from collections.abc import Callable

from lfield.bytecode.program import Handler
from lfield.compiler.code import Label
from lfield.compiler.frame import Frame
from lfield.lang.tree import Catch, Stmt, Try


def compile_try(frame: Frame, stmt: Try, block: Callable[[list[Stmt]], None]) -> None:
    """Protect the body with one handler per catch.

    An inner try adds its rows before the outer one, so the innermost handler is found first; and no catch
    lies in the range that it serves.
    """
    start = frame.code.position
    block(stmt.body)
    end = frame.code.position
    if start == end:
        return
    after = Label()
    for catch in stmt.catches:
        frame.code.jump("jmp", after)
        _compile_catch(frame, catch, start, end, block)
    frame.code.place(after)


def _compile_catch(
    frame: Frame, catch: Catch, start: int, end: int, block: Callable[[list[Stmt]], None]
) -> None:
    with frame.slots.scope():
        slot, _ = frame.slots.declare(catch.local, frame.tables.type_index(catch.local.type))
        caught = frame.tables.class_index(catch.local.type.name)
        frame.handlers.append(Handler(start, end, frame.code.position, caught, slot))
        frame.code.place(Label(), entered=True)
        block(catch.body)
