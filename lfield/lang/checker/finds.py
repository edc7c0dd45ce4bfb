"""`findR(...)` of a resource; `findC(...)`, `explainC(...)`, `teamsC(..., n)` of a capability: who offers."""

from __future__ import annotations

from lfield.lang import messages, syntax, tree
from lfield.lang.capabilities import Verb
from lfield.lang.checker.fitting import Candidate, choose, unknown
from lfield.lang.checker.scope import Body
from lfield.lang.checker.symbols import describe
from lfield.lang.types import INT, STRING, ClassType, ResourceType, Type, array_of
from lfield.text.source import Span


def find_resource(
    body: Body, raw: syntax.Call, place: Span, resource: tree.Unit, given: list[tree.Expr]
) -> tree.Expr:
    """`findR(id)` or `findR()`; only where resources are visible."""
    if body.unit.usage != "coordinator":
        body.report(messages.FIND_PLACE, place, viewer=describe(body.unit), what="resources")
        return unknown(raw.span)
    proxy = ResourceType(resource.name)
    name = f"find{resource.name}"
    candidates: list[Candidate[Type]] = [
        Candidate(name, (STRING,), proxy),
        Candidate(name, (), array_of(proxy)),
    ]
    chosen = choose(body.symbols, place, candidates, given)
    if chosen is None:
        return unknown(raw.span)
    kind, arguments = chosen
    return tree.Find(raw.span, kind, resource, arguments[0] if arguments else None)


def names_of_finds(body: Body) -> list[str]:
    """The names of all methods that find something in this program, for hints."""
    capabilities = body.symbols.capability_names()
    found = [f"find{name}" for name in (*body.symbols.resource_names(), *capabilities)]
    return [*found, *(f"{verb}{name}" for name in capabilities for verb in ("explain", "teams"))]


def ask(
    body: Body, raw: syntax.Call, place: Span, verb: Verb, capability: tree.Unit, given: list[tree.Expr]
) -> tree.Expr:
    """A query with or without a constraint, where capabilities are visible."""
    if body.unit.usage != "coordinator":
        body.report(messages.FIND_PLACE, place, viewer=describe(body.unit), what="capabilities")
        return unknown(raw.span)
    offers = array_of(ClassType(capability.name))
    result: Type = {"find": offers, "teams": array_of(offers), "explain": STRING}[verb]
    name, size = f"{verb}{capability.name}", (INT,) if verb == "teams" else ()
    candidates = [Candidate(name, (STRING, *size), result), Candidate(name, size, result)]
    chosen = choose(body.symbols, place, candidates, given)
    if chosen is None:
        return unknown(raw.span)
    asked = chosen[1][: len(chosen[1]) - len(size)]
    constraint = asked[0] if asked else None
    if isinstance(constraint, tree.Literal_) and isinstance(constraint.value, str):
        _check(body, constraint.span, constraint.value)
    return tree.Query(raw.span, result, capability, constraint, verb, chosen[1][-1] if size else None)


def _check(body: Body, literal: Span, text: str) -> None:
    """Report what is wrong with a constraint, at the very characters.

    Where escapes stand in the text its characters are not those of the file: then the whole text is meant.
    """
    assert body.symbols.capabilities is not None
    as_written = literal.text == f'"{text}"'
    for mistake in body.symbols.capabilities.mistakes(text):
        first = literal.start + 1
        inside = Span(literal.source, first + mistake.start, first + mistake.end)
        where = inside if as_written else literal
        body.report(messages.CONSTRAINT, where, hint=mistake.hint, problem=mistake.message)
