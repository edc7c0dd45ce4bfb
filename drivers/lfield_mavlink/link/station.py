"""The system id that this computer has towards a vehicle: a ground station of that vehicle alone. Pure.

An ArduPilot's failsafe for the ground station is content as long as any station with the id in MAV_GCS_SYSID
is heard, on whatever link (recorded: with QGroundControl beside it, which has 255 by default, an ArduCopter
flew on in GUIDED when this computer was dead). So each vehicle has a station whose id nobody else uses: not
another ground station, and not this computer as the station of another vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from lfield.driver import DeviceBinding, DeviceError
from lfield_mavlink.link.dialect import COMPONENT, dialect

#: The ids of vehicles and of their stations: 255 is what ground stations have by default.
IDS = 254


def station_of(binding: DeviceBinding) -> int:
    """The system id of this computer towards a vehicle: as its binding says, else by the vehicle's own.

    Two vehicles never have the same by default, and none has its own: 1 has 128, 2 has 129, 128 has 1.
    """
    given: int = binding.option("station")
    system: int = binding.option("system")
    return given or (system - 1 + IDS // 2) % IDS + 1


def check_stations(bindings: Sequence[DeviceBinding]) -> None:
    """Refuse stations that are vehicles, or stations of two of them, on one network. Raises DeviceError."""
    for binding, why in station_conflicts(bindings):
        raise DeviceError(binding.field, why)


def station_conflicts(bindings: Sequence[DeviceBinding]) -> Iterator[tuple[DeviceBinding, str]]:
    """The bindings of a mission whose station is a vehicle or another one's station, each with a sentence.

    Links may lead to one network, so endpoints do not matter; but vehicles with the same system id are never
    on one network, so they may have the same station.
    """
    vehicles: dict[int, DeviceBinding] = {}
    stations: dict[int, DeviceBinding] = {}
    for binding in bindings:
        vehicles.setdefault(binding.option("system"), binding)
    for binding in bindings:
        station = station_of(binding)
        other = stations.setdefault(station, binding)
        if vehicle := vehicles.get(station):
            whose = "itself" if binding.option("system") == station else vehicle.name
            yield (
                binding, f"its station has the system id {station}, which is that of {whose}; {_CHOOSE}"
            )  # fmt: skip
        elif other.option("system") != binding.option("system"):
            yield (
                binding,
                f"its station has the system id {station}, and so has that of {other.name}: the death of one "
                f"would not be noticed; {_CHOOSE}",
            )


_CHOOSE = "choose another by 'station: ID' in its binding, 1 to 254, and run lfield setup again"


def beat(system: int) -> Any:
    """The heartbeat of the station of a vehicle, whose own id it carries: so an echo of it can be told."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, system, dialect.MAV_STATE_ACTIVE, 3
    )


def is_echo(message: Any, system: int) -> bool:
    """Whether a heartbeat with the id of the station of a vehicle is that station's own, sent round."""
    mine = message.type == dialect.MAV_TYPE_GCS and message.get_srcComponent() == COMPONENT
    return bool(mine and message.custom_mode == system)


def why_not_alone(message: Any) -> str:
    """That somebody else has the id of a station, of whom this heartbeat is."""
    who = f"system {message.get_srcSystem()}, component {message.get_srcComponent()}"
    why = "its failsafe would not notice when this computer dies"
    return f"{who} on its links has the id of its station: {why}; {_CHOOSE}"
