"""The system id of this computer towards a vehicle: one ground station per vehicle. Pure.

ArduPilot's ground station failsafe is prevented by any station with the id in MAV_GCS_SYSID, on any link
(recorded: with QGroundControl, default id 255, an ArduCopter stayed in GUIDED after this computer had
failed). Therefore each vehicle has a station id that is used by no other ground station and for no other
vehicle. `lfield check` imports this module, so it does not import pymavlink.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from lfield.driver import DeviceBinding, DeviceError

#: Range of ids of vehicles and stations: 255 is the default of ground stations.
IDS = 254
#: The remedy for a conflict.
_CHOOSE = "choose another by 'station: ID' in its binding, 1 to 254, and run lfield setup again"


def station_of(binding: DeviceBinding) -> int:
    """The system id of this computer towards a vehicle: from its binding, else derived from the vehicle's.

    Defaults never coincide for two vehicles, nor with the vehicle itself: 1 has 128, 2 has 129, 128 has 1.
    """
    configured: int = binding.option("station")
    system: int = binding.option("system")
    return configured or (system - 1 + IDS // 2) % IDS + 1


def check_stations(bindings: Sequence[DeviceBinding]) -> None:
    """Refuses stations whose id is a vehicle's or another station's on the same network. Raises
    DeviceError.
    """
    for binding, reason in station_conflicts(bindings):
        raise DeviceError(binding.field, reason)


def station_conflicts(bindings: Sequence[DeviceBinding]) -> Iterator[tuple[DeviceBinding, str]]:
    """The bindings of a mission whose station conflicts with a vehicle or another station, each with a
    sentence.

    Links may lead to one network, so endpoints do not matter; vehicles with the same system id cannot share a
    network, so they may have the same station.
    """
    vehicles: dict[int, DeviceBinding] = {}
    stations: dict[int, DeviceBinding] = {}
    for binding in bindings:
        vehicles.setdefault(binding.option("system"), binding)
    for binding in bindings:
        station = station_of(binding)
        other = stations.setdefault(station, binding)
        if vehicle := vehicles.get(station):
            owner = "itself" if binding.option("system") == station else vehicle.name
            yield (
                binding, f"its station has the system id {station}, which belongs to {owner}; {_CHOOSE}"
            )  # fmt: skip
        elif other.option("system") != binding.option("system"):
            yield (
                binding,
                f"its station has the system id {station}, as has that of {other.name}: the failure of one "
                f"would not be noticed; {_CHOOSE}",
            )


def station_conflict_text(message: Any) -> str:
    """Describes another sender with the id of a station, from its heartbeat."""
    sender = f"system {message.get_srcSystem()}, component {message.get_srcComponent()}"
    consequence = "its failsafe would not notice when this computer fails"
    return f"{sender} on its links has the id of its station: {consequence}; {_CHOOSE}"
