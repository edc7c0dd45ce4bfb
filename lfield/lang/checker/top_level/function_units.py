"""The unit in which a function or the value of a constant is checked: it has no members and sees no unit."""

from __future__ import annotations

from lfield.lang import tree
from lfield.lang.checker.scope import BodyContext, Scope
from lfield.lang.checker.symbols import Symbols
from lfield.lang.types import UNKNOWN
from lfield.text.source_text import Span


def function_unit(name: str, span: Span) -> tree.Unit:
    """A unit without members for the function of that name."""
    return tree.Unit(name, "class", "global", span, function=True)


def constant_context(symbols: Symbols, name: str, span: Span) -> BodyContext:
    """Where the value of a constant is checked: only other declarations of the top level are known."""
    unit = function_unit(name, span)
    method = tree.Method(name, "method", unit, [], UNKNOWN, False, False, span, span)
    return BodyContext(symbols, unit, method, Scope(), function=True)
