"""Channels of plain JSON: telemetry with units, events, links, activity of agents. Pure.

The schema of a device's telemetry follows from the manifest of its driver. A quantity that the manifest does
not name gets the type of its value, and the device a further channel with the same topic. Values of another
type, and those that JSON does not have (NaN, infinities), are omitted; in an array the latter are null.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, get_args

import msgspec.inspect as types

from lfield.export.channels import Channel, ChannelMessage, JsonSchema, MessageSchema, topic_part
from lfield.export.export_input import MissionInfo, TelemetrySample
from lfield.manifest import Quantity
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.wire.events import AgentActivity, LinkTelemetry, StateEvent
from lfield.wire.fields import Telemetry
from lfield.wire.subscription_messages import as_fields

#: JSON types of L's types.
_JSON_TYPES: Mapping[str, JsonSchema] = {
    "boolean": {"type": "boolean"},
    "int": {"type": "integer"},
    "real": {"type": "number"},
    "string": {"type": "string"},
    "real[]": {"type": "array", "items": {"type": "number"}},
    "int[]": {"type": "array", "items": {"type": "integer"}},
}
#: JSON types of fields of events.
_FIELD_TYPES: Mapping[type, str] = {
    types.BoolType: "boolean",
    types.IntType: "integer",
    types.FloatType: "number",
    types.StrType: "string",
    types.LiteralType: "string",
}


def _described(json: JsonSchema, meaning: str, unit: str = "") -> dict[str, Any]:
    """A type with its meaning, and the unit after it."""
    text = f"{meaning} [{unit}]".strip() if unit else meaning
    return {**json, **({"description": text} if text else {}), **({"unit": unit} if unit else {})}


def _object(title: str, fields: Mapping[str, JsonSchema]) -> MessageSchema:
    return MessageSchema(title, {"type": "object", "title": title, "properties": dict(fields)})


# --- telemetry of devices -----------------------------------------------------------------------------------


class TelemetryChannels:
    """A channel for each device and set of quantities."""

    def __init__(self, info: MissionInfo) -> None:
        self._info = info
        self._channels: dict[str, Channel] = {}
        #: The types of the quantities in the schema of each device.
        self._types: dict[str, dict[str, str]] = {}

    def messages(self, sample: TelemetrySample) -> Iterator[ChannelMessage]:
        """The values of a device as one object."""
        device = sample.device
        types = self._types.get(device)
        if types is None:
            types = {name: quantity.type for name, quantity in self._info.quantities(device).items()}
        found = {name: _type_of(value) for name, value in sample.values.items()}
        added = {name: type for name, type in found.items() if _replaces(type, types.get(name))}
        if added or device not in self._channels:
            self._types[device] = types = types | added
            self._channels[device] = self._channel(device, types)
        values = {
            name: _json_value(value)
            for name, value in sample.values.items()
            if _is_json(value) and _fits(found[name], types[name])
        }
        data = {"host": sample.host, "silent": sample.silent, **values}
        yield ChannelMessage(self._channels[device], sample.time, data)

    def _channel(self, device: str, known: Mapping[str, str]) -> Channel:
        quantities = self._info.quantities(device)
        fields: dict[str, JsonSchema] = {
            "host": _described({"type": "string"}, "host of the device"),
            "silent": _described({"type": "number"}, "age of the newest value", "s"),
        }
        for name, type in known.items():
            quantity = quantities.get(name, Quantity(name, type))
            fields[name] = _described(_JSON_TYPES[type], quantity.meaning, quantity.unit)
        units = {name: quantity.unit for name, quantity in quantities.items() if quantity.unit}
        return Channel(f"/devices/{topic_part(device)}", _object(f"lfield.{device}", fields), units)


def _type_of(value: Telemetry) -> str:
    match value:
        case bool():
            return "boolean"
        case int():
            return "int"
        case float():
            return "real"
        case str():
            return "string"
        case _:
            return "int[]" if all(isinstance(each, int) for each in value) else "real[]"


#: Types, and the wider ones that include them.
_WIDER = (("int", "real"), ("int[]", "real[]"))


def _fits(type: str, known: str) -> bool:
    """Whether a value of a type may stand in a field: whole numbers are real numbers too."""
    return type == known or (type, known) in _WIDER


def _replaces(type: str, known: str | None) -> bool:
    """Whether a field gets this type: it had none, or one that this type includes."""
    return known is None or (known, type) in _WIDER


def _is_json(value: Telemetry) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _json_value(value: Telemetry) -> object:
    if isinstance(value, list):
        return [each if math.isfinite(each) else None for each in value]
    return value


# --- other messages -----------------------------------------------------------------------------------------


def _fields_of(*kinds: type) -> dict[str, JsonSchema]:
    """The fields of kinds of events with their types; equal names have equal types, or become texts."""
    found: dict[str, JsonSchema] = {}
    for kind in kinds:
        info = types.type_info(kind)
        assert isinstance(info, types.StructType)
        for field in info.fields:
            json = {"type": _field_type(field.type)}
            found[field.name] = json if found.get(field.name, json) == json else {"type": "string"}
    return found


def _field_type(info: types.Type) -> str:
    if isinstance(info, types.Metadata):
        info = info.type
    if isinstance(info, types.UnionType):
        info = next(each for each in info.types if not isinstance(each, types.NoneType))
    return _FIELD_TYPES[type(info)]


_HEAD: dict[str, JsonSchema] = {
    "host": {"type": "string"},
    "incarnation": {"type": "string"},
    "number": {"type": "integer"},
    "at": _described({"type": "number"}, "time by the clock of the host", "s"),
    "kind": {"type": "string"},
    "cause_host": {"type": "string"},
    "cause_number": {"type": "integer"},
}
_STATE_FIELDS = _fields_of(*get_args(StateEvent))
_LINK = _object("lfield.Link", {"host": {"type": "string"}, **_fields_of(LinkTelemetry)})
_ACTIVITY = _object("lfield.Activity", {"host": {"type": "string"}, **_fields_of(AgentActivity)})

EVENTS = Channel("/events", _object("lfield.Event", _HEAD | _STATE_FIELDS))


def event_message(dated: DatedEvent) -> ChannelMessage:
    """A state event with its host and cause."""
    fields = as_fields(dated.event)
    for name in ("up", "cause"):
        del fields[name]
    for name, value in fields.items():
        if name in _STATE_FIELDS and _STATE_FIELDS[name]["type"] == "string" and not isinstance(value, str):
            fields[name] = str(value)
    if dated.cause is not None:
        fields |= {"cause_host": dated.cause.host, "cause_number": dated.cause.number}
    # Most readers of JSON do not support numbers with 63 digits in base 2.
    head = {"host": dated.host, "incarnation": str(dated.incarnation)}
    return ChannelMessage(EVENTS, dated.time, {**head, **_without_null(fields)})


class SampledChannels:
    """A channel for each link and for each agent."""

    def __init__(self) -> None:
        self._channels: dict[str, Channel] = {}

    def messages(self, dated: DatedEvent) -> Iterator[ChannelMessage]:
        """Measurements of a link, or the activity of an agent."""
        match dated.event.what:
            case LinkTelemetry(peer):
                topic, schema = f"/links/{topic_part(dated.host)}/{topic_part(peer)}", _LINK
            case AgentActivity(agent):
                topic, schema = f"/agents/{topic_part(agent)}", _ACTIVITY
            case _:
                return
        channel = self._channels.setdefault(topic, Channel(topic, schema))
        values = {
            name: value
            for name, value in as_fields(dated.event).items()
            if name not in ("number", "at", "up", "cause", "kind")
        }
        yield ChannelMessage(channel, dated.time, {"host": dated.host, **_without_null(values)})


def _without_null(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}
