"""Values, units and expressions over attributes, as they are written: `2.0`, `"50000 g"`, `a.payload / 2`."""

from __future__ import annotations

import math
import re

from lfield import units
from lfield.capability.condition_compiler import parse_expression
from lfield.capability.condition_tree import Mistake
from lfield.capability.matching.condition_checker import (
    EXPECTATIONS,
    Expectation,
    NameScope,
    check_expression,
)
from lfield.capability.model import Attribute, Expression, Value
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.registry_builder import RegistryBuilder
from lfield.text.source_text import Span
from lfield.text.suggestions import listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlList, YamlNode, YamlScalar, describe

_AMOUNT = r"[-+]?[0-9]{0,18}\.?[0-9]{1,18}([eE][-+]?[0-9]{1,3})?"
_WITH_UNIT = re.compile(rf"(?P<amount>{_AMOUNT})\s*(?P<unit>[^\s0-9].{{0,40}})")

#: Whole numbers up to here are exact as reals, too.
_MAX_INTEGER = 1 << 53

_EXPECTED = {
    "real": "a number",
    "int": "a whole number",
    "boolean": "true or false",
    "text": "text",
    "set": "a list of texts",
}


def read_values(builder: RegistryBuilder, fields: YamlFields) -> dict[str, Value]:
    """Attribute values by name, in the units of their attributes; mistakes are reported and left out."""
    values = {}
    for entry in fields.named():
        attribute = builder.attribute(entry.key, entry.key_span)
        value = _value(builder, attribute, entry) if attribute is not None else None
        if value is not None:
            values[entry.key] = value
    return values


def check_unit(builder: RegistryBuilder, unit: str, type: str, subject: str, span: Span) -> None:
    """Report a canonical unit that is unknown, not SI, or not allowed here."""
    if not unit:
        return
    if type not in ("real", "int", "real[]", "int[]"):
        builder.report(messages.NO_UNIT_HERE, span, what=subject, type=type)
    elif not units.is_unit(unit):
        builder.report(messages.UNKNOWN_UNIT, span, hint=units.suggestion(unit), unit=unit)
    elif not units.is_registry_unit(unit):
        builder.report(messages.NOT_SI, span, unit=unit, si=units.in_si(unit) or "no unit")


def read_conversion(
    builder: RegistryBuilder, unit_given: str, expected: str, span: Span
) -> tuple[float, float]:
    """Factor and offset from one unit to another; (1, 0) after a mistake, which is reported."""
    for unit in (unit_given, expected):
        if not units.is_unit(unit):
            builder.report(messages.UNKNOWN_UNIT, span, hint=units.suggestion(unit), unit=unit)
            return 1.0, 0.0
    conversion = units.conversion(unit_given, expected)
    if conversion is None:
        builder.report(messages.OTHER_DIMENSION, span, given=unit_given or "1", expected=expected or "1")
        return 1.0, 0.0
    return conversion


def _value(builder: RegistryBuilder, attribute: Attribute, entry: YamlEntry) -> Value | None:
    """The value of an attribute; None when it is of another kind, which is reported."""
    value = _of_type(builder, attribute, entry.value)
    if value is None:
        unit, culprit = attribute.unit, _wrong_node(attribute, entry.value)
        builder.report(
            messages.BAD_VALUE,
            culprit.span,
            hint=f'with its unit it is written as "12 {unit}"' if unit else "",
            name=attribute.name,
            expected=_EXPECTED[attribute.type] + (f" in {unit}" if unit else ""),
            given=describe(culprit),
        )
    return value


def _wrong_node(attribute: Attribute, node: YamlNode) -> YamlNode:
    """The value of the wrong type: in a list of texts the first item that is not text."""
    if not isinstance(node, YamlList) or attribute.type != "set":
        return node
    return next(item for item in node.items if not _is_text(item))


def _is_text(node: YamlNode) -> bool:
    return isinstance(node, YamlScalar) and isinstance(node.value, str)


def _of_type(builder: RegistryBuilder, attribute: Attribute, node: YamlNode) -> Value | None:
    if attribute.type in ("set", "text"):
        return _text_or_set(builder, attribute, node)
    if not isinstance(node, YamlScalar):
        return None
    if attribute.type == "boolean" or isinstance(node.value, bool):
        return node.value if attribute.type == "boolean" and isinstance(node.value, bool) else None
    amount = _amount(builder, attribute, node)
    if amount is None or not math.isfinite(amount):
        return None
    if attribute.type == "real":
        return float(amount)
    return int(amount) if abs(amount) <= _MAX_INTEGER and amount == int(amount) else None


def _amount(builder: RegistryBuilder, attribute: Attribute, node: YamlScalar) -> float | None:
    """A number in the attribute's unit, or text with a unit of its own."""
    if not isinstance(node.value, str):
        return node.value
    match = _WITH_UNIT.fullmatch(node.value)
    if match is None:
        return None
    factor, offset = read_conversion(builder, match["unit"], attribute.unit, node.span)
    return float(match["amount"]) * factor + offset


def _text_or_set(builder: RegistryBuilder, attribute: Attribute, node: YamlNode) -> Value | None:
    """A text, or the members of a set; a single member needs no list."""
    nodes = node.items if isinstance(node, YamlList) and attribute.type == "set" else (node,)
    values = []
    for item in nodes:
        if not isinstance(item, YamlScalar) or not isinstance(item.value, str):
            return None
        values.append(item.value)
        _check_member(builder, attribute, item.value, item.span)
    return frozenset(values) if attribute.type == "set" else values[0]


def _check_member(builder: RegistryBuilder, attribute: Attribute, member: str, span: Span) -> None:
    if attribute.values and member not in attribute.values:
        hint = builder.similar_name(member, attribute.values)
        known = listed(attribute.values)
        builder.report(
            messages.NOT_A_MEMBER, span, hint=hint, value=member, name=attribute.name, values=known
        )


# --- expressions ---------------------------------------------------------------------------------------


def read_expression(
    builder: RegistryBuilder, node: YamlNode | None, scope: NameScope, expected: Expectation
) -> Expression | None:
    """The expression in a scalar, None when there is none or it has mistakes, which are reported.

    A number or boolean is itself: `payload: 2.0` is the expression `2.0`.
    """
    if node is None:
        return None
    if not isinstance(node, YamlScalar) or node.value is None:
        problem = f"an expression is text, not {describe(node)}"
        builder.report(messages.BAD_EXPRESSION, node.span, problem=problem)
        return None
    text = node.value if isinstance(node.value, str) else node.span.text
    expression, mistakes = parse_expression(text)
    if expression is not None:
        mistakes = check_expression(expression, scope, expected)
    for mistake in mistakes:
        span = _within(node.span, text, mistake)
        builder.report(messages.BAD_EXPRESSION, span, hint=mistake.hint, problem=mistake.message)
    return expression if not mistakes else None


def read_attribute_expression(
    builder: RegistryBuilder, node: YamlNode | None, scope: NameScope, attribute: Attribute
) -> Expression | None:
    """The expression for the value of an attribute of a whole, from those of its parts."""
    return read_expression(builder, node, scope, EXPECTATIONS[attribute.type])


def _within(scalar: Span, text: str, mistake: Mistake) -> Span:
    """The characters of a mistake in the file; the whole scalar where it is folded or has escapes."""
    written = scalar.text
    shift = next((at for at in (0, 1) if written[at : at + len(text)] == text), None)
    if shift is None:
        return scalar
    start = scalar.start + shift + mistake.start
    return Span(scalar.source, start, max(start + 1, scalar.start + shift + mistake.end))
