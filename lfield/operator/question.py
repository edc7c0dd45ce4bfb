"""A question to the registry in one text: `Lift where payload >= 2.0 order by battery desc limit 5`.

First stands a primitive by its type in L, or an id of the taxonomy, which asks for everything that can be
called there or below. Behind `where` stands what a find of L takes: a condition over attributes, what to
order by, and how many are wanted (matching/expression.py). All of that may be left out.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from lfield.capability.condition import Mistake
from lfield.capability.matching.expression import read_wish
from lfield.capability.model import ANYBODY, Expression, Primitive, Registry, Wish
from lfield.capability.reading import messages
from lfield.errors import ProgramError, UsageError
from lfield.operator.registry.taxonomy import primitives_below, term_of
from lfield.text.source import Diagnostic, Source, Span
from lfield.text.suggest import did_you_mean

_QUESTION = re.compile(
    r"\s*(?P<what>\S+)(?:\s+where\b(?P<where>.*)|\s+(?P<how>(?:order\s+by|limit)\b.*))?\s*", re.DOTALL
)

#: The longest question, in characters.
MAX_LENGTH = 4000


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked for: any of the primitives, as is wished."""

    text: str
    primitives: tuple[Primitive, ...]
    wish: Wish = ANYBODY

    @property
    def constraint(self) -> Expression | None:
        """The condition, None when everybody will do."""
        return self.wish.condition


def read_question(text: str, registry: Registry) -> Question:
    """The question in a text. Raises UsageError when it is none, ProgramError with all mistakes in it."""
    if len(text) > MAX_LENGTH:
        raise UsageError(f"a question has at most {MAX_LENGTH} characters, and this one {len(text)}")
    match = _QUESTION.fullmatch(text)
    if match is None:
        raise UsageError('a question is written like "Lift" or "Lift where payload >= 2.0"')
    source = Source("query", text)
    found: list[Diagnostic] = []
    primitives = _primitives(match["what"], Span(source, *match.span("what")), registry, found)
    asked = "where" if match["where"] is not None else "how"
    wish, mistakes = (ANYBODY, []) if match[asked] is None else read_wish(match[asked], registry.attributes)
    start = match.start(asked)
    found += [_diagnostic(mistake, start, source) for mistake in mistakes]
    if found:
        raise ProgramError(found)
    return Question(text.strip(), tuple(primitives), wish or ANYBODY)


def _primitives(what: str, place: Span, registry: Registry, found: list[Diagnostic]) -> Sequence[Primitive]:
    if what in registry.primitives:
        return [registry.primitives[what]]
    term = term_of(registry, what)
    if term is None:
        hint = did_you_mean(what[:80], [*registry.primitives, *registry.terms])
        hint = hint or "'lfield capabilities tree' shows what there is"
        found.append(messages.UNKNOWN_PRIMITIVE.at(place, hint=hint, name=what))
        return ()
    below = primitives_below(registry, term.id)
    if not below:
        problem = f"nothing at or below '{term.id}' can be called"
        found.append(messages.BAD_EXPRESSION.at(place, problem=problem))
    return below


def _diagnostic(mistake: Mistake, start: int, source: Source) -> Diagnostic:
    place = Span(source, start + mistake.start, start + mistake.end)
    return messages.BAD_EXPRESSION.at(place, hint=mistake.hint, problem=mistake.message)
