"""The mapping of canonical portals to others: the `portals` of a provider's `serves` and of one-to-one rules.

```yaml
portals:
  lift: {portal: reel, arguments: [{parameter: height, unit: mm}, 0.2], emit: {unit: mm}}
  stop: halt                         # the same parameters, under another name
```
An argument is the name of a canonical parameter, a number, true or false, `{parameter: height, unit: mm}`
with the unit that the target needs, or `{constant: "text"}`. `emit` is the unit in which the target emits,
`{unit: mm}`, or a replacement of the result: `{parameter: height}` or `{constant: 1.0}`. A portal without a
mapping is served by the one of the same name with the same parameters.
"""

from __future__ import annotations

from lfield.capability.model import Argument, Portal, PortalMap, Primitive
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attribute_values import read_conversion
from lfield.capability.registry_reader.registry_builder import PORTAL, RegistryBuilder
from lfield.text.source_text import Span
from lfield.text.suggestions import listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlMapping, YamlNode, YamlScalar, describe


def read_portals(
    builder: RegistryBuilder, fields: YamlFields, primitive: Primitive, span: Span
) -> dict[str, PortalMap]:
    """The mappings of all portals of a primitive; those that are left out, too, at the place `span`.

    `fields` has the key `portals`.
    """
    maps = {}
    section = fields.section("portals")
    for entry in section.named():
        portal = primitive.portals.get(entry.key)
        if portal is None:
            builder.report_unknown_portal(primitive, entry.key, entry.key_span)
        else:
            maps[entry.key] = _map(builder, entry, primitive, portal)
    left_out = {
        name: same_name(portal, span) for name, portal in primitive.portals.items() if name not in maps
    }
    return maps | left_out


def same_name(portal: Portal, span: Span, target: str = "") -> PortalMap:
    """A portal served by one of the same name, or by `target`, with the same parameters."""
    arguments = tuple(Argument(p.name) for p in portal.parameters)
    return PortalMap(portal.name, target or portal.name, arguments, span)


def _map(builder: RegistryBuilder, entry: YamlEntry, primitive: Primitive, portal: Portal) -> PortalMap:
    node, span = entry.value, entry.key_span
    if isinstance(node, YamlScalar) and isinstance(node.value, str):
        builder.check_name(node.value, PORTAL, "a portal", node.span)
        return same_name(portal, span, node.value)
    fields = YamlFields(node, builder.found, f"'{entry.key}'")
    target = fields.text("portal", portal.name)
    builder.check_name(target, PORTAL, "a portal", fields.value_span("portal"))
    arguments = same_name(portal, span).arguments
    if "arguments" in fields:
        arguments = tuple(_argument(builder, item, primitive, portal) for item in fields.items("arguments"))
    result = _result(builder, fields, primitive, portal) if "emit" in fields else None
    fields.report_unread()
    return PortalMap(portal.name, target, arguments, span, result)


def _argument(builder: RegistryBuilder, node: YamlNode, primitive: Primitive, portal: Portal) -> Argument:
    if isinstance(node, YamlMapping):
        fields = YamlFields(node, builder.found, "an argument")
        argument = _long_argument(builder, fields, primitive, portal)
        fields.report_unread()
        return argument
    if isinstance(node, YamlScalar) and isinstance(node.value, str):
        return Argument(_parameter(builder, node.value, node.span, primitive, portal))
    if isinstance(node, YamlScalar) and node.value is not None:
        return Argument(constant=node.value)
    builder.report(messages.BAD_ARGUMENT, node.span, given=describe(node))
    return Argument(constant=0)


def _long_argument(
    builder: RegistryBuilder, fields: YamlFields, primitive: Primitive, portal: Portal
) -> Argument:
    if "constant" in fields:
        return Argument(constant=_constant(builder, fields))
    name = fields.text("parameter", required=True)
    if name:
        name = _parameter(builder, name, fields.value_span("parameter"), primitive, portal)
    unit = fields.text("unit")
    if not unit or not name:
        return Argument(name)
    own = next(p for p in portal.parameters if p.name == name)
    if not _is_number(builder, own.type, f"'{name}'", fields.value_span("unit")):
        return Argument(name)
    factor, offset = read_conversion(builder, own.unit, unit, fields.value_span("unit"))
    return Argument(name, factor=factor, offset=offset)


def _result(
    builder: RegistryBuilder, fields: YamlFields, primitive: Primitive, portal: Portal
) -> Argument | None:
    """The result for the caller, from the value that the target emits."""
    emit = fields.section("emit")
    if portal.result == "void":
        place = fields.key_span("emit")
        builder.report(messages.NOTHING_EMITTED, place, primitive=primitive.name, portal=portal.name)
        return None
    if "constant" in emit:
        result = Argument(constant=_constant(builder, emit))
    elif "parameter" in emit:
        name = emit.text("parameter")
        result = Argument(_parameter(builder, name, emit.value_span("parameter"), primitive, portal))
    else:
        result = _converted(builder, emit, portal)
    emit.report_unread()
    return result


def _converted(builder: RegistryBuilder, emit: YamlFields, portal: Portal) -> Argument:
    unit, place = emit.text("unit", required=True), emit.value_span("unit")
    if not unit or not _is_number(builder, portal.result, f"what '{portal.name}' emits", place):
        return Argument()
    factor, offset = read_conversion(builder, unit, portal.unit, place)
    return Argument(factor=factor, offset=offset)


def _is_number(builder: RegistryBuilder, type: str, expected: str, span: Span) -> bool:
    """Whether a value can be converted; reports one that is not a single number."""
    if type not in ("real", "int"):
        builder.report(messages.NO_UNIT_HERE, span, what=expected, type=type)
    return type in ("real", "int")


def _constant(builder: RegistryBuilder, fields: YamlFields) -> float | int | bool | str:
    node = fields.node("constant")
    if isinstance(node, YamlScalar) and node.value is not None:
        return node.value
    description = describe(node) if node is not None else "nothing"
    builder.report(messages.BAD_ARGUMENT, fields.value_span("constant"), given=description)
    return 0


def _parameter(builder: RegistryBuilder, name: str, span: Span, primitive: Primitive, portal: Portal) -> str:
    """The name of a canonical parameter, '' when there is none of that name."""
    names = [p.name for p in portal.parameters]
    if name in names:
        return name
    builder.report(
        messages.UNKNOWN_PARAMETER,
        span,
        hint=builder.similar_name(name, names),
        name=name,
        primitive=primitive.name,
        portal=portal.name,
        parameters=listed(names),
    )
    return ""
