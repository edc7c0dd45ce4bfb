"""Rules and hints for calls of functions of the library.

A function that waits has a limit, so that no program waits for a person or a host that never answers. A
constant that leaves no time for any event is a mistake, as for a `within`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield.lang import messages
from lfield.lang.checker.scope import BodyContext
from lfield.lang.tree import Expr, Literal_, Negate, ToReal
from lfield.lang.types import BOOLEAN, INT, REAL, STRING, Type

#: The functions that wait at most for a time, their last argument, each with an example.
_WAITING = {
    "read": "read(30.0)",
    "start": 'start("patrol", 10.0)',
    "stop": 'stop("patrol", 10.0)',
    "awaitEnd": 'awaitEnd("patrol", 60.0)',
    "running": 'running("patrol", 5.0)',
}
#: The functions that convert to text.
_TO_TEXT: dict[Type, str] = {INT: "i2s", REAL: "f2s", BOOLEAN: "b2s", STRING: ""}


def check_limit(body: BodyContext, name: str, arguments: Sequence[Expr]) -> None:
    """Report a constant limit that leaves no time for any event."""
    if name not in _WAITING:
        return
    seconds = _constant(arguments[-1])
    if seconds is not None and not seconds > 0:
        text = "no number (NaN)" if math.isnan(seconds) else f"{seconds:g}"
        body.report(messages.LIMIT_OVER, arguments[-1].span, name=name, given=text, example=_WAITING[name])


def _constant(expr: Expr) -> float | None:
    """The number that a literal is, with its sign; None for any other expression."""
    match expr:
        case Literal_(value=int() | float() as number):
            return float(number)
        case ToReal():
            return _constant(expr.operand)
        case Negate():
            found = _constant(expr.operand)
            return None if found is None else -found
    return None


def output_hint(name: str, arguments: Sequence[Expr]) -> str | None:
    """The hint for `print("n", n)` of Python: one text, each argument converted; and for `read()` without its
    limit. None for other calls."""
    if name == "read" and not arguments:
        return "write how many seconds it waits at most, as in read(30.0)"
    if name not in ("print", "write") or len(arguments) == 1:
        return None
    parts = []
    for argument in arguments:
        if argument.type not in _TO_TEXT:
            return 'join text with +, as in "n is " + i2s(n)'
        function = _TO_TEXT[argument.type]
        parts.append(f"{function}({argument.span.text})" if function else argument.span.text)
    text = " + ".join(parts) or '""'
    return f"write {name}({text})"
