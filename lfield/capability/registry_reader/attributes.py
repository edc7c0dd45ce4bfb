"""The sections `attributes` and `ranking`: the attributes of offers, and the weights of their ranking.

```yaml
attributes:
  payload: {type: real, unit: kg, better: more, typical: 2.0, meaning: what it can carry or lift}
  environment: {type: set, values: [aerial, aquatic, terrestrial], meaning: where it can work}
  battery: {type: real, better: more, live: true, max_age: 10.0, meaning: charge from 0 to 1}
ranking: {weights: {loss: 2.0, hop: 0.1}, attributes: {payload: 2.0}, nearby: 20.0}
```
"""

from __future__ import annotations

from typing import cast, get_args

from msgspec.structs import replace

from lfield.capability.model import Attribute, AttributeType, Better, Weights
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attribute_values import check_unit
from lfield.capability.registry_reader.registry_builder import NAME, RegistryBuilder
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry

#: Names with a fixed meaning in conditions.
RESERVED_ATTRIBUTES = frozenset({"agent", "robot", "host", "distance", "min", "max", "abs"})

#: The terms of the cost that have a weight, besides those of single attributes.
_TERMS = tuple(name for name in Weights.__struct_fields__ if name not in ("attributes", "nearby"))
_HEAVIEST = 1e6


def read_attributes(builder: RegistryBuilder) -> None:
    """All attributes of all files."""
    for file, entry, fields in builder.entries("attributes"):
        builder.define(
            builder.attributes, _attribute(builder, entry, fields), "the attribute", mission=file.mission
        )


def _attribute(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> Attribute:
    name, span = entry.key, entry.key_span
    builder.check_name(name, NAME, "an attribute", span)
    if name in RESERVED_ATTRIBUTES:
        builder.report(messages.RESERVED_ATTRIBUTE, span, name=name)
    kind = fields.text("type", "real", required=True, choices=get_args(AttributeType))
    attribute = Attribute(
        name=name,
        type=cast(AttributeType, kind),
        span=span,
        unit=fields.text("unit"),
        better=cast(Better, fields.text("better", "none", choices=get_args(Better))),
        typical=fields.number("typical", 1.0, minimum=1e-9),
        values=fields.texts("values"),
        live=fields.flag("live"),
        max_age=fields.number("max_age", 10.0, minimum=0.1, maximum=86400.0),
        meaning=fields.text("meaning"),
    )
    fields.report_unread()
    check_unit(builder, attribute.unit, kind, f"'{name}'", fields.value_span("unit"))
    if attribute.values and kind not in ("set", "text"):
        builder.report(messages.VALUES_OF_NUMBER, fields.value_span("values"), name=name, type=kind)
    return attribute


def read_ranking(builder: RegistryBuilder) -> None:
    """The weights: a later file counts before an earlier one, a mission's before all."""
    for file in builder.files:
        section = file.top.section("ranking")
        stated = section.section("weights")
        known = builder.weights
        weights = {
            term: stated.number(term, getattr(known, term), minimum=0.0, maximum=_HEAVIEST) for term in _TERMS
        }
        stated.report_unread()
        attributes = {
            **builder.weights.attributes,
            **_attribute_weights(builder, section.section("attributes")),
        }
        nearby = section.number("nearby", builder.weights.nearby, minimum=0.1, maximum=_HEAVIEST)
        builder.set_weights(replace(builder.weights, attributes=attributes, nearby=nearby, **weights))
        section.report_unread()


def _attribute_weights(builder: RegistryBuilder, section: YamlFields) -> dict[str, float]:
    weights = {}
    for entry in section.named():
        if builder.attribute(entry.key, entry.key_span) is not None:
            weights[entry.key] = section.number(entry.key, minimum=0.0, maximum=_HEAVIEST)
    return weights
