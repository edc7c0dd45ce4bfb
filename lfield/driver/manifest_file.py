"""Reads a driver's `manifest.yaml`: the contract of a driver as data.

```yaml
driver: servo                       # the name in bindings
type: Servo                         # the device type in L
meaning: one servo on a bus
safe_states: [hold, off]            # the first is the default; a pure sensor has none
options:                            # keys of a binding specific to this driver
  id: {type: int, default: 1, minimum: 1, maximum: 252, meaning: its number on the bus}
limits:
  speed: {unit: rad/s, meaning: greatest angular speed}
waivers:                            # protections that a binding may waive, in addition to device_watchdog
  no_homing: moves before it has been homed
reasoned: [no_homing]               # waivers that require a reason
fakes:                              # options under --sim without a binding, by resource type
  Gripper: {id: 7}
  any: {id: 1}
instructions:
  turn: {parameters: {angle: {type: real, unit: rad}}, blocking: true, cancel: stop, meaning: turns and waits}
  stop: {blocking: true, effect: idempotent, cancel: never, meaning: stops and holds its position}
  light: {parameters: {on: {type: boolean}}, blocking: true, cancel: never, channel: light}
telemetry:                          # each is also a query of the same name: `s.angle()`
  angle: {type: real, unit: rad, max_age: 0.5, rate: 20.0, meaning: present angle}
```

A non-blocking instruction of effect `actuate` is a *setpoint*: it stays in effect after the call has
returned, so the guard gives it a time-to-live. A blocking `query` queries the device itself.

A newer instruction replaces an older one on the same channel; channels are independent. A blocking
instruction that acts declares what `cancel` does: the name of an instruction that is executed instead (same
channel, no parameters, blocking); `never`, for an instruction that must be completed (a landing) or is short;
or `leave`, which only stops waiting.

`frame` defines how a parameter or quantity refers to the team's frame: `place`, `direction` or `heading`
(`lfield.driver.frame`). A device with `geographic: true` knows the origin of its own frame on the Earth. A
device without safe states is a pure sensor: all its instructions are queries, and it is never latched. Every
device type also has `release()` and `age()`, which no manifest declares.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import cast

from lfield.driver.binding import OptionValue
from lfield.driver.contract import STANDARD_INSTRUCTIONS, WATCHDOG, Limit, Manifest, Option
from lfield.errors import PluginError
from lfield.manifest import (
    DEVICE_VALUE_TYPES,
    FILE_KINDS,
    FRAME_KINDS,
    LEAVE,
    NEVER,
    DeviceManifest,
    Effect,
    Instruction,
    Parameter,
    Quantity,
)
from lfield.text.source_text import Diagnostics, Span
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlList, YamlNode, YamlScalar, decode
from lfield.units import is_unit, suggestion

#: Number of parsed manifests that are kept. A command searches drivers several times, and most of this time
#: is spent on parsing their manifests.
MAX_CACHED = 64

#: L types of options; a path is relative to the folder of the devices file, and one number is a `real[]` too.
OPTION_TYPES = ("boolean", "int", "real", "string", "path", "int[]", "real[]", "string[]")

_NAME = re.compile(r"[a-z][A-Za-z0-9]*")
#: The form of the keys of bindings, which need not be names in L.
_KEY = re.compile(r"[a-z][A-Za-z0-9_]*")
#: Hint for a missing or wrong `cancel`.
_CANCEL = (
    "write 'cancel: ' and an instruction without parameters that ends it, such as hold; or never; or leave, "
    "if the call only stops waiting"
)
_TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")


@lru_cache(MAX_CACHED)
def load_manifest(name: str, data: bytes) -> Manifest:
    """Parses a manifest; equal bytes are parsed only once. Raises PluginError with every finding and its
    source line.
    """
    found = Diagnostics()
    node = decode(name, data, found)
    manifest = _manifest(node, found) if node is not None else None
    if found.errors or manifest is None:
        raise PluginError("\n".join(["a driver's manifest is wrong:", *(d.render() for d in found.errors)]))
    return manifest


def _manifest(node: YamlNode, found: Diagnostics) -> Manifest:
    top = YamlFields(node, found, "a manifest")
    driver = top.text("driver", required=True)
    device_type = top.text("type", required=True)
    _check_name(top, device_type, _TYPE_NAME, top.value_span("type"))
    meaning = top.text("meaning")
    safe_states = top.texts("safe_states")
    options = tuple(_option(name, fields) for name, fields in _named(top, "options"))
    limits = tuple(_limit(name, fields) for name, fields in _named(top, "limits"))
    watchdog = ((WATCHDOG, "it has no watchdog of its own, or a slow one"),) if safe_states else ()
    waivers = (*watchdog, *_waivers(top))
    reasoned = _reasoned(top, [name for name, _ in waivers])
    geographic = top.flag("geographic")
    fakes = {entry.key: _fake(fields, options) for entry, fields in top.section("fakes").entries()}
    instructions = [_instruction(name, fields) for name, fields in _named(top, "instructions")]
    _check_safe(top, safe_states, instructions)
    _check_cancels(top, {instruction.name: instruction for instruction in instructions})
    telemetry = tuple(_quantity(name, fields) for name, fields in _named(top, "telemetry"))
    _check_names_differ(top, {instruction.name for instruction in instructions})
    top.report_unread()
    queries = (Instruction(q.name, (), q.type, q.unit, "query", False, q.meaning) for q in telemetry)
    device = DeviceManifest(
        type=device_type,
        driver=driver,
        instructions=(*instructions, *queries, *STANDARD_INSTRUCTIONS),
        telemetry=telemetry,
        safe_states=safe_states,
        meaning=meaning,
    )
    return Manifest(device, options, limits, waivers, fakes, geographic, reasoned)


def _check_safe(top: YamlFields, safe_states: Sequence[str], instructions: Sequence[Instruction]) -> None:
    """Instructions that act require a safe state; a pure sensor has only queries."""
    acting = [instruction.name for instruction in instructions if not instruction.only_asks]
    if acting and not safe_states:
        top.report(
            "Y110",
            f"a manifest needs at least one safe state because {acting[0]}() acts",
            top.value_span("safe_states"),
            "remove safe_states only if all instructions are queries (a sensor)",
        )


def _check_cancels(top: YamlFields, instructions: Mapping[str, Instruction]) -> None:
    """Blocking instructions that act must declare `cancel`: a keyword or a suitable instruction."""
    for entry, fields in top.section("instructions").entries():
        instruction = instructions[entry.key]
        if not instruction.blocking or instruction.only_asks:
            if instruction.cancel:
                reason = f"'{entry.key}' cannot be cancelled: only a blocking instruction that acts can"
                top.report("Y113", reason, fields.value_span("cancel"))
        elif not instruction.cancel:
            top.report("Y110", f"'{entry.key}' does not declare what a cancel does", entry.key_span, _CANCEL)
        elif reason := _cannot_end(instruction, instructions):
            top.report("Y113", reason, fields.value_span("cancel"), _CANCEL)


def _cannot_end(instruction: Instruction, instructions: Mapping[str, Instruction]) -> str:
    """The reason why the instruction named by `cancel` is not suitable; '' when it is."""
    if instruction.cancel in (NEVER, LEAVE):
        return ""
    end = instructions.get(instruction.cancel)
    if end is None or end is instruction:
        return f"there is no other instruction '{instruction.cancel}'"
    if end.parameters:
        return f"'{end.name}' has parameters"
    if not end.blocking or end.only_asks:
        return f"'{end.name}' is not a blocking instruction that acts"
    if end.channel != instruction.channel:
        return (
            f"'{end.name}' is on channel {end.channel}, but '{instruction.name}' is on {instruction.channel}"
        )
    return ""


def _waivers(top: YamlFields) -> list[tuple[str, str]]:
    """The waivers of this device and their meaning."""
    section = top.section("waivers")
    return [(entry.key, section.text(entry.key)) for entry in section.named()]


def _reasoned(top: YamlFields, waivers: Sequence[str]) -> tuple[str, ...]:
    """The waivers that require a reason."""
    reasoned = top.texts("reasoned")
    for name in reasoned:
        if name not in waivers:
            top.report("Y113", f"there is no waiver '{name}'", top.value_span("reasoned"))
    return reasoned


def _check_names_differ(top: YamlFields, instructions: set[str]) -> None:
    """Instructions and telemetry share one name space, since a quantity is also a query."""
    standard = {instruction.name for instruction in STANDARD_INSTRUCTIONS}
    for section, used_names in (("instructions", standard), ("telemetry", standard | instructions)):
        for entry, _ in top.section(section).entries():
            if entry.key in used_names:
                top.report(
                    "Y113", f"'{entry.key}' is already an instruction of this device type", entry.key_span
                )


def _named(top: YamlFields, section: str) -> list[tuple[str, YamlFields]]:
    """The entries of a section whose keys are names; the caller calls `done`."""
    entries = []
    pattern = _KEY if section in ("options", "limits") else _NAME
    for entry, fields in top.section(section).entries():
        _check_name(top, entry.key, pattern, entry.key_span)
        entries.append((entry.key, fields))
    return entries


def _check_name(top: YamlFields, name: str, pattern: re.Pattern[str], span: Span) -> None:
    if name and not pattern.fullmatch(name):
        top.report(
            "Y113", f"'{name}' cannot be a name in L here", span, "letters and digits, as in goTo or Servo"
        )


def _option(name: str, fields: YamlFields) -> Option:
    kind = fields.text("type", "string", required=True, choices=OPTION_TYPES)
    default = fields.node("default")
    option = Option(
        name,
        kind,
        _default(default),
        fields.texts("choices"),
        fields.number("minimum", -math.inf),
        fields.number("maximum", math.inf),
        fields.text("meaning"),
    )
    fields.report_unread()
    return option


def _fake(fields: YamlFields, options: Iterable[Option]) -> dict[str, OptionValue]:
    """The options of a simulated device for one resource type; only scalar options are allowed."""
    found = {option.name: _default(fields.node(option.name)) for option in options if option.name in fields}
    fields.report_unread()
    return {name: value for name, value in found.items() if value is not None}


def _default(node: YamlNode | None) -> OptionValue | None:
    """The value of an option in a manifest."""
    if isinstance(node, YamlScalar):
        return node.value
    items = node.items if isinstance(node, YamlList) else ()
    values = [item.value for item in items if isinstance(item, YamlScalar)]
    return [v for v in values if v is not None] if isinstance(node, YamlList) else None


def _limit(name: str, fields: YamlFields) -> Limit:
    limit = Limit(name, _unit(fields), fields.text("meaning"))
    fields.report_unread()
    return limit


def _instruction(name: str, fields: YamlFields) -> Instruction:
    parameters = tuple(_parameter(p, f) for p, f in _named(fields, "parameters"))
    result = fields.text("result", "void", choices=("void", *DEVICE_VALUE_TYPES))
    effect = fields.text("effect", "actuate", choices=("query", "idempotent", "actuate"))
    instruction = Instruction(
        name,
        parameters,
        result,
        _unit(fields),
        cast(Effect, effect),
        fields.flag("blocking"),
        fields.text("meaning"),
        fields.text("channel", "motion"),
        fields.text("cancel"),
    )
    if instruction.is_query:
        fields.report(
            "Y113",
            f"'{name}' is a query that does not ask the device",
            fields.span,
            "put it under telemetry, or make it blocking to ask the device",
        )
    fields.report_unread()
    return instruction


def _parameter(name: str, fields: YamlFields) -> Parameter:
    kind = fields.text("type", "real", required=True, choices=DEVICE_VALUE_TYPES)
    file = fields.text("file", choices=("", *FILE_KINDS)) if kind == "string" else ""
    parameter = Parameter(name, kind, _unit(fields), fields.text("meaning"), _frame(fields, kind), file)
    fields.report_unread()
    return parameter


def _quantity(name: str, fields: YamlFields) -> Quantity:
    kind = fields.text("type", "real", required=True, choices=DEVICE_VALUE_TYPES)
    max_age = fields.number("max_age", 3.0, minimum=0.001)
    unit, meaning, rate = _unit(fields), fields.text("meaning"), fields.number("rate", minimum=0.0)
    quantity = Quantity(name, kind, unit, max_age, meaning, rate, _frame(fields, kind))
    fields.report_unread()
    return quantity


def _unit(fields: YamlFields) -> str:
    """A unit, or one for each element of an array (`deg, deg, m`); '' for none. Reports other texts."""
    text = fields.text("unit")
    for part in text.split(",") if text else ():
        if not is_unit(part.strip()):
            fields.report(
                "Y113", f"'{part.strip()}' is not a unit", fields.value_span("unit"), suggestion(part)
            )
    return text


def _frame(fields: YamlFields, kind: str) -> str:
    """The reference of a value to the team's frame, which only a real or an array of reals can have."""
    frame = fields.text("frame", choices=FRAME_KINDS)
    if frame and kind not in ("real", "real[]"):
        fields.report(
            "Y113",
            f"the type {kind} cannot be a {frame}",
            fields.value_span("frame"),
            "make it real or real[]",
        )
    return frame
