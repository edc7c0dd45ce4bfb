"""The devices of a host, from its snapshot and events, and the vehicles that they make. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct, field

from lfield.driver.frame import Origin
from lfield.guard.standstill import UNCONFIRMED
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.team_state import (
    DeviceState,
    GeoPosition,
    TelemetryReading,
    VehicleState,
    agent_of,
)
from lfield.operator.team_model.vehicle_readings import (
    geo_to_local,
    local_to_geo,
    to_geo_position,
    to_local_position,
    to_number,
)
from lfield.wire.events import (
    DeviceLatched,
    DeviceMoving,
    DeviceReleased,
    DeviceTelemetry,
    SafeStateConfirmed,
)
from lfield.wire.fields import Telemetry
from lfield.wire.observer_messages import DeviceStatus

#: The most devices of one host: a host may name any number.
MAX_DEVICES = 4096
#: Radius of a fence in metres from which on it counts as none.
NO_FENCE = 1e6

DeviceEvent = DeviceLatched | SafeStateConfirmed | DeviceMoving | DeviceReleased | DeviceTelemetry


class _Device(Struct):
    """One device; `last_contact` is the time when its newest telemetry was measured (s, our monotonic
    clock).
    """

    has_safe_state: bool | None = None
    latched: str = ""
    confirmed: bool = False
    moving: str = ""
    last_contact: float | None = None
    values: Mapping[str, Telemetry] = field(default_factory=dict)


class DeviceTracker:
    """The devices of a host: at first the keys of `has_safe_state`."""

    def __init__(self, has_safe_state: Mapping[str, bool | None]) -> None:
        self._known = {name: _Device(each) for name, each in has_safe_state.items()}

    def on_event(self, event: DeviceEvent, when: float) -> None:
        """Handle an event that happened at `when`."""
        device = self._device(event.device)
        match event:
            case DeviceLatched(_, _, reason):
                device.latched, device.confirmed, device.moving = reason or "latched", False, ""
                device.has_safe_state = True
            case SafeStateConfirmed(_, _, reason):
                device.latched, device.confirmed = reason or device.latched or "latched", True
                device.has_safe_state = True
            case DeviceMoving(_, moving):
                device.moving = moving
                # At rest only counts once the safe state is confirmed.
                device.confirmed = device.confirmed or not moving
            case DeviceReleased():
                device.latched, device.confirmed, device.moving = "", False, ""
            case DeviceTelemetry(_, values, silent):
                device.values, device.last_contact = values, when - silent

    def on_snapshot(self, devices: Iterable[DeviceStatus], now: float) -> None:
        """Handle the state of all devices of the host."""
        for reported in devices:
            device = self._device(reported.name)
            device.latched, device.confirmed = (
                reported.latched,
                bool(reported.latched) and reported.moving != UNCONFIRMED,
            )
            device.moving = "" if reported.moving == UNCONFIRMED else reported.moving
            device.has_safe_state = True if reported.latched else device.has_safe_state
            if reported.silent is not None:
                device.last_contact, device.values = now - reported.silent, reported.telemetry

    def on_restarted(self) -> None:
        """Clear the states for a new incarnation of the host, which reports them again."""
        for device in self._known.values():
            device.latched, device.confirmed, device.moving = "", False, ""

    def on_movable(self, names: Iterable[str]) -> None:
        """Mark devices as having a safe state: a host reports whether a device is in it only for these."""
        for name in names:
            self._device(name).has_safe_state = True

    @property
    def problems(self) -> Mapping[str, str]:
        """The movable devices, each with the reason why it is not safe; '' if it is."""
        return {
            name: _unsafe_reason(device)
            for name, device in self._known.items()
            if device.has_safe_state or (device.has_safe_state is None and device.latched)
        }

    def states(self, host: str, now: float, *, fresh: bool) -> dict[str, DeviceState]:
        """The devices by name; `fresh` says whether there is a link to the host."""
        return {name: _state(name, device, host, now, fresh) for name, device in self._known.items()}

    def _device(self, name: str) -> _Device:
        device = self._known.get(name)
        if device is None:
            device = _Device()
            if len(self._known) < MAX_DEVICES:
                self._known[name] = device
        return device


def _unsafe_reason(device: _Device) -> str:
    if device.latched and device.confirmed:
        return ""
    return "its safe state is not confirmed yet" if device.latched else "it is not in its safe state"


def _state(name: str, device: _Device, host: str, now: float, fresh: bool) -> DeviceState:
    silent = None if device.last_contact is None else max(0.0, now - device.last_contact)
    values = device.values if silent is not None else {}
    return DeviceState(
        name=name,
        agent=agent_of(name),
        host=host,
        fresh=fresh,
        has_safe_state=device.has_safe_state,
        latched=device.latched,
        confirmed=device.confirmed,
        moving=device.moving,
        telemetry_age=silent,
        readings={each: TelemetryReading(value, silent or 0.0) for each, value in values.items()},
    )


# --- vehicles -----------------------------------------------------------------------------------------------


def geo_position_of(state: Sequence[DeviceState], inventory: TeamContents) -> GeoPosition | None:
    """The position on the Earth according to the devices of an agent."""
    places = (
        to_geo_position(device.readings.get(inventory.instruments(device.name).geo_position))
        for device in state
    )
    return next((place for place in places if place is not None), None)


def vehicle_of(
    entry: TeamEntry,
    state: tuple[DeviceState, ...],
    refusal: str,
    inventory: TeamContents,
    origin: Origin | None,
) -> VehicleState:
    """An agent as a vehicle: each quantity from the first of its devices that has it.

    `origin` is the team's, or a substitute for the map. Without a common frame each vehicle has its own
    origin, so its position on the Earth takes precedence.
    """
    table = [(device, inventory.instruments(device.name)) for device in state]

    def first(quantity: str) -> TelemetryReading | None:
        for device, instruments in table:
            reading = device.readings.get(getattr(instruments, quantity))
            if reading is not None and _fits(quantity, reading):
                return reading
        return None

    measured = first("position"), first("geo_position")
    place, geo = to_local_position(measured[0]), to_geo_position(measured[1])
    newest = measured[0] or measured[1]
    stated = place is None and geo is None
    height = to_number(first("height"))
    if height is None and place is not None and place.down is not None:
        height = -place.down
    place = place if not stated else inventory.agent_place(entry.agent)
    if origin is not None and geo is not None and (place is None or not inventory.frames):
        place = geo_to_local(geo, origin)
    elif inventory.origin is not None and geo is None and place is not None:
        geo = local_to_geo(place, inventory.origin)
    mode, armed = first("mode"), first("armed")
    fence = to_number(first("fence"))
    limits = [inventory.limits.get(device.name, {}) for device in state]
    ages = [device.telemetry_age for device in state if device.telemetry_age is not None]
    return VehicleState(
        agent=entry.agent,
        type=entry.type,
        host=state[0].host,
        fresh=state[0].fresh,
        position=place,
        geo_position=geo,
        position_age=newest.age if newest is not None else None,
        is_position_stated=stated and place is not None,
        heading=to_number(first("heading")),
        speed=to_number(first("speed")),
        height=height,
        battery=to_number(first("battery")),
        mode=str(mode.value) if mode is not None else "",
        armed=bool(armed.value) if armed is not None else None,
        telemetry_age=min(ages, default=None),
        refusal=refusal,
        devices=state,
        home=to_geo_position(first("home")),
        radius=min((each["radius"] for each in limits if "radius" in each), default=None),
        ceiling=min((each["altitude"] for each in limits if "altitude" in each), default=None),
        fence=fence if fence is not None and 0.0 < fence < NO_FENCE else None,
    )


def _fits(quantity: str, reading: TelemetryReading) -> bool:
    """Whether a reading is plausible for its name: hosts may report anything."""
    match quantity:
        case "position":
            return to_local_position(reading) is not None
        case "geo_position" | "home":
            return to_geo_position(reading) is not None
        case "mode":
            return isinstance(reading.value, str)
        case "armed":
            return isinstance(reading.value, bool)
        case _:
            return to_number(reading) is not None
