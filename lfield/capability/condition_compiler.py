"""Conditions and queries from their text: parsed, then checked against the attributes of a registry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lfield.capability import condition_parser
from lfield.capability.condition_tree import Mistake
from lfield.capability.matching.condition_checker import NameScope, check_expression
from lfield.capability.model import Attribute, Expression, OfferQuery, SortKey
from lfield.errors import ConstraintError


def compile_constraint(text: str, attributes: Mapping[str, Attribute]) -> Expression:
    """A condition over the attributes of one offer. Raises ConstraintError with everything wrong in it."""
    expression, mistakes = parse_expression(text)
    if expression is not None:
        mistakes = check_expression(expression, NameScope.of_offer(attributes), "boolean")
    if expression is None or mistakes:
        raise _constraint_error(text, mistakes)
    return expression


def compile_query(text: str, attributes: Mapping[str, Attribute]) -> OfferQuery:
    """A wish over the attributes of offers. Raises ConstraintError with everything wrong in it."""
    question, mistakes = read_query(text, attributes)
    if question is None or mistakes:
        raise _constraint_error(text, mistakes)
    return question


def read_query(text: str, attributes: Mapping[str, Attribute]) -> tuple[OfferQuery | None, list[Mistake]]:
    """The wish in a text, or None and everything wrong in it."""
    written, mistakes = condition_parser.parse_query(text)
    if written is None:
        return None, mistakes
    scope = NameScope.of_offer(attributes)
    wished = written.condition
    condition = None if wished is None else Expression(written.text, wished)
    keys = tuple(SortKey(Expression(tree.span.text, tree), descending) for tree, descending in written.order)
    if condition is not None:
        mistakes += check_expression(condition, scope, "boolean")
    for key in keys:
        mistakes += check_expression(key.value, scope, "number")
    return (None if mistakes else OfferQuery(condition, keys, written.limit)), mistakes


def _constraint_error(text: str, mistakes: list[Mistake]) -> ConstraintError:
    shown = text if len(text) <= 80 else f"{text[:77]}..."
    return ConstraintError(shown, [str(mistake) for mistake in mistakes])


def parse_expression(text: str) -> tuple[Expression | None, list[Mistake]]:
    """Parses an expression without resolving its names; returns None and the errors if it is invalid."""
    tree, mistakes = condition_parser.parse_condition(text)
    return (None if tree is None else Expression(text, tree)), mistakes


def compile_constants(
    constants: Iterable[object], attributes: Mapping[str, Attribute]
) -> dict[str, OfferQuery]:
    """Those constants of a program that are valid queries, compiled. Other texts are left out."""
    texts = (constant for constant in constants if isinstance(constant, str))
    found = ((text, read_query(text, attributes)[0]) for text in sorted(texts))
    return {text: query for text, query in found if query is not None}
