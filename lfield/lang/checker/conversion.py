"""Which type fits where, and the one conversion L makes by itself: int to real."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import Expr, Literal_, ToReal
from lfield.lang.types import (
    BOOLEAN,
    EXCEPTION,
    INT,
    NULL,
    REAL,
    STRING,
    UNKNOWN,
    ClassType,
    DeviceType,
    Type,
    is_reference,
)
from lfield.text.findings import Message
from lfield.text.source import Span

#: The library function that turns a value of the first type into the second.
_FUNCTIONS = {
    (INT, STRING): "i2s",
    (REAL, STRING): "f2s",
    (BOOLEAN, STRING): "b2s",
    (REAL, INT): "f2i",
    (STRING, INT): "s2i",
    (STRING, REAL): "s2f",
}


def cost(given: Type, wanted: Type) -> int | None:
    """0 when a value fits as it is, 1 when widened (int to real, a class to Exception), None when not."""
    if UNKNOWN in (given, wanted) or given == wanted:
        return 0
    if given == NULL:
        return 0 if is_reference(wanted) and not isinstance(wanted, DeviceType) else None
    widened = (given, wanted) == (INT, REAL) or (wanted == EXCEPTION and isinstance(given, ClassType))
    return 1 if widened else None


def converted(value: Expr, wanted: Type) -> Expr:
    """A value that fits, with the ToReal node if it is widened to real."""
    if value.type == INT and wanted == REAL:
        return ToReal(value.span, REAL, value)
    return value


def expect(
    symbols: Symbols, value: Expr, wanted: Type, message: Message = messages.MISMATCH, **values: object
) -> Expr:
    """The value as the wanted type; when it does not fit, `message` is reported with {wanted} and {given}."""
    if cost(value.type, wanted) is not None:
        return converted(value, wanted)
    hint = conversion_hint(value.type, wanted) or None
    symbols.report(message, value.span, hint=hint, wanted=shown(wanted), given=shown(value.type), **values)
    return unknown(value.span)


def unknown(span: Span) -> Expr:
    """An expression with an error that is reported already."""
    return Literal_(span, UNKNOWN, None)


def conversion_hint(given: Type, wanted: Type) -> str:
    """How to convert by hand, or '' when nothing does."""
    function = _FUNCTIONS.get((given, wanted))
    if function is not None:
        return f"convert it: {function}(...)"
    if wanted == BOOLEAN and given in (INT, REAL):
        return "compare it: ... != 0"
    if given == NULL:
        return f"{wanted} is never null; only objects, arrays, strings and proxies can be"
    return ""


def shown(kind: Type) -> str:
    """A type as messages write it: with its article."""
    name = str(kind)
    if name in ("null", "void"):
        return name
    return f"an {name}" if name[0] in "aeiouAEIO" else f"a {name}"
