"""Checks of a registry against a compiled program: the attributes of its resources."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from msgspec.structs import replace

from lfield.bytecode.disassembler import type_name
from lfield.bytecode.program import MethodRecord, Program
from lfield.capability.condition_compiler import compile_constants
from lfield.capability.model import Registry
from lfield.capability.program_types.live_units import convert_live_units
from lfield.capability.program_types.program_check import (
    check_against,
    check_classes,
    check_feed_portals,
    check_types,
    satisfied,
)
from lfield.capability.registry_reader.registry_files import is_shipped
from lfield.capability.registry_reader.unit_signatures import Overload, Signature
from lfield.driver.plugins import Plugins
from lfield.errors import ProgramError
from lfield.text.source_text import Diagnostic, Diagnostics


def resources_of(program: Program) -> dict[str, Signature]:
    """The signatures of its resource types by name, as `signatures_of` reads them from the source."""
    core = program.core
    portals: dict[int, dict[str, list[Overload]]] = {
        index: {} for index, record in enumerate(core.classes) if record.kind == "resource"
    }
    for method in core.methods:
        if method.kind == "portal":
            portals[method.owner].setdefault(method.name, []).append(_overload(program, method))
    return {
        core.classes[index].name: Signature(
            core.classes[index].name,
            found,
            {field.name: field.type for field in core.classes[index].devices},
            usage=core.classes[index].usage,
        )
        for index, found in portals.items()
    }


def _overload(program: Program, method: MethodRecord) -> Overload:
    """The parameter types and the result of a portal; its first slot is the object."""
    parameters = method.slots[1 : 1 + method.parameters]
    return tuple(type_name(program, kind) for kind in parameters), type_name(program, method.result)


def check_mission_registry(
    registry: Registry, own: Path, program: Program, plugins: Plugins, hollow: Collection[str] = ()
) -> list[Diagnostic]:
    """The mistakes of a mission's `own` file in relation to its program. `hollow` types have no devices."""
    resources, found = resources_of(program), Diagnostics()
    check_types(registry, own, resources, plugins.find_source, found)
    check_against(registry, resources, found)
    check_classes(_only_of(registry, own), found)
    check_feed_portals(registry, program, found)
    convert_live_units(registry, _devices(resources, hollow), plugins.device_types, found)
    return [mistake for mistake in found.in_order() if not is_shipped(mistake)]


def restrict_to_program(
    registry: Registry, program: Program, plugins: Plugins, hollow: Collection[str] = ()
) -> Registry:
    """The registry as far as a program fulfils it, its live attributes in their own units.

    A shipped provider may not fit a resource of the program with the same name: then it does not count.
    `hollow` types have no devices. The queries among the constants of the program are compiled.
    Raises ProgramError.
    """
    resources, found = resources_of(program), Diagnostics()
    devices = _devices(resources, hollow)
    fitting = convert_live_units(satisfied(registry, resources), devices, plugins.device_types, found)
    if mistakes := [mistake for mistake in found.errors if not is_shipped(mistake)]:
        raise ProgramError(mistakes)
    return replace(fitting, constraints=compile_constants(program.core.constants, fitting.attributes))


def _devices(resources: Mapping[str, Signature], hollow: Collection[str]) -> dict[str, Mapping[str, str]]:
    """The devices of each resource type, by their fields."""
    return {name: resource.devices for name, resource in resources.items() if name not in hollow}


def _only_of(registry: Registry, own: Path) -> Registry:
    """A registry with no other one-to-many rules than those of a file."""
    rules = registry.compositions.items()
    return replace(registry, compositions={n: r for n, r in rules if r.span.source.name == str(own)})
