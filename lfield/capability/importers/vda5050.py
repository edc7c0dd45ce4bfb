"""Factsheets of VDA 5050 as providers: what a vehicle is able to, in numbers.

A factsheet describes a series of vehicles: it becomes a resource type with attributes. How such a vehicle is
moved is said by a resource in L, which the factsheet knows nothing of, so the type serves nothing yet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from lfield.capability.importers.draft import Draft, clean

#: The section that only a factsheet has.
SIGN = "typeSpecification"

#: Attributes and where they come from: the names of version 2, then those of version 3.
_NUMBERS = {
    "speed": ("physicalParameters", ("speedMax", "maximumSpeed")),
    "turn_rate": ("physicalParameters", ("angularSpeedMax", "maximumAngularSpeed")),
}
_LOAD = ("maxLoadMass", "maximumLoadMass")
_WEIGHT = ("maxWeight", "maximumWeight")
_KINEMATICS = ("agvKinematic", "mobileRobotKinematics")

#: Kinematics that have wheels: all that the standard lists.
_WHEELED = ("DIFF", "OMNI", "THREEWHEEL", "DIFFERENTIAL", "OMNIDIRECTIONAL", "THREE_WHEEL")

#: Keys of the message itself, and of texts that are used.
_HEADER = ("headerId", "timestamp", "version", "manufacturer", "serialNumber")
_USED = ("seriesName", "seriesDescription", *_KINEMATICS)

_REASONS = {
    "protocolLimits": "limits of messages that L does not send",
    "agvGeometry": "no attribute is a shape",
    "mobileRobotGeometry": "no attribute is a shape",
    "localizationParameters": "the resource in L knows how it finds its place",
    "vehicleConfig": "it is about one vehicle, not about its type",
    "mobileRobotConfiguration": "it is about one vehicle, not about its type",
}
_NO_ATTRIBUTE = "no attribute of the registry says it"


def add_factsheet(file: str, sheet: Mapping[str, Any], draft: Draft) -> None:
    """Add the vehicle of a factsheet as a provider; whatever is of the wrong type is left out and told."""
    specification = _section(sheet, SIGN)
    series = _text(specification, "seriesName") or "Vehicle"
    type = draft.new_type(series, _text(sheet, "manufacturer"))
    used: set[tuple[str, str]] = {(SIGN, key) for key in _USED}
    attributes = dict(_attributes(sheet, draft, used))
    meaning = clean(_text(specification, "seriesDescription") or series)
    draft.providers[type] = {"meaning": meaning, "attributes": attributes, "serves": {}}
    draft.note(file, f"what {type} serves: write the resource in L and add its primitives, such as GoTo")
    for section, value in sheet.items():
        if section not in _HEADER:
            for text in _left(section, value, used):
                draft.note(file, text)


def _attributes(
    sheet: Mapping[str, Any], draft: Draft, used: set[tuple[str, str]]
) -> Iterator[tuple[str, Any]]:
    """Attributes that the registry has, with their values; where they come from goes to `used`."""
    known = draft.registry.attributes
    specification = _section(sheet, SIGN)
    found: dict[str, Any] = {"payload": _payload(sheet, used)}
    for name, (section, keys) in _NUMBERS.items():
        found[name] = _number(_section(sheet, section), keys, section, used)
    if any(_text(specification, key) in _WHEELED for key in _KINEMATICS):
        found["chassis"] = "wheels"
    found["environment"] = ["terrestrial"]
    yield from ((name, value) for name, value in found.items() if value is not None and name in known)


def _payload(sheet: Mapping[str, Any], used: set[tuple[str, str]]) -> float | None:
    """The heaviest load of all; else that of its heaviest set of loads."""
    whole = _number(_section(sheet, SIGN), _LOAD, SIGN, used)
    if whole is not None:
        return whole
    sets = _section(sheet, "loadSpecification").get("loadSets")
    weights = [
        _number(load, _WEIGHT, "loadSpecification", used)
        for load in (sets if isinstance(sets, list) else [])
        if isinstance(load, Mapping)
    ]
    return max((weight for weight in weights if weight is not None), default=None)


def _number(
    section: Mapping[str, Any], keys: tuple[str, ...], name: str, used: set[tuple[str, str]]
) -> float | None:
    """The first of the keys that is a number above 0: in a factsheet 0 often stands for not stated."""
    for key in keys:
        value = section.get(key)
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e9:
            used.add((name, key))
            return float(value) if math.isfinite(value) else None
    return None


def _left(section: str, value: Any, used: set[tuple[str, str]]) -> Iterator[str]:
    """What of a section could not be carried over."""
    if section in _REASONS or not isinstance(value, Mapping):
        yield f"{clean(section)}: {_REASONS.get(section, _NO_ATTRIBUTE)}"
        return
    for key, inner in value.items():
        if (section, key) in used:
            continue
        if key in ("agvActions", "mobileRobotActions") and isinstance(inner, list):
            yield from (f"action '{_text(a, 'actionType')}': a portal of your resource" for a in inner)
        elif key == "loadSets" and isinstance(inner, list):
            yield from (f"load set '{_text(load, 'setName')}': one payload stands for all" for load in inner)
        else:
            yield f"{clean(section)}.{clean(key)}{_shown(inner)}: {_NO_ATTRIBUTE}"


def _shown(value: Any) -> str:
    """A plain value, so that whoever reads the note can use it."""
    if isinstance(value, str):
        return f" ({clean(value)})"
    return f" ({value:g})" if isinstance(value, int | float) and abs(value) < 1e18 else ""


def _section(sheet: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = sheet.get(name)
    return value if isinstance(value, Mapping) else {}


def _text(mapping: Any, key: str) -> str:
    value = mapping.get(key) if isinstance(mapping, Mapping) else None
    return clean(value) if isinstance(value, str) else ""
