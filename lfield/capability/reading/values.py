"""Values, units and expressions over attributes, as they are written: `2.0`, `"50000 g"`, `a.payload / 2`."""

from __future__ import annotations

import math
import re

from lfield.capability import units
from lfield.capability.condition import Mistake
from lfield.capability.matching.expression import WANTED, Scope, Wanted, check, parse
from lfield.capability.model import Attribute, Expression, Value
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft
from lfield.text.source import Span
from lfield.text.suggest import listed
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Listing, Node, Scalar, describe

_AMOUNT = r"[-+]?[0-9]{0,18}\.?[0-9]{1,18}([eE][-+]?[0-9]{1,3})?"
_WITH_UNIT = re.compile(rf"(?P<amount>{_AMOUNT})\s*(?P<unit>[^\s0-9].{{0,40}})")

#: Whole numbers up to here are exact as reals, too.
_MOST = 1 << 53

_EXPECTED = {
    "real": "a number",
    "int": "a whole number",
    "boolean": "true or false",
    "text": "text",
    "set": "a list of texts",
}


def read_values(draft: Draft, fields: Fields) -> dict[str, Value]:
    """Attribute values by name, in the units of their attributes; mistakes are reported and left out."""
    values = {}
    for entry in fields.named():
        attribute = draft.attribute(entry.key, entry.key_span)
        value = _value(draft, attribute, entry) if attribute is not None else None
        if value is not None:
            values[entry.key] = value
    return values


def check_unit(draft: Draft, unit: str, type: str, what: str, span: Span) -> None:
    """Report a canonical unit that is none, that is not SI, or that stands where none can be."""
    if not unit:
        return
    if type not in ("real", "int", "real[]", "int[]"):
        draft.tell(messages.NO_UNIT_HERE, span, what=what, type=type)
    elif not units.known(unit):
        draft.tell(messages.UNKNOWN_UNIT, span, hint=units.suggestion(unit), unit=unit)
    elif not units.is_registry_unit(unit):
        draft.tell(messages.NOT_SI, span, unit=unit, si=units.in_si(unit) or "no unit")


def read_conversion(draft: Draft, given: str, wanted: str, span: Span) -> tuple[float, float]:
    """Factor and offset from one unit to another; (1, 0) after a mistake, which is reported."""
    for unit in (given, wanted):
        if not units.known(unit):
            draft.tell(messages.UNKNOWN_UNIT, span, hint=units.suggestion(unit), unit=unit)
            return 1.0, 0.0
    conversion = units.conversion(given, wanted)
    if conversion is None:
        draft.tell(messages.OTHER_DIMENSION, span, given=given or "1", wanted=wanted or "1")
        return 1.0, 0.0
    return conversion


def _value(draft: Draft, attribute: Attribute, entry: Entry) -> Value | None:
    """The value of an attribute; None when it is of another kind, which is reported."""
    value = _of_type(draft, attribute, entry.value)
    if value is None:
        unit, culprit = attribute.unit, _culprit(attribute, entry.value)
        draft.tell(
            messages.BAD_VALUE,
            culprit.span,
            hint=f'with its unit it is written as "12 {unit}"' if unit else "",
            name=attribute.name,
            expected=_EXPECTED[attribute.type] + (f" in {unit}" if unit else ""),
            given=describe(culprit),
        )
    return value


def _culprit(attribute: Attribute, node: Node) -> Node:
    """What is of the wrong kind: of a list where one is wanted, its first item that is no text."""
    if not isinstance(node, Listing) or attribute.type != "set":
        return node
    return next(item for item in node.items if not _is_text(item))


def _is_text(node: Node) -> bool:
    return isinstance(node, Scalar) and isinstance(node.value, str)


def _of_type(draft: Draft, attribute: Attribute, node: Node) -> Value | None:
    if attribute.type in ("set", "text"):
        return _words(draft, attribute, node)
    if not isinstance(node, Scalar):
        return None
    if attribute.type == "boolean" or isinstance(node.value, bool):
        return node.value if attribute.type == "boolean" and isinstance(node.value, bool) else None
    amount = _amount(draft, attribute, node)
    if amount is None or not math.isfinite(amount):
        return None
    if attribute.type == "real":
        return float(amount)
    return int(amount) if abs(amount) <= _MOST and amount == int(amount) else None


def _amount(draft: Draft, attribute: Attribute, node: Scalar) -> float | None:
    """A number in the attribute's unit, or text with a unit of its own."""
    if not isinstance(node.value, str):
        return node.value
    match = _WITH_UNIT.fullmatch(node.value)
    if match is None:
        return None
    factor, offset = read_conversion(draft, match["unit"], attribute.unit, node.span)
    return float(match["amount"]) * factor + offset


def _words(draft: Draft, attribute: Attribute, node: Node) -> Value | None:
    """A text, or the members of a set; one member may stand without a list."""
    nodes = node.items if isinstance(node, Listing) and attribute.type == "set" else (node,)
    words = []
    for item in nodes:
        if not isinstance(item, Scalar) or not isinstance(item.value, str):
            return None
        words.append(item.value)
        _check_member(draft, attribute, item.value, item.span)
    return frozenset(words) if attribute.type == "set" else words[0]


def _check_member(draft: Draft, attribute: Attribute, word: str, span: Span) -> None:
    if attribute.values and word not in attribute.values:
        hint = draft.like(word, attribute.values)
        known = listed(attribute.values)
        draft.tell(messages.NOT_A_MEMBER, span, hint=hint, value=word, name=attribute.name, values=known)


# --- expressions ---------------------------------------------------------------------------------------


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
