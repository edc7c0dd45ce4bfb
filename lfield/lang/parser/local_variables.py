"""Declarations of local variables, and the heads of the two forms of `for`."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.foreign.foreign_syntax import each_hint, local_method
from lfield.lang.parser.token_stream import TokenStream
from lfield.lang.parser.type_names import at_declaration, misplaced_brackets, type_name
from lfield.lang.syntax import BAD_TYPE, Bad, Declare, Each, Empty, Evaluate, Expr, For, Stmt, TypeName
from lfield.text.source_text import Span


def declaration(s: TokenStream) -> Stmt:
    """`T name` or `T name = value`, without its `;`."""
    declared = type_name(s, "a variable")
    name = s.expect_name("a name for the variable")
    misplaced_brackets(s, declared, name.text)
    value = initial_value(s, declared)
    if s.at(",") and s.ahead(1).kind is name.kind:
        raise s.fail(messages.ONE_VARIABLE)
    if s.at("("):
        raise local_method(s, declared, name.text)
    return Declare(declared.span.to(s.previous.span), declared, name.text, name.span, value)


def initial_value(s: TokenStream, declared: TypeName) -> Expr | None:
    """`= value`, if present. The value of a foreign type is skipped: the type is reported."""
    if not s.accept("="):
        return None
    if declared.name != BAD_TYPE:
        return expression(s)
    depth, start = 0, s.current.span
    while not (s.at_end() or (depth == 0 and s.at(";", "}", ")"))):
        depth += {"(": 1, "{": 1, ")": -1, "}": -1}.get(s.advance().text, 0)
    return Bad(start, 1)


def evaluated(s: TokenStream) -> Stmt:
    """An expression as a statement, without its `;`."""
    value = expression(s)
    return Evaluate(value.span, value)


def counting_for(s: TokenStream, where: Span, start: Stmt | None) -> For:
    """`start; condition; step`, after the start."""
    s.expect(";")
    condition = None if s.at(";") else expression(s)
    s.expect(";")
    return For(where, start, condition, None if s.at(")") else evaluated(s), Empty(where))


def each(s: TokenStream, where: Span, start: Stmt | None) -> Each:
    """`T name : array`, after the name."""
    if not s.at(":"):
        declared = (start.name, s.ahead(1).text, str(start.type)) if isinstance(start, Declare) else ()
        raise s.fail(messages.FOREIGN_KEYWORD, keyword=s.current.text, instead=each_hint(*declared))
    if not isinstance(start, Declare) or start.value is not None:
        raise s.fail(messages.EXPECTED_SYMBOL, hint=each_hint(), what="';'", found=s.current)
    s.advance()
    return Each(where, start.type, start.name, start.place, expression(s), Empty(where))


def for_start(s: TokenStream) -> Stmt | None:
    """The tokens before the first `;` or the `:` of a `for`; None without any."""
    if s.at(";"):
        return None
    if not at_declaration(s):
        return evaluated(s)
    return declaration(s)
