"""The sections `providers` and `agents`: attributes and primitives of resource types, and of single agents.

```yaml
providers:
  Winch:
    include: can/winch.L
    attributes: {environment: [terrestrial]}
    nominal: {payload: 50.0, speed: 0.2}   # usual values, unless stated for a single robot
    live: {battery: fc.battery, north: "fc.position[0]", heat: {from: drive.temperature, unit: degC},
           load: load(), level: {from: level(), unit: mm, every: 5}}      # portals that only query
    serves:
      Lift:
        when: "tools == winch"             # not every one of the type can
        attributes: {accuracy: 0.01}       # count before those of the type
        portals: {lift: {portal: lift, arguments: [height]}}
agents: {arm2: {payload: 1.2}}           # those of the mission
```
A mission may extend a shipped provider: its entries for an attribute or a primitive replace the shipped ones.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from msgspec.structs import replace

from lfield.capability.matching.condition_checker import NameScope
from lfield.capability.model import LiveAttribute, Provider, ServedPrimitive, Value
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attribute_values import read_conversion, read_expression, read_values
from lfield.capability.registry_reader.portal_mapping import read_portals
from lfield.capability.registry_reader.registry_builder import TYPE_NAME, RegistryBuilder
from lfield.text.source_text import Span
from lfield.text.suggestions import listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlMapping

_NAME = r"[a-z][A-Za-z0-9_]*"
_SOURCE = re.compile(
    rf"((?P<device>{_NAME})\.(?P<quantity>{_NAME})|(?P<portal>{_NAME})\(\))(\[(?P<index>[0-9]{{1,4}})\])?"
)
#: Seconds between two calls of a portal.
_EVERY, _RAREST = 1.0, 3600.0


def read_providers(builder: RegistryBuilder) -> None:
    """All providers of all files."""
    scope = NameScope.of_offer(builder.attributes)
    for file, entry, fields in builder.entries("providers"):
        provider = _provider(builder, entry, fields, scope)
        first = builder.providers.get(entry.key)
        if first is None:
            builder.providers[entry.key] = provider
        elif not file.mission:
            builder.report_duplicate("the provider", entry.key, entry.key_span, first.span)
        else:
            builder.providers[entry.key] = _joined(first, provider)


def _provider(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields, scope: NameScope) -> Provider:
    name, span = entry.key, entry.key_span
    builder.check_name(name, TYPE_NAME, "a resource type", span)
    if name in builder.primitives:
        builder.report(messages.TYPE_IN_USE, span, name=name, what="a provider")
    attributes, nominal = _values(builder, fields)
    provider = Provider(
        type=name,
        include=fields.text("include"),
        meaning=fields.text("meaning"),
        attributes=attributes,
        nominal=nominal,
        live=_live_attributes(builder, fields.section("live")),
        serves=_serves(builder, fields.section("serves"), scope),
        span=span,
    )
    fields.report_unread()
    return provider


def _values(builder: RegistryBuilder, fields: YamlFields) -> tuple[dict[str, Value], frozenset[str]]:
    """The values in `attributes` and `nominal`, and the names of the nominal ones."""
    stated, usual = fields.section("attributes"), fields.section("nominal")
    values, nominal = read_values(builder, stated), read_values(builder, usual)
    for name in values.keys() & nominal.keys():
        builder.report(messages.STATED_AND_NOMINAL, usual.key_span(name), name=name)
    return {**nominal, **values}, frozenset(nominal.keys() - values.keys())


def _joined(shipped: Provider, mission: Provider) -> Provider:
    """A provider with the entries of a mission, which take precedence over the shipped ones."""
    return replace(
        shipped,
        include=mission.include or shipped.include,
        meaning=mission.meaning or shipped.meaning,
        attributes={**shipped.attributes, **mission.attributes},
        nominal=mission.nominal | (shipped.nominal - mission.attributes.keys()),
        live={**shipped.live, **mission.live},
        serves={**shipped.serves, **mission.serves},
    )


def _serves(builder: RegistryBuilder, section: YamlFields, scope: NameScope) -> dict[str, ServedPrimitive]:
    serves = {}
    for entry, fields in section.entries():
        primitive = builder.primitive(entry.key, entry.key_span)
        if primitive is None:
            continue
        attributes, nominal = _values(builder, fields)
        serves[entry.key] = ServedPrimitive(
            primitive=entry.key,
            portals=read_portals(builder, fields, primitive, entry.key_span),
            attributes=attributes,
            nominal=nominal,
            when=read_expression(builder, fields.node("when"), scope, "boolean"),
            span=entry.key_span,
        )
        fields.report_unread()
    return serves


def read_agents(builder: RegistryBuilder, deployed: Collection[str] | None) -> None:
    """The values of single agents; when the `deployed` ones are given, any other name is a mistake."""
    for _, entry, fields in builder.entries("agents"):
        if deployed is not None and entry.key not in deployed:
            hint = builder.similar_name(entry.key, deployed)
            known = listed(sorted(deployed))
            builder.report(messages.UNKNOWN_AGENT, entry.key_span, hint=hint, name=entry.key, agents=known)
        builder.agents.setdefault(entry.key, {}).update(read_values(builder, fields))


# --- live attributes ----------------------------------------------------------------------------------


def _live_attributes(builder: RegistryBuilder, section: YamlFields) -> dict[str, LiveAttribute]:
    live_attributes = {}
    for entry in section.named():
        live = _live(builder, entry)
        if live is not None:
            live_attributes[entry.key] = live
    return live_attributes


def _live(builder: RegistryBuilder, entry: YamlEntry) -> LiveAttribute | None:
    """`fc.battery`, `fc.position[0]`, `{from: fc.battery, unit: "%"}`, or a portal as `load()`."""
    attribute = builder.attribute(entry.key, entry.key_span)
    text, place, unit, interval = _source(builder, entry)
    match = _SOURCE.fullmatch(text)
    if match is None:
        builder.report(messages.BAD_LIVE, place, text=text[:80])
        return None
    if attribute is None:
        return None
    factor, offset = read_conversion(builder, unit, attribute.unit, place) if unit else (1.0, 0.0)
    index = int(match["index"]) if match["index"] else None
    if match["portal"] and attribute.live and interval > attribute.max_age:
        builder.report(
            messages.TOO_RARE, place, name=entry.key, every=f"{interval:g}", age=f"{attribute.max_age:g}"
        )
    device, quantity = match["device"] or "", match["quantity"] or match["portal"]
    return LiveAttribute(entry.key, device, quantity, place, factor, offset, index, unit, interval)


def _source(builder: RegistryBuilder, entry: YamlEntry) -> tuple[str, Span, str, float]:
    """The source of a live value, its place, its unit if given, and its polling interval."""
    section = YamlFields(YamlMapping({entry.key: entry}, entry.key_span), builder.found, "'live'")
    if not isinstance(entry.value, YamlMapping):
        return section.text(entry.key), entry.value.span, "", _EVERY
    fields = section.section(entry.key)
    text, unit = fields.text("from", required=True), fields.text("unit")
    interval = fields.number("every", _EVERY, minimum=_EVERY, maximum=_RAREST)
    fields.report_unread()
    return text, fields.value_span("from"), unit, interval
