"""Parses a capability query: `Lift where payload >= 2.0 order by battery desc limit 5`.

The first part is a primitive by its type in L, or a taxonomy id, which means all primitives there or below.
`where` is followed by the argument of a find in L: a condition over attributes, an order and a limit
(condition_compiler.py). All of these are optional.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct

from lfield.capability.condition_compiler import read_query
from lfield.capability.condition_tree import Mistake
from lfield.capability.model import ANY_OFFER, Expression, OfferQuery, Primitive, Registry
from lfield.capability.registry_reader import messages
from lfield.errors import ProgramError, UsageError
from lfield.operator.registry.taxonomy import primitives_below, term_of
from lfield.text.source_text import Diagnostic, Source, Span
from lfield.text.suggestions import did_you_mean

_QUESTION = re.compile(
    r"\s*(?P<what>\S+)(?:\s+where\b(?P<where>.*)|\s+(?P<how>(?:order\s+by|limit)\b.*))?\s*", re.DOTALL
)

#: The longest question, in characters.
MAX_LENGTH = 4000


class CapabilityQuery(Struct, frozen=True):
    """A query: any of the primitives, with condition and order."""

    text: str
    primitives: tuple[Primitive, ...]
    offer_query: OfferQuery = ANY_OFFER

    @property
    def constraint(self) -> Expression | None:
        """The condition, None for all agents."""
        return self.offer_query.condition


def parse_query(text: str, registry: Registry) -> CapabilityQuery:
    """The query in a text. Raises UsageError for no query, ProgramError with all mistakes in it."""
    if len(text) > MAX_LENGTH:
        raise UsageError(f"a question has at most {MAX_LENGTH} characters, and this one {len(text)}")
    match = _QUESTION.fullmatch(text)
    if match is None:
        raise UsageError('a question is written like "Lift" or "Lift where payload >= 2.0"')
    source = Source("query", text)
    found: list[Diagnostic] = []
    primitives = _primitives(match["what"], Span(source, *match.span("what")), registry, found)
    clause = "where" if match["where"] is not None else "how"
    offers, mistakes = (
        (ANY_OFFER, []) if match[clause] is None else read_query(match[clause], registry.attributes)
    )
    start = match.start(clause)
    found += [_diagnostic(mistake, start, source) for mistake in mistakes]
    if found:
        raise ProgramError(found)
    return CapabilityQuery(text.strip(), tuple(primitives), offers or ANY_OFFER)


def _primitives(
    name: str, place: Span, registry: Registry, diagnostics: list[Diagnostic]
) -> Sequence[Primitive]:
    if name in registry.primitives:
        return [registry.primitives[name]]
    term = term_of(registry, name)
    if term is None:
        hint = did_you_mean(name[:80], [*registry.primitives, *registry.terms])
        hint = hint or "'lfield capabilities tree' lists all terms"
        diagnostics.append(messages.UNKNOWN_PRIMITIVE.at(place, hint=hint, name=name))
        return ()
    below = primitives_below(registry, term.id)
    if not below:
        problem = f"nothing at or below '{term.id}' can be called"
        diagnostics.append(messages.BAD_EXPRESSION.at(place, problem=problem))
    return below


def _diagnostic(mistake: Mistake, start: int, source: Source) -> Diagnostic:
    place = Span(source, start + mistake.start, start + mistake.end)
    return messages.BAD_EXPRESSION.at(place, hint=mistake.hint, problem=mistake.message)
