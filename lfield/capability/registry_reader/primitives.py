"""The section `primitives`: capabilities that can be called, with their canonical portals.

```yaml
primitives:
  Lift:                              # the type in L
    id: skill.material_handling.lifting
    meaning: raises a load by some height and holds it
    portals:
      lift: {parameters: {height: {type: real, unit: m}}, emit: real, unit: m, effect: actuate}
```
"""

from __future__ import annotations

from typing import cast, get_args

from lfield.capability.model import Portal, Primitive
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attribute_values import check_unit
from lfield.capability.registry_reader.registry_builder import NAME, PORTAL, TYPE_NAME, RegistryBuilder
from lfield.capability.registry_reader.unit_signatures import PORTAL_TYPES, RESERVED_TYPES
from lfield.lang.capability_port import OFFER_METHODS
from lfield.manifest import Effect, Parameter
from lfield.text.source_text import Span
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry


def read_primitives(builder: RegistryBuilder) -> None:
    """All primitives of all files."""
    for file, entry, fields in builder.entries("primitives"):
        builder.define(
            builder.primitives, _primitive(builder, entry, fields), "the primitive", mission=file.mission
        )


def _primitive(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> Primitive:
    name, span = entry.key, entry.key_span
    builder.check_name(name, TYPE_NAME, "a primitive", span)
    if name in RESERVED_TYPES:
        builder.report(messages.RESERVED_TYPE, span, name=name)
    id, meaning = fields.text("id", required=True), fields.text("meaning")
    term = builder.term(id, fields.value_span("id")) if id else ""
    portals = {
        portal.key: _portal(builder, portal, shape) for portal, shape in fields.section("portals").entries()
    }
    fields.report_unread()
    if not portals:
        builder.report(messages.NO_PORTALS, span, name=name)
    return Primitive(name, term, portals, span, meaning)


def _portal(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> Portal:
    name, span = entry.key, entry.key_span
    builder.check_name(name, PORTAL, "a portal", span)
    if name in OFFER_METHODS:
        builder.report(messages.RESERVED_PORTAL, span, name=name)
    parameters = tuple(_parameter(builder, p, f) for p, f in fields.section("parameters").entries())
    result = fields.text("emit", "void", choices=("void", *PORTAL_TYPES))
    effect = fields.text("effect", "actuate", choices=get_args(Effect))
    raises, unit, meaning = fields.texts("raises"), fields.text("unit"), fields.text("meaning")
    fields.report_unread()
    for exception in raises:
        builder.check_name(exception, TYPE_NAME, "an exception", fields.value_span("raises"))
    check_unit(builder, unit, result, f"what '{name}' emits", fields.value_span("unit"))
    return Portal(name, parameters, result, unit, cast(Effect, effect), raises, meaning)


def _parameter(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> Parameter:
    span: Span = entry.key_span
    builder.check_name(entry.key, NAME, "a parameter", span)
    type = fields.text("type", "real", required=True, choices=PORTAL_TYPES)
    parameter = Parameter(entry.key, type, fields.text("unit"), fields.text("meaning"))
    fields.report_unread()
    check_unit(builder, parameter.unit, type, f"'{entry.key}'", fields.value_span("unit"))
    return parameter
