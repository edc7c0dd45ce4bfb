"""`async call`: begins one portal call, whose ticket is in a new object of the class of its future.

    gather; pop ^ticket            newarray ^place, T[], 1     (none for a call without result)
    begin                          the call, with its arguments
    launch                         starts it: the coordinator goes to its host
    new ^future; call Future       the object has the ticket, and the array for the result

A method of an offer begins its call by its asynchronous variant (`async_methods`). A realisation with several
steps is executed synchronously.
"""

from __future__ import annotations

from lfield.compiler.call_emitter import CallEmitter
from lfield.compiler.method_frame import MethodFrame
from lfield.lang import types
from lfield.lang.tree import Async, PortalCall
from lfield.lang.types import array_of


class FutureEmitter:
    """The futures of one method."""

    def __init__(self, frame: MethodFrame, calls: CallEmitter) -> None:
        self._frame, self._calls = frame, calls

    def start(self, expr: Async, target: int | None) -> int:
        """Begin the call; the slot of the future."""
        frame, code, tables = self._frame, self._frame.code, self._frame.tables
        ticket = frame.slots.temporary(tables.ticket_type)
        self._calls.push("gather", [])
        code.emit("pop", ticket)
        place = self._place(expr)
        self._collect(expr, ticket, place)
        self._calls.push("launch", [ticket])
        future = frame.slots.temporary(tables.object_type(expr.type.name))
        code.emit("new", future, tables.class_index(expr.type.name))
        self._calls.push("call", [future, ticket, *place], tables.method_index(expr.constructor))
        frame.slots.release(ticket, *place)
        return frame.move_operand(future, expr.type, target)

    def _place(self, expr: Async) -> list[int]:
        """The slot of the array for the result; none if the call has none."""
        frame = self._frame
        if expr.call.type == types.VOID:
            return []
        kind = frame.tables.type_index(array_of(expr.call.type))
        array = frame.slots.temporary(kind)
        frame.code.emit("newarray", array, kind, frame.constant(1))
        return [array]

    def _collect(self, expr: Async, ticket: int, place: list[int]) -> None:
        frame, call = self._frame, expr.call
        element = [*place, frame.constant(0)] if place else [frame.constant(None), frame.constant(0)]
        if isinstance(call, PortalCall):
            operands = self._calls.operands([call.proxy, *call.arguments])
            portal = frame.tables.method_index(call.portal)
            self._calls.push("begin", [ticket, *element, *operands], portal)
        else:
            operands = self._calls.operands([call.object, *call.arguments])
            variant = frame.tables.async_variant(call.method)
            has_place = len(variant.parameters) > len(call.arguments) + 1
            pushed = [*operands, ticket, *(element if has_place else [])]
            self._calls.push("call", pushed, frame.tables.method_index(variant))
        frame.slots.release(*operands)
