"""Command line of the simulated device as data: endpoints, vehicles, settings. Imports no vendor library."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

from msgspec import Struct

from lfield.errors import UsageError

#: Beyond the range of an integer parameter.
LARGEST = 2.0**31
#: Metres between vehicles without a given position.
APART = 5.0
#: Maximum distance in metres from the common starting point.
FARTHEST = 1e6
#: Bits of a random board id.
BOARD_BITS = 95
KINDS, FLAVOURS = ("copter", "rover", "rover_skid"), ("ardupilot", "px4")
#: The rover that turns on the spot; a plain `rover` has steered wheels.
SKID = "rover_skid"
#: Options of motion limits: the option, the limit (see `flavours.VehicleKind.speeds`), unit, meaning.
SPEEDS = (
    ("--cruise", "M/S", "ground speed (default: 10; PX4 and rovers 5)"),
    ("--climb", "M/S", "climb speed (default: 2.5; PX4 3)"),
    ("--descend", "M/S", "descent speed (default: 1.5)"),
    ("--land", "M/S", "landing speed below 10 m (default: 0.5; PX4 0.7)"),
    ("--acceleration", "M/S2", "acceleration and deceleration (default: 2.5; PX4 3, rovers 1)"),
)


#: Optional payload (see `equipment.payload`): on the outputs of the autopilot, and with MAVLink.
HARDWARE = ("camera", "gimbal", "gripper", "winch")
COMPONENTS = ("mavlink_camera", "mavlink_gimbal")


class VehicleOption(Struct, frozen=True):
    """One vehicle of the link; `name` is that of its binding, or ''."""

    system: int
    kind: str = "copter"
    flavour: str = "ardupilot"
    name: str = ""

    def __str__(self) -> str:
        return f"{self.system}:{self.kind}:{self.flavour}" + (f":{self.name}" if self.name else "")


class Stand(Struct, frozen=True):
    """The place of power-on of a vehicle: metres north, east and down of the common starting point.

    `heading` (rad, clockwise) is the direction of its own north, for a vehicle without satellites or compass.
    """

    north: float = 0.0
    east: float = 0.0
    down: float = 0.0
    heading: float = 0.0

    def __str__(self) -> str:
        return f"{self.north!r},{self.east!r},{self.down!r},{self.heading!r}"


def origin(text: str) -> tuple[float, float, float]:
    """`LATITUDE,LONGITUDE,ALTITUDE`: degrees, and metres above mean sea level."""
    latitude, longitude, altitude = _numbers(text, 3)
    if not (abs(latitude) < 90.0 and abs(longitude) <= 180.0):
        raise argparse.ArgumentTypeError("LATITUDE,LONGITUDE,ALTITUDE in degrees and metres")
    return latitude, longitude, altitude


def stand(text: str) -> tuple[int, Stand]:
    """`SYSTEM:NORTH,EAST,DOWN,HEADING`."""
    number, _, rest = text.partition(":")
    return system(number), Stand(*_numbers(rest, 4))


def _numbers(text: str, count: int) -> list[float]:
    try:
        numbers = [float(each) for each in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) <= FARTHEST for number in numbers):
        raise argparse.ArgumentTypeError(f"{count} numbers with commas between")
    return numbers


def system(text: str) -> int:
    """A MAVLink system id."""
    if not text.isdecimal() or not 1 <= int(text[:4]) <= 254:
        raise argparse.ArgumentTypeError("a system id from 1 to 254")
    return int(text)


def board(text: str) -> int:
    """A board id in hexadecimal; those of all vehicles of a link fit 96 bits."""
    try:
        value = int(text, 16)
    except ValueError:
        value = -1
    if not 0 <= value < 1 << BOARD_BITS:
        raise argparse.ArgumentTypeError(f"a hexadecimal number of {BOARD_BITS} bits")
    return value


def fitted(text: str) -> frozenset[str]:
    """Payload of the vehicles: `all` of HARDWARE, `none`, or some with commas between, also of COMPONENTS."""
    if text in ("all", "none"):
        return frozenset(HARDWARE if text == "all" else ())
    names = frozenset(text.split(","))
    hardware = (*HARDWARE, *COMPONENTS)
    if not names <= frozenset(hardware):
        raise argparse.ArgumentTypeError(f"all, none, or some of {', '.join(hardware)}, by commas")
    return names


def vehicle(text: str) -> VehicleOption:
    """`SYSTEM[:KIND[:FLAVOUR[:NAME]]]`."""
    number, *fields = text.split(":", 3)
    option = VehicleOption(system(number), *fields)
    if option.kind not in KINDS or option.flavour not in FLAVOURS:
        raise argparse.ArgumentTypeError(
            f"SYSTEM[:KIND[:FLAVOUR[:NAME]]], KIND one of {', '.join(KINDS)}, "
            f"FLAVOUR one of {', '.join(FLAVOURS)}"
        )
    return option


def vehicles(args: argparse.Namespace) -> list[VehicleOption]:
    """The vehicles of a command line. Raises UsageError when two have one system id."""
    options: list[VehicleOption] = args.vehicle or [VehicleOption(args.system, args.kind, args.flavour)]
    if any(each.kind == SKID and each.flavour != "ardupilot" for each in options):
        raise UsageError("a rover_skid is ArduPilot's; PX4's rover steers by its wheels")
    systems = [each.system for each in options]
    if len(set(systems)) < len(systems):
        raise UsageError("two vehicles of one link have the same system id; give each its own")
    return options


def parse_listen(text: str) -> tuple[str, str, int]:
    """Splits `udp:HOST:PORT`, `tcp:HOST:PORT` or `pty`. Raises UsageError."""
    if text == "pty":
        return "pty", "", 0
    transport, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    if transport not in ("udp", "tcp") or not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"cannot listen on '{text}'; write udp:HOST:PORT, tcp:HOST:PORT (port 0: any free one) or pty"
        )
    return transport, host, int(port)


def settings(args: argparse.Namespace) -> dict[int, dict[str, float]]:
    """`--param NAME[@SYSTEM]=VALUE` as names and values by system, 0 for all. Raises UsageError."""
    parameters: dict[int, dict[str, float]] = {}
    for text in args.param:
        names, _, value = text.partition("=")
        name, at, number = names.partition("@")
        try:
            setting, system_id = float(value), int(number) if at else 0
        except ValueError:
            raise UsageError(f"--param {text}: write NAME=NUMBER, or NAME@SYSTEM=NUMBER") from None
        if not abs(setting) < LARGEST:
            raise UsageError(f"--param {text}: no parameter can hold that")
        parameters.setdefault(system_id, {})[name] = setting
    return parameters


def speeds(args: argparse.Namespace) -> Mapping[str, float]:
    """The given motion limits, in SI units."""
    named = {option.removeprefix("--"): getattr(args, option.removeprefix("--")) for option, *_ in SPEEDS}
    return {limit: value for limit, value in named.items() if value is not None}
