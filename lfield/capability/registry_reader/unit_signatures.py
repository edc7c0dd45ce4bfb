"""Parameter and result types of portals: of the primitives, of a program's resources and classes.

Types are names of L (`real`, `int[]`), as in manifests and the registry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from msgspec import Struct, field

from lfield.capability.model import Argument, Portal
from lfield.lang import syntax
from lfield.lang.tree import UnitKind, Usage
from lfield.lang.types import BUILTIN_EXCEPTIONS
from lfield.manifest import DEVICE_VALUE_TYPES

#: L types that a canonical portal may take and emit.
PORTAL_TYPES = (*DEVICE_VALUE_TYPES, "string[]")


#: Types of L whose names no primitive can have.
RESERVED_TYPES = frozenset({"Exception", "Offer", *BUILTIN_EXCEPTIONS})

#: Parameter types and the type of the result, 'void' for none.
Overload = tuple[tuple[str, ...], str]


class Signature(Struct, frozen=True):
    """The public interface of a resource, class or coordinator of a program.

    `portals` are the overloads by name: portals of a resource, public methods of a class. `constructors`
    are their parameter types; `devices` are the fields of a resource with their types.
    """

    name: str
    portals: Mapping[str, Sequence[Overload]]
    devices: Mapping[str, str] = field(default_factory=dict)
    constructors: Sequence[tuple[str, ...]] = ()
    kind: UnitKind = "resource"
    usage: Usage = "global"


def signatures_of(files: Sequence[syntax.ParsedFile]) -> dict[str, Signature]:
    """The signatures of all units of some parsed files, by name."""
    return {unit.name: _signature(unit) for file in files for unit in file.units}


def _signature(unit: syntax.Unit) -> Signature:
    kind: Literal["portal", "method"] = "portal" if unit.kind == "resource" else "method"
    portals: dict[str, list[Overload]] = {}
    constructors = []
    for method in unit.methods:
        parameters = tuple(str(p.type) for p in method.parameters)
        if method.kind == "constructor":
            constructors.append(parameters)
        elif method.kind == kind and (method.public or kind == "portal"):
            result = str(method.result) if method.result is not None else "void"
            portals.setdefault(method.name, []).append((parameters, result))
    devices = {f.name: str(f.type) for f in unit.fields} if unit.kind == "resource" else {}
    return Signature(unit.name, portals, devices, constructors, unit.kind, unit.usage)


def fits(actual: str, expected: str) -> bool:
    """Whether a value of one type is accepted for another: the same type, or an int for a real."""
    return actual == expected or (actual == "int" and expected == "real") or "?" in (actual, expected)


def fits_all(actual: Sequence[str], expected: Sequence[str]) -> bool:
    """Whether arguments of some types can be given for parameters of others."""
    return len(actual) == len(expected) and all(map(fits, actual, expected))


def argument_type(argument: Argument, portal: Portal) -> str:
    """The L type of a mapped argument; a converted number is a real. '?' for an unknown parameter."""
    if argument.constant is not None:
        return constant_type(argument.constant)
    types = [p.type for p in portal.parameters if p.name == argument.parameter]
    if not types:
        return "?"
    unchanged = argument.factor == 1 and argument.offset == 0
    return types[0] if unchanged or types[0] != "int" else "real"


def constant_type(value: float | int | bool | str) -> str:
    """The L type of a constant."""
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int):
        return "int"
    return "string" if isinstance(value, str) else "real"


def same_call(left: Portal, right: Portal) -> bool:
    """Whether two canonical portals take and emit the same, in the same units; names do not count."""
    return _shape(left) == _shape(right)


def _shape(portal: Portal) -> tuple[object, ...]:
    parameters = tuple((p.type, p.unit) for p in portal.parameters)
    return parameters, portal.result, portal.unit


def written(name: str, parameters: Sequence[str], result: str = "") -> str:
    """A call as L would declare it: `real lift(real)`."""
    return f"{result} {name}({', '.join(parameters)})".strip()
