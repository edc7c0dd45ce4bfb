"""Portals, telemetry and manifest ids that the shipped providers use exist in the stock resource types."""

from __future__ import annotations

import pytest
from shipped_registry import DEVICES, PLUGINS, REGISTRY, stock_source

from lfield.capability.registry_reader.unit_signatures import Signature, argument_type, fits, signatures_of
from lfield.lang.parser import parse_file
from lfield.manifest import DeviceManifest
from lfield.text.source_text import Diagnostics, Source

STOCK = sorted(REGISTRY.providers)
#: The tool that a primitive of a vehicle needs.
TOOLS = {
    "Grip": "gripper",
    "Lift": "winch",
    "Photograph": "camera",
    "PhotographSeries": "camera",
    "Film": "camera",
    "Aim": "gimbal",
    "TrackPlace": "gimbal",
}


def signature(type_name: str) -> Signature:
    """The signature of a stock resource type."""
    path = stock_source(REGISTRY.providers[type_name].include)
    file = parse_file(Source(str(path), path.read_text(encoding="utf-8")), Diagnostics())
    return signatures_of([file])[type_name]


def device(type_name: str, field: str) -> DeviceManifest:
    """The manifest of a device field of a stock resource type."""
    return DEVICES[signature(type_name).devices[field]]


def test_every_stock_resource_type_is_a_provider() -> None:
    folders = {stock_source(REGISTRY.providers[name].include).parent for name in STOCK}
    assert len(folders) == len(PLUGINS)
    files = {path.stem.title().replace("_", "") for folder in folders for path in folder.glob("*.L")}
    assert files == set(STOCK)


@pytest.mark.parametrize("name", STOCK)
def test_mapped_portals_exist_with_fitting_types(name: str) -> None:
    portals = signature(name).portals
    for served in REGISTRY.providers[name].serves.values():
        for canonical in REGISTRY.primitives[served.primitive].portals.values():
            call = served.portals[canonical.name]
            arguments = [argument_type(argument, canonical) for argument in call.arguments]
            fitting = [
                result
                for types, result in portals.get(call.target, [])
                if len(types) == len(arguments) and all(map(fits, arguments, types))
            ]
            assert fitting, f"{name}.{call.target}({', '.join(arguments)}) for {served.primitive}"
            if call.result is None:
                assert canonical.result in ("void", *fitting), f"{name}.{call.target} for {served.primitive}"


@pytest.mark.parametrize("name", STOCK)
def test_live_attributes_are_telemetry(name: str) -> None:
    for live in REGISTRY.providers[name].live.values():
        quantities = {q.name: q for q in device(name, live.device).telemetry}
        quantity = quantities[live.quantity]
        # A value that is not measured is reported once and never expires.
        assert REGISTRY.attributes[live.attribute].live or quantity.max_age >= 1e9
        assert quantity.type.endswith("[]") == (live.index is not None)


@pytest.mark.parametrize("name", STOCK)
def test_class_of_machine_is_stated(name: str) -> None:
    stated = REGISTRY.providers[name].attributes
    assert {"environment", "emissions", "chassis", "limbs"} <= set(stated)


@pytest.mark.parametrize("name", ["Copter", "Rover"])
@pytest.mark.parametrize("primitive", sorted(TOOLS))
def test_optional_tools_are_a_condition(name: str, primitive: str) -> None:
    provider = REGISTRY.providers[name]
    tool = TOOLS[primitive]
    condition = provider.serves[primitive].when
    assert condition is not None
    assert condition.text == f"tools == {tool}"
    assert provider.attributes["tools"] == frozenset()


def test_every_primitive_is_served_by_a_stock_resource_or_a_rule() -> None:
    served: set[str] = set()
    while new := sorted(_served_by(served) - served):
        served |= set(new)
    assert REGISTRY.primitives.keys() == served


def _served_by(served: set[str]) -> set[str]:
    """Primitives of the stock resources, and those that rules derive from `served`."""
    found = {name for provider in REGISTRY.providers.values() for name in provider.serves}
    found |= {rule.serves for rule in REGISTRY.equivalences.values() if rule.by in served}
    for rule in REGISTRY.compositions.values():
        if all(need.primitive in served for need in rule.needs.values()):
            found.add(rule.serves)
    return found
