"""The devices of a team as their hosts' events tell of them, and the vehicles that they make. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from lfield.driver.frame import Origin
from lfield.guard.rest import UNSEEN
from lfield.operator.sight.picture.places import USUAL, Instruments, earth, in_frame, local, number, on_earth
from lfield.operator.sight.picture.roll import Enrolled, Roll
from lfield.operator.sight.seen import DeviceSeen, Earth, Reading, VehicleSeen
from lfield.wire.events import Confirmed, Latched, Measured, Moving, Released
from lfield.wire.fields import Telemetry
from lfield.wire.observing import DeviceStatus

#: A host may name whatever it likes: of so many devices is told.
MOST_DEVICES = 4096

DeviceEvent = Latched | Confirmed | Moving | Released | Measured


@dataclass(slots=True)
class _Device:
    """What is known of one; `heard` is when it was last heard (s, our monotonic clock), None for never."""

    host: str
    moves: bool | None
    latched: str = ""
    confirmed: bool = False
    moving: str = ""
    heard: float | None = None
    values: Mapping[str, Telemetry] = field(default_factory=dict)


class Devices:
    """All devices of a team. Times are seconds of the monotonic clock of this computer."""

    def __init__(self, roll: Roll) -> None:
        self._roll = roll
        self._known: dict[str, _Device] = {}
        for name, instruments in roll.devices.items():
            agent = roll.agents.get(agent_of(name))
            self._known[name] = _Device(agent.host if agent else "", instruments.moves)

    def told(self, host: str, event: DeviceEvent, when: float) -> None:
        """An event of a host that happened at `when`."""
        device = self._device(event.device, host)
        match event:
            case Latched(_, _, reason):
                device.latched, device.confirmed, device.moving = reason or "latched", False, ""
                device.moves = True
            case Confirmed(_, _, reason):
                device.latched, device.confirmed = reason or device.latched or "latched", True
                device.moves = True
            case Moving(_, moving):
                device.moving = moving
                # It is seen to be at rest there only where it is there.
                device.confirmed = device.confirmed or not moving
            case Released():
                device.latched, device.confirmed, device.moving = "", False, ""
            case Measured(_, values, silent):
                device.values, device.heard = values, when - silent

    def status(self, host: str, devices: list[DeviceStatus], now: float) -> None:
        """How all devices of a host are."""
        for told in devices:
            device = self._device(told.name, host)
            device.latched, device.confirmed = told.latched, bool(told.latched) and told.moving != UNSEEN
            device.moving = "" if told.moving == UNSEEN else told.moving
            device.moves = True if told.latched else device.moves
            if told.silent is not None:
                device.heard, device.values = now - told.silent, told.telemetry

    def restarted(self, host: str) -> None:
        """Another life of a host, which tells anew how its devices are held."""
        for device in self._known.values():
            if device.host == host:
                device.latched, device.confirmed, device.moving = "", False, ""

    def movable(self, host: str, names: Mapping[str, str]) -> None:
        """These devices of a host have a safe state: it has said whether they are in it."""
        for name in names:
            self._device(name, host).moves = True

    def of(self, host: str) -> Mapping[str, str]:
        """What is not safe yet of the devices of a host that can move, in words by device; '' when it is."""
        return {
            name: _unsafe(device)
            for name, device in self._known.items()
            if device.host == host and (device.moves or (device.moves is None and device.latched))
        }

    @property
    def unsafe(self) -> Mapping[str, str]:
        """The same of all that are not safe yet."""
        return {name: why for name, device in self._known.items() if (why := _unsafe(device))}

    def _device(self, name: str, host: str) -> _Device:
        device = self._known.get(name)
        if device is None:
            device = _Device(host, None)
            if len(self._known) < MOST_DEVICES:
                self._known[name] = device
        device.host = host
        return device

    # --- out ------------------------------------------------------------------------------------------

    def seen(self, now: float, fresh: Mapping[str, bool]) -> dict[str, tuple[DeviceSeen, ...]]:
        """The devices by their agents; `fresh` says of each host whether it is heard."""
        found: dict[str, list[DeviceSeen]] = {}
        for name, device in self._known.items():
            silent = None if device.heard is None else max(0.0, now - device.heard)
            told = DeviceSeen(
                name=name,
                agent=agent_of(name),
                host=device.host,
                fresh=fresh.get(device.host, False),
                moves=device.moves,
                latched=device.latched,
                confirmed=device.confirmed,
                moving=device.moving,
                silent=silent,
                readings={} if silent is None else _readings(device.values, silent),
            )
            found.setdefault(told.agent, []).append(told)
        return {agent: tuple(devices) for agent, devices in found.items()}

    def instruments(self, name: str) -> Instruments:
        """What a device tells: as its manifest says, where that is had."""
        return self._roll.devices.get(name, USUAL)


def agent_of(device: str) -> str:
    """Whose a device is: `alpha` of `alpha.fc`."""
    return device.rpartition(".")[0]


def _unsafe(device: _Device) -> str:
    if device.latched and device.confirmed:
        return ""
    return "its safe state is not confirmed yet" if device.latched else "it is not in its safe state"


def _readings(values: Mapping[str, Telemetry], age: float) -> dict[str, Reading]:
    return {name: Reading(value, age) for name, value in values.items()}


# --- vehicles -----------------------------------------------------------------------------------------------


def earth_of(seen: tuple[DeviceSeen, ...], devices: Devices) -> Earth | None:
    """Where on the Earth the devices of an agent say that it is."""
    places = (earth(device.readings.get(devices.instruments(device.name).earth)) for device in seen)
    return next((place for place in places if place is not None), None)


def vehicle_of(
    enrolled: Enrolled,
    seen: tuple[DeviceSeen, ...],
    refusal: str,
    devices: Devices,
    roll: Roll,
    origin: Origin | None,
) -> VehicleSeen:
    """An agent by what its devices tell: of each quantity what the first one has that tells it at all.

    `origin` is the team's, or a place that a map may take for it. Where nobody has said how the frames of
    vehicles lie, each counts metres from a place of its own, so what it tells of the Earth counts first.
    """
    table = [(device, devices.instruments(device.name)) for device in seen]

    def first(what: str) -> Reading | None:
        for device, instruments in table:
            reading = device.readings.get(getattr(instruments, what))
            if reading is not None and _fits(what, reading):
                return reading
        return None

    where, globe = first("place"), first("earth")
    place, on_globe = local(where), earth(globe)
    measured = where or globe
    stated = place is None and on_globe is None
    height = number(first("height"))
    if height is None and place is not None and place.down is not None:
        height = -place.down
    place = place if not stated else roll.agent_place(enrolled.agent)
    if origin is not None and on_globe is not None and (place is None or not roll.frames):
        place = in_frame(on_globe, origin)
    elif roll.origin is not None and on_globe is None and place is not None:
        on_globe = on_earth(place, roll.origin)
    mode, armed = first("mode"), first("armed")
    ages = [device.silent for device in seen if device.silent is not None]
    return VehicleSeen(
        agent=enrolled.agent,
        type=enrolled.type,
        host=seen[0].host,
        fresh=seen[0].fresh,
        place=place,
        earth=on_globe,
        measured=measured.age if measured is not None else None,
        stated=stated and place is not None,
        heading=number(first("heading")),
        speed=number(first("speed")),
        height=height,
        battery=number(first("battery")),
        mode=str(mode.value) if mode is not None else "",
        armed=bool(armed.value) if armed is not None else None,
        link=min(ages, default=None),
        refusal=refusal,
        devices=seen,
    )


def _fits(what: str, reading: Reading) -> bool:
    """Whether it is what its name says: hosts may tell anything."""
    match what:
        case "place":
            return local(reading) is not None
        case "earth":
            return earth(reading) is not None
        case "mode":
            return isinstance(reading.value, str)
        case "armed":
            return isinstance(reading.value, bool)
        case _:
            return number(reading) is not None
