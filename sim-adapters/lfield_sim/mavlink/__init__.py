"""The MAVLink fake for the command line: `lfield sim mavlink`. pymavlink is imported when it runs."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Mapping, Sequence

from lfield.driver.binding import DeviceBinding
from lfield.errors import PluginError, UsageError


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError("a share from 0 to 1")
    return value


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError("a number above 0")
    return value


def _system(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 254:
        raise argparse.ArgumentTypeError("a system id from 1 to 254")
    return value


def parse_listen(text: str) -> tuple[str, str, int]:
    """`udp:HOST:PORT` or `tcp:HOST:PORT` as its parts. Raises UsageError."""
    transport, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    if transport not in ("udp", "tcp") or not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"cannot listen on '{text}'; write udp:HOST:PORT or tcp:HOST:PORT (port 0: any free one)"
        )
    return transport, host, int(port)


class MavlinkSim:
    """A copter or rover on a desk (see `lfield.driver.sims.Sim`)."""

    name = "mavlink"
    help = "A MAVLink copter or rover that answers like ArduPilot."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """What it models can be set; the speeds are those of the autopilot's parameters."""
        parser.add_argument("--listen", default="udp:127.0.0.1:14550", metavar="udp|tcp:HOST:PORT")
        parser.add_argument("--kind", choices=("copter", "rover"), default="copter")
        parser.add_argument("--system", type=_system, default=1, metavar="N", help="MAVLink system id")
        parser.add_argument("--cruise", type=_positive, metavar="M/S", help="speed over ground (5)")
        parser.add_argument("--climb", type=_positive, metavar="M/S", help="speed upwards (2.5)")
        parser.add_argument("--descend", type=_positive, metavar="M/S", help="speed downwards (1.5)")
        parser.add_argument("--land", type=_positive, metavar="M/S", help="speed below 10 m when landing (1)")
        parser.add_argument("--acceleration", type=_positive, metavar="M/S2", help="both ways (2.5)")
        parser.add_argument("--battery", type=_share, default=1.0, metavar="0..1", help="charge at start")
        parser.add_argument("--capacity", type=_positive, metavar="MAH", help="of the battery (3300)")
        parser.add_argument(
            "--param", action="append", default=[], metavar="NAME=VALUE", help="any parameter"
        )
        parser.add_argument("--refuse-arming", default="", metavar="REASON", help="fault: never arms")
        parser.add_argument("--loss", type=_share, default=0.0, metavar="0..1", help="fault: packets lost")
        parser.add_argument("--silent-after", type=_positive, metavar="S", help="fault: mute from then on")
        parser.add_argument(
            "--until-stdin-closes", action="store_true", help="end with the one who started it"
        )

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The fake of the device of a bus."""
        options = devices[0].options
        kind, system = str(options.get("kind", "copter")), str(options.get("system", 1))
        return ["--listen", "udp:127.0.0.1:0", "--kind", kind, "--system", system]

    def run(self, args: argparse.Namespace) -> int:
        """Serve until told to end; 0."""
        transport, host, port = parse_listen(args.listen)
        try:
            from lfield_sim.autopilot import KINDS, Autopilot
            from lfield_sim.mavlink.protocol import Faults, MavlinkFake
            from lfield_sim.mavlink.server import serve
        except ImportError:
            raise PluginError("the fake 'mavlink' needs pymavlink: pip install 'lfield[mavlink]'") from None
        autopilot = Autopilot(KINDS[args.kind], charge=args.battery, refuse_arming=args.refuse_arming)
        autopilot.parameters.update(_parameters(args, autopilot.parameters))
        autopilot.apply_parameters()
        faults = Faults(loss=args.loss, silent_after=args.silent_after or float("inf"))
        fake = MavlinkFake(autopilot, system=args.system, faults=faults)
        words = f"{args.kind} system {args.system}"
        return asyncio.run(
            serve(fake, transport, host, port, words, until_stdin_closes=args.until_stdin_closes)
        )


def _parameters(args: argparse.Namespace, known: Mapping[str, float]) -> dict[str, float]:
    """The parameters that a command line sets. Raises UsageError."""
    given = {
        "WPNAV_SPEED": args.cruise,
        "WPNAV_SPEED_UP": args.climb,
        "WPNAV_SPEED_DN": args.descend,
        "LAND_SPEED": args.land,
        "WPNAV_ACCEL": args.acceleration,
    }
    parameters = {name: 100.0 * value for name, value in given.items() if value is not None}
    if args.capacity is not None:
        parameters.update({"BATT_CAPACITY": args.capacity, "BATT_LOW_MAH": 0.2 * args.capacity})
    for text in args.param:
        name, _, value = text.partition("=")
        if name not in known:
            raise UsageError(f"there is no parameter '{name}'; known: {', '.join(sorted(known))}")
        try:
            parameters[name] = float(value)
        except ValueError:
            raise UsageError(f"--param {text}: write NAME=NUMBER") from None
    return parameters


SIM = MavlinkSim()
