"""Checks of live attributes against the telemetry of devices: existence and unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from lfield import units
from lfield.capability.model import Attribute, LiveAttribute, Provider, Registry
from lfield.capability.registry_reader import messages
from lfield.manifest import DeviceManifest, Quantity
from lfield.text.source_text import Diagnostic, Diagnostics
from lfield.text.suggestions import did_you_mean, listed

#: Types of telemetry that can be an attribute of each type; an element of an array counts as a number.
COMPATIBLE_TYPES: Mapping[str, tuple[str, ...]] = {
    "real": ("real", "int"),
    "int": ("int",),
    "boolean": ("boolean",),
    "text": ("string",),
    "set": (),
}


def convert_live_units(
    registry: Registry,
    devices: Mapping[str, Mapping[str, str]],
    manifests: Mapping[str, DeviceManifest],
    found: Diagnostics,
) -> Registry:
    """The registry with every live attribute converted from the unit of its telemetry.

    `devices` are the device fields of the program's resource types with their device types, `manifests` the
    device types by name. An attribute that does not fit is reported, and left out of the returned registry;
    providers that are no type of the program stay as they are.
    """
    providers = {
        name: _settled(registry, provider, devices[name], manifests, found) if name in devices else provider
        for name, provider in registry.providers.items()
    }
    return replace(registry, providers=providers)


def _settled(
    registry: Registry,
    provider: Provider,
    devices: Mapping[str, str],
    manifests: Mapping[str, DeviceManifest],
    diagnostics: Diagnostics,
) -> Provider:
    live_attributes = {}
    for name, live in provider.live.items():
        if live.portal:
            live_attributes[name] = live
            continue
        manifest = manifests.get(devices.get(live.device, ""))
        if manifest is None:
            diagnostics.add(
                _no_device(provider, live, [name for name in devices if devices[name] in manifests])
            )
            continue
        settled = _from_device(registry.attributes[name], live, manifest, diagnostics)
        if settled is not None:
            live_attributes[name] = settled
    return replace(provider, live=live_attributes)


def _no_device(provider: Provider, live: LiveAttribute, devices: Sequence[str]) -> Diagnostic:
    hint = did_you_mean(live.device, devices) or ("it has none" if not devices else None)
    return messages.NO_DEVICE.at(
        live.span, hint=hint, type=provider.type, device=live.device, devices=listed(devices)
    )


def _from_device(
    attribute: Attribute, live: LiveAttribute, manifest: DeviceManifest, diagnostics: Diagnostics
) -> LiveAttribute | None:
    """One live attribute with its telemetry; None after a mistake."""
    quantities = {quantity.name: quantity for quantity in manifest.telemetry}
    quantity = quantities.get(live.quantity)
    if quantity is None:
        diagnostics.add(
            messages.NO_QUANTITY.at(
                live.span,
                hint=did_you_mean(live.quantity, quantities),
                device=live.device,
                device_type=manifest.type,
                quantity=live.quantity,
                quantities=listed(quantities),
            )
        )
        return None
    if element(quantity.type, live.index) not in COMPATIBLE_TYPES[attribute.type]:
        diagnostics.add(
            messages.WRONG_QUANTITY.at(
                live.span,
                attribute=attribute.name,
                expected=attribute.type,
                quantity=f"{live.device}.{live.quantity}",
                given=quantity.type,
            )
        )
        return None
    return _converted(attribute, live, quantity, diagnostics)


def element(type: str, index: int | None) -> str:
    """The type of a reading: an element of an array if an index is given."""
    if index is None:
        return type
    return type.removesuffix("[]") if type.endswith("[]") else "no array"


def _converted(
    attribute: Attribute, live: LiveAttribute, quantity: Quantity, found: Diagnostics
) -> LiveAttribute | None:
    if live.unit or attribute.type not in ("real", "int"):
        return live
    conversion = units.conversion(quantity.unit, attribute.unit)
    if conversion is None:
        found.add(
            messages.OTHER_DIMENSION.at(live.span, given=quantity.unit or "1", expected=attribute.unit or "1")
        )
        return None
    return replace(live, factor=conversion[0], offset=conversion[1])
