"""Conditions and queries from their text: parsed, then checked against the attributes of a registry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lfield.capability import condition_parser
from lfield.capability.condition_tree import Mistake
from lfield.capability.matching.condition_checker import NameScope, check_expression
from lfield.capability.model import Attribute, Expression, OfferQuery, SortKey
from lfield.capability.query_values import SEPARATOR, standalone
from lfield.errors import ConstraintError


def compile_constraint(text: str, attributes: Mapping[str, Attribute]) -> Expression:
    """A condition over the attributes of one offer. Raises ConstraintError with all mistakes."""
    expression, mistakes = parse_expression(text)
    if expression is not None:
        mistakes = check_expression(expression, NameScope.of_offer(attributes), "boolean")
    if expression is None or mistakes:
        raise _constraint_error(text, mistakes)
    return expression


def compile_query(text: str, attributes: Mapping[str, Attribute]) -> OfferQuery:
    """A query over the attributes of offers. Raises ConstraintError with all mistakes."""
    query, mistakes = read_query(text, attributes)
    if query is None or mistakes:
        raise _constraint_error(text, mistakes)
    return query


def compile_template(text: str, attributes: Mapping[str, Attribute]) -> OfferQuery:
    """A compiled query whose values are not bound yet. Raises ConstraintError."""
    query, mistakes = read_query(text, attributes, parameters=True)
    if query is None or mistakes:
        raise _constraint_error(text, mistakes)
    return query


def read_query(
    text: str, attributes: Mapping[str, Attribute], *, parameters: bool = False
) -> tuple[OfferQuery | None, list[Mistake]]:
    """The query in a text, or None and all mistakes.

    With `parameters`, the text is a compiled query, with `$n0` for the first value.
    """
    written, mistakes = condition_parser.parse_query(text, parameters=parameters)
    if written is None:
        return None, mistakes
    scope = NameScope.of_offer(attributes)
    wished = written.condition
    condition = None if wished is None else Expression(written.text, wished)
    if condition is not None:
        mistakes += check_expression(condition, scope, "boolean")
    for tree, _ in written.order:
        mistakes += check_expression(Expression(tree.span.text, tree), scope, "number")
    keys = tuple(SortKey(standalone(tree), descending) for tree, descending in written.order)
    return (None if mistakes else OfferQuery(condition, keys, written.limit)), mistakes


def _constraint_error(text: str, mistakes: list[Mistake]) -> ConstraintError:
    excerpt = text if len(text) <= 80 else f"{text[:77]}..."
    return ConstraintError(excerpt, [str(mistake) for mistake in mistakes])


def _compiled(text: str, attributes: Mapping[str, Attribute]) -> OfferQuery | None:
    query = text.removesuffix(SEPARATOR)
    return read_query(query, attributes, parameters=query != text)[0]


def parse_expression(text: str) -> tuple[Expression | None, list[Mistake]]:
    """Parses an expression without resolving its names; returns None and the errors if it is invalid."""
    tree, mistakes = condition_parser.parse_condition(text)
    return (None if tree is None else Expression(text, tree)), mistakes


def compile_constants(
    constants: Iterable[object], attributes: Mapping[str, Attribute]
) -> dict[str, OfferQuery]:
    """The constants of a program that are valid queries, compiled. Other texts are left out.

    A text that ends with a SEPARATOR is a query with parameters.
    """
    texts = (constant for constant in constants if isinstance(constant, str))
    found = ((text, _compiled(text, attributes)) for text in sorted(texts))
    return {text: query for text, query in found if query is not None}
