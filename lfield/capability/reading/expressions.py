"""Conditions and values over attributes, as they stand in YAML: every mistake is shown within the scalar."""

from __future__ import annotations

from lfield.capability.condition import Mistake
from lfield.capability.matching.expression import WANTED, Scope, Wanted, check, parse
from lfield.capability.model import Attribute, Expression
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft
from lfield.text.source import Span
from lfield.text.yaml_source import Node, Scalar, describe


def read_expression(draft: Draft, node: Node | None, scope: Scope, wanted: Wanted) -> Expression | None:
    """The expression in a scalar, None when there is none or it has mistakes, which are reported.

    A number or a truth stands for itself: `payload: 2.0` is the expression `2.0`.
    """
    if node is None:
        return None
    if not isinstance(node, Scalar) or node.value is None:
        problem = f"an expression is text, not {describe(node)}"
        draft.tell(messages.BAD_EXPRESSION, node.span, problem=problem)
        return None
    text = node.value if isinstance(node.value, str) else node.span.text
    expression, mistakes = parse(text)
    if expression is not None:
        mistakes = check(expression, scope, wanted)
    for mistake in mistakes:
        span = _within(node.span, text, mistake)
        draft.tell(messages.BAD_EXPRESSION, span, hint=mistake.hint, problem=mistake.message)
    return expression if not mistakes else None


def read_attribute_expression(
    draft: Draft, node: Node | None, scope: Scope, attribute: Attribute
) -> Expression | None:
    """The expression for the value of an attribute of a whole, from those of its parts."""
    return read_expression(draft, node, scope, WANTED[attribute.type])


def _within(scalar: Span, text: str, mistake: Mistake) -> Span:
    """The characters of a mistake in the file; the whole scalar where it is folded or has escapes."""
    written = scalar.text
    shift = next((at for at in (0, 1) if written[at : at + len(text)] == text), None)
    if shift is None:
        return scalar
    start = scalar.start + shift + mistake.start
    return Span(scalar.source, start, max(start + 1, scalar.start + shift + mistake.end))
