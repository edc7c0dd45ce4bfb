"""Reads a driver's `manifest.yaml`: the whole contract of a driver as data.

```yaml
driver: servo                       # the name in bindings
type: Servo                         # the device type in L
meaning: one servo on a bus
safe_states: [hold, off]            # the first is the default; a pure sensor has none
options:                            # the driver's own keys of a binding
  id: {type: int, default: 1, minimum: 1, maximum: 252, meaning: its number on the bus}
limits:
  speed: {unit: rad/s, meaning: the fastest it may turn}
waivers:                            # protections that a binding may give up by name, beside device_watchdog
  no_homing: it moves before it has been homed
reasoned: [no_homing]               # those of them that a binding must give a reason for
fakes:                              # options under --sim where no binding is, by the resource that has it
  Gripper: {id: 7}
  any: {id: 1}
instructions:
  turn: {parameters: {angle: {type: real, unit: rad}}, blocking: true, cancel: stop, meaning: turns and waits}
  stop: {blocking: true, effect: idempotent, cancel: never, meaning: stays where it is}
  light: {parameters: {on: {type: boolean}}, blocking: true, cancel: never, channel: light}
telemetry:                          # each is also a query of the same name: `s.angle()`
  angle: {type: real, unit: rad, max_age: 0.5, rate: 20.0, meaning: where it is}
```

An instruction of effect `actuate` that is not blocking is a *setpoint*: it acts on after the call has
returned, so the guard gives it a time-to-live. A `query` that is blocking asks the device itself.
Instructions of one channel replace one another, the newest wins; those of other channels run beside them.
What blocks and acts says what a `cancel` of it does, when a program gives it up on its way: the name of an
instruction that is carried out instead (of the same channel, without parameters, done when the device has
been seen to do it); `never`, when it must go on to its end, as a landing, or ends soon; or `leave`, when
it is only waited for no longer, and what it began goes on.
What of the team's frame a parameter or quantity is about says its `frame`: `place`, `direction` or `heading`
(`lfield.driver.frame`). A device with `geographic: true` knows where on the Earth its own frame begins.
A device without safe states is a pure sensor: all its instructions are queries, and it is never latched.
Every device type has two instructions more, `release()` and `age()`; no manifest declares them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import cast

from lfield.driver.binding import OptionValue
from lfield.driver.contract import STANDARD, WATCHDOG, Limit, Manifest, Option
from lfield.errors import PluginError
from lfield.manifest import (
    DEVICE_VALUE_TYPES,
    FRAME_KINDS,
    LEAVE,
    NEVER,
    DeviceManifest,
    Effect,
    Instruction,
    Parameter,
    Quantity,
)
from lfield.text.source import Diagnostics, Span
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Listing, Node, Scalar, decode

#: L types of options; a path is taken from the folder of the devices file.
OPTION_TYPES = ("boolean", "int", "real", "string", "path", "int[]", "string[]")

_NAME = re.compile(r"[a-z][A-Za-z0-9]*")
#: Keys of bindings are no names in L, so they look like the other keys of that file.
_KEY = re.compile(r"[a-z][A-Za-z0-9_]*")
#: What to write where `cancel` is missing or wrong.
_CANCEL = (
    "write 'cancel: ' and an instruction without parameters that ends it, such as hold; or never; or leave, "
    "if it is only waited for no longer"
)
_TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")


def load_manifest(name: str, data: bytes) -> Manifest:
    """The manifest in some bytes. Raises PluginError with every finding drawn."""
    found = Diagnostics()
    node = decode(name, data, found)
    manifest = _manifest(node, found) if node is not None else None
    if found.errors or manifest is None:
        raise PluginError("\n".join(["a driver's manifest is wrong:", *(d.render() for d in found.errors)]))
    return manifest


def _manifest(node: Node, found: Diagnostics) -> Manifest:
    top = Fields(node, found, "a manifest")
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
    top.done()
    queries = (Instruction(q.name, (), q.type, q.unit, "query", False, q.meaning) for q in telemetry)
    device = DeviceManifest(
        type=device_type,
        driver=driver,
        instructions=(*instructions, *queries, *STANDARD),
        telemetry=telemetry,
        safe_states=safe_states,
        meaning=meaning,
    )
    return Manifest(device, options, limits, waivers, fakes, geographic, reasoned)


def _check_safe(top: Fields, safe_states: Sequence[str], instructions: Sequence[Instruction]) -> None:
    """What acts must have a safe state; a pure sensor needs none, since it does nothing."""
    acting = [instruction.name for instruction in instructions if not instruction.only_asks]
    if acting and not safe_states:
        top.report(
            "Y110",
            f"a manifest needs at least one safe state, since {acting[0]}() acts",
            top.value_span("safe_states"),
            "a sensor needs none: all its instructions are of effect query",
        )


def _check_cancels(top: Fields, instructions: Mapping[str, Instruction]) -> None:
    """What blocks and acts says what a cancel of it does, by a word or an instruction that can do it."""
    for entry, fields in top.section("instructions").entries():
        instruction = instructions[entry.key]
        if not instruction.blocking or instruction.only_asks:
            if instruction.cancel:
                why = f"'{entry.key}' has nothing to cancel: only what blocks and acts is under way"
                top.report("Y113", why, fields.value_span("cancel"))
        elif not instruction.cancel:
            top.report(
                "Y110", f"'{entry.key}' does not say what a cancel of it does", entry.key_span, _CANCEL
            )
        elif why := _cannot_end(instruction, instructions):
            top.report("Y113", why, fields.value_span("cancel"), _CANCEL)


def _cannot_end(instruction: Instruction, instructions: Mapping[str, Instruction]) -> str:
    """Why the instruction that a cancel names cannot be carried out instead; '' when it can."""
    if instruction.cancel in (NEVER, LEAVE):
        return ""
    end = instructions.get(instruction.cancel)
    if end is None or end is instruction:
        return f"there is no other instruction '{instruction.cancel}'"
    if end.parameters:
        return f"'{end.name}' has parameters, and nobody knows which to give it"
    if not end.blocking or end.only_asks:
        return f"'{end.name}' does not act and wait until that is done"
    if end.channel != instruction.channel:
        return (
            f"'{end.name}' is of the channel {end.channel}, and '{instruction.name}' of {instruction.channel}"
        )
    return ""


def _waivers(top: Fields) -> list[tuple[str, str]]:
    """The protections of this device that a binding may give up, and what that means."""
    section = top.section("waivers")
    return [(entry.key, section.text(entry.key)) for entry in section.named()]


def _reasoned(top: Fields, waivers: Sequence[str]) -> tuple[str, ...]:
    """The waivers that a binding must give a reason for."""
    reasoned = top.texts("reasoned")
    for name in reasoned:
        if name not in waivers:
            top.report("Y113", f"there is no waiver '{name}'", top.value_span("reasoned"))
    return reasoned


def _check_names_differ(top: Fields, instructions: set[str]) -> None:
    """A quantity is a query too, so all names of a device type are in one name space."""
    standard = {instruction.name for instruction in STANDARD}
    for section, taken in (("instructions", standard), ("telemetry", standard | instructions)):
        for entry, _ in top.section(section).entries():
            if entry.key in taken:
                top.report(
                    "Y113", f"'{entry.key}' is already an instruction of this device type", entry.key_span
                )


def _named(top: Fields, section: str) -> list[tuple[str, Fields]]:
    """The entries of a section whose keys are names; `done` is left to the caller's reader."""
    entries = []
    pattern = _KEY if section in ("options", "limits") else _NAME
    for entry, fields in top.section(section).entries():
        _check_name(top, entry.key, pattern, entry.key_span)
        entries.append((entry.key, fields))
    return entries


def _check_name(top: Fields, name: str, pattern: re.Pattern[str], span: Span) -> None:
    if name and not pattern.fullmatch(name):
        top.report(
            "Y113", f"'{name}' cannot be a name in L here", span, "letters and digits, as in goTo or Servo"
        )


def _option(name: str, fields: Fields) -> Option:
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
    fields.done()
    return option


def _fake(fields: Fields, options: Iterable[Option]) -> dict[str, OptionValue]:
    """What a fake has by default for one type of resource; only options can be named."""
    found = {option.name: _default(fields.node(option.name)) for option in options if option.name in fields}
    fields.done()
    return {name: value for name, value in found.items() if value is not None}


def _default(node: Node | None) -> OptionValue | None:
    """A value of an option that stands in a manifest."""
    if isinstance(node, Scalar):
        return node.value
    items = node.items if isinstance(node, Listing) else ()
    values = [item.value for item in items if isinstance(item, Scalar)]
    return [v for v in values if isinstance(v, int | str)] if isinstance(node, Listing) else None


def _limit(name: str, fields: Fields) -> Limit:
    limit = Limit(name, fields.text("unit"), fields.text("meaning"))
    fields.done()
    return limit


def _instruction(name: str, fields: Fields) -> Instruction:
    parameters = tuple(_parameter(p, f) for p, f in _named(fields, "parameters"))
    result = fields.text("result", "void", choices=("void", *DEVICE_VALUE_TYPES))
    effect = fields.text("effect", "actuate", choices=("query", "idempotent", "actuate"))
    instruction = Instruction(
        name,
        parameters,
        result,
        fields.text("unit"),
        cast(Effect, effect),
        fields.flag("blocking"),
        fields.text("meaning"),
        fields.text("channel", "motion"),
        fields.text("cancel"),
    )
    if instruction.is_query:
        fields.report(
            "Y113",
            f"'{name}' is a query that asks nobody",
            fields.span,
            "put it under telemetry, or make it blocking to ask the device",
        )
    fields.done()
    return instruction


def _parameter(name: str, fields: Fields) -> Parameter:
    kind = fields.text("type", "real", required=True, choices=DEVICE_VALUE_TYPES)
    parameter = Parameter(name, kind, fields.text("unit"), fields.text("meaning"), _frame(fields, kind))
    fields.done()
    return parameter


def _quantity(name: str, fields: Fields) -> Quantity:
    kind = fields.text("type", "real", required=True, choices=DEVICE_VALUE_TYPES)
    max_age = fields.number("max_age", 3.0, minimum=0.001)
    unit, meaning, rate = fields.text("unit"), fields.text("meaning"), fields.number("rate", minimum=0.0)
    quantity = Quantity(name, kind, unit, max_age, meaning, rate, _frame(fields, kind))
    fields.done()
    return quantity


def _frame(fields: Fields, kind: str) -> str:
    """What of the team's frame a value of a type is about; only a real, or an array of them, can be."""
    frame = fields.text("frame", choices=FRAME_KINDS)
    if frame and kind not in ("real", "real[]"):
        fields.report("Y113", f"a {kind} is no {frame}", fields.value_span("frame"), "make it real or real[]")
    return frame
