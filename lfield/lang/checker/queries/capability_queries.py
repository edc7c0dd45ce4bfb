"""Calls of `findC`, `teamsC` and `explainC` of a capability C, and the check of their conditions."""

from __future__ import annotations

import re

from lfield.lang import messages, syntax, tree
from lfield.lang.capability_port import Verb
from lfield.lang.checker.conversions import OverloadCandidate, choose_overload, unknown
from lfield.lang.checker.queries.query_parameters import is_variable, with_parameters
from lfield.lang.checker.queries.query_text import QueryText, query_text, text_pieces
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import describe
from lfield.lang.types import INT, STRING, ClassType, Type, array_of
from lfield.text.source_text import Span

_PLACEHOLDER = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)


def check_query(
    body: BodyContext,
    raw: syntax.Call,
    place: Span,
    verb: Verb,
    capability: tree.Unit,
    arguments: list[tree.Expr],
) -> tree.Expr:
    """A query with or without a constraint, where capabilities are visible."""
    if body.unit.usage != "coordinator":
        body.report(messages.FIND_PLACE, place, viewer=describe(body.unit), what="capabilities")
        return unknown(raw.span)
    offers = array_of(ClassType(capability.name))
    result: Type = {"find": offers, "teams": array_of(offers), "explain": STRING}[verb]
    name, size = f"{verb}{capability.name}", (INT,) if verb == "teams" else ()
    candidates = [OverloadCandidate(name, (STRING, *size), result), OverloadCandidate(name, size, result)]
    chosen = choose_overload(body.symbols, place, candidates, arguments)
    if chosen is None:
        return unknown(raw.span)
    types = chosen[1][: len(chosen[1]) - len(size)]
    constraint = types[0] if types else None
    if isinstance(constraint, tree.Literal_) and not str(constraint.value).strip():
        rest = chosen[1][-1].span.text if size else ""
        more = f", {rest}" if size else ""
        body.report(messages.EMPTY_CONDITION, constraint.span, name=name, rest=rest, more=more)
    elif constraint is not None:
        constraint = _checked(body, raw, constraint)
    return tree.Query(raw.span, result, capability, constraint, verb, chosen[1][-1] if size else None)


def _checked(body: BodyContext, raw: syntax.Call, constraint: tree.Expr) -> tree.Expr:
    """The argument of a query: checked, if its text is known, and with the values of its placeholders."""
    query = query_text(constraint)
    if query is None:
        _report_computed(body, constraint)
        return constraint
    if "$" in query.text and (text := with_parameters(body, raw, query)) is not None:
        return text
    is_joined = len(query.pieces) > 1
    if is_joined and all(piece.span.text.startswith('"') for _, piece in query.pieces):
        return constraint  # A sum of literals is checked when it is asked, as in programs of 0.4.
    _check(body, query)
    return tree.Literal_(constraint.span, STRING, query.text) if is_joined else constraint


def _check(body: BodyContext, query: QueryText) -> None:
    """Report the mistakes in a constraint, at their characters."""
    assert body.symbols.capabilities is not None
    for mistake in body.symbols.capabilities.mistakes(query.text):
        where = query.place(mistake.start, mistake.end)
        body.report(messages.CONSTRAINT, where, hint=mistake.hint, problem=mistake.message)


def _report_computed(body: BodyContext, constraint: tree.Expr) -> None:
    """Report a placeholder in a part of a text that is computed when the program runs."""
    for piece in text_pieces(constraint):
        if not isinstance(piece, tree.Literal_) or not isinstance(piece.value, str):
            continue
        for match in _PLACEHOLDER.finditer(piece.value):
            if is_variable(body, match[1]):
                where = QueryText(piece.value, ((0, piece),)).place(*match.span())
                body.report(messages.COMPUTED_QUERY, where, name=match[1])
