"""The MAVLink fake for the command line: `lfield sim mavlink`. pymavlink is imported when it runs."""

from __future__ import annotations

import argparse
import asyncio
import secrets
from collections.abc import Sequence

from lfield.driver.binding import DeviceBinding
from lfield.driver.frame import Placement
from lfield.errors import PluginError, UsageError
from lfield.text.number_arguments import real_above_0, real_between
from lfield_sim.faults import add_fault_option
from lfield_sim.mavlink.options import (
    APART,
    BOARD_BITS,
    FLAVOURS,
    KINDS,
    SPEEDS,
    Stand,
    VehicleOption,
    board,
    fitted,
    origin,
    parse_listen,
    settings,
    speeds,
    stand,
    system,
    vehicle,
    vehicles,
)
from lfield_sim.mavlink.setup_parameters import STATES, setup_parameters, station
from lfield_sim.state_log import add_log_option

#: A speed, an acceleration, a charge.
_POSITIVE = real_above_0(1e6)


class MavlinkSim:
    """Simulated copters and rovers (see `lfield.driver.sims.Sim`)."""

    name = "mavlink"
    help = "MAVLink copters and rovers that answer like ArduPilot or PX4."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the options; speeds are those of the autopilot's parameters."""
        parser.add_argument(
            "--listen",
            default="udp:127.0.0.1:14550",
            metavar="udp|tcp:HOST:PORT|pty",
            help="endpoint (default: %(default)s)",
        )
        parser.add_argument(
            "--kind", choices=KINDS, default="copter", help="kind of vehicle (default: %(default)s)"
        )
        parser.add_argument(
            "--flavour", choices=FLAVOURS, default="ardupilot", help="autopilot (default: %(default)s)"
        )
        parser.add_argument(
            "--system", type=system, default=1, metavar="N", help="MAVLink system id (default: 1)"
        )
        parser.add_argument(
            "--vehicle", type=vehicle, action="append", metavar="SYSTEM[:KIND[:FLAVOUR[:NAME]]]",
            help="vehicle on the link, instead of --kind, --flavour and --system (repeatable)",
        )  # fmt: skip
        for option, unit, meaning in SPEEDS:
            parser.add_argument(option, type=_POSITIVE, metavar=unit, help=meaning)
        parser.add_argument(
            "--battery",
            type=real_between(0.0, 1.0),
            default=1.0,
            metavar="0..1",
            help="initial battery charge",
        )
        parser.add_argument(
            "--capacity", type=_POSITIVE, metavar="MAH", help="battery capacity (default: 3300)"
        )
        parser.add_argument(
            "--param",
            action="append",
            default=[],
            metavar="NAME[@SYSTEM]=VALUE",
            help="parameter of the autopilot at power-on (repeatable)",
        )
        parser.add_argument(
            "--set-up", nargs="?", const=STATES[0], default="", choices=STATES,
            help="start with the parameters for this safe state, not with factory parameters "
            "(without a value: land)",
        )  # fmt: skip
        parser.add_argument(
            "--fitted", type=fitted, default="all", metavar="all|none|HARDWARE,...",
            help="attached hardware: camera, gimbal, gripper, winch (all), mavlink_camera, mavlink_gimbal",
        )  # fmt: skip
        parser.add_argument(
            "--board", type=board, metavar="HEX",
            help="unique id of the first autopilot board; each further board has the next id; 0: none "
            "(default: random)",
        )  # fmt: skip
        _add_places(parser)
        add_log_option(parser)
        add_fault_option(parser)
        parser.add_argument(
            "--until-stdin-closes", action="store_true", help="exit when standard input closes"
        )

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """One fake with the vehicles of all devices of a bus, configured as their bindings require.

        Devices of one vehicle share it.
        """
        options_by_system: dict[int, VehicleOption] = {}
        parameters: list[str] = []
        stands: dict[int, Stand] = {}
        for device in devices:
            options = device.options
            number = int(str(options.get("system", 1)))
            kind, stack = str(options.get("kind", "copter")), str(options.get("autopilot", "any"))
            flavour = stack if stack in FLAVOURS else FLAVOURS[0]
            options_by_system.setdefault(number, VehicleOption(number, kind, flavour, device.name))
            if device.frame is not None:
                stands.setdefault(number, _stand(device.frame, device.sim))
            for name, value in _set_up(device, options_by_system[number]).items():
                parameters.append(f"--param={name}@{number}={value:.9g}")
        vehicle_options = [
            argument for each in options_by_system.values() for argument in ("--vehicle", str(each))
        ]
        vehicle_options += [f"--stand={number}:{each}" for number, each in stands.items()]
        origins = [d.frame.origin for d in devices if d.frame is not None and d.frame.origin]
        vehicle_options += [f"--origin={o.latitude!r},{o.longitude!r},{o.altitude!r}" for o in origins[:1]]
        return ["--listen", "udp:127.0.0.1:0", *vehicle_options, *parameters]

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped; returns 0."""
        asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """As `run`, on the running loop."""
        address, vehicle_options = parse_listen(args.listen), vehicles(args)
        parameters, limits = settings(args), speeds(args)
        try:
            from lfield_sim.mavlink.geo import GeoOrigin
            from lfield_sim.mavlink.link_setup import LinkSetup, serve
        except ImportError:
            raise PluginError(
                "a simulated autopilot needs pymavlink: pip install 'lfield[mavlink]'"
            ) from None
        number = secrets.randbits(BOARD_BITS) if args.board is None else args.board
        field = GeoOrigin(*args.origin).on_ellipsoid if args.origin else None
        setup = LinkSetup(
            vehicle_options,
            args.battery,
            args.capacity,
            limits,
            parameters,
            args.fitted,
            args.set_up,
            number,
            field,
            dict(args.stand),
        )
        try:
            faults = setup.faults(args.fault)
        except ValueError as error:
            raise UsageError(f"--fault: {error}") from None
        link = setup.link(faults)
        log = setup.log(args.log, link)
        await serve(link, address, setup, faults, log, until_stdin_closes=args.until_stdin_closes)


def _stand(placement: Placement, conditions: Sequence[str]) -> Stand:
    """The place of power-on of a vehicle in a team with a frame: its pose, else a free position.

    Positions of the simulated device in the binding are relative to that place, and to the origin if it is
    given.
    """
    if placement.pose is not None:
        pose = placement.pose
        return Stand(pose.north, pose.east, pose.down, pose.heading)
    has_position = any(each.startswith(("north", "east")) for each in conditions)
    return Stand() if has_position else Stand(east=placement.number * APART)


def _set_up(device: DeviceBinding, vehicle: VehicleOption) -> dict[str, float]:
    state = device.safe_state if device.safe_state in STATES else STATES[0]
    number = int(str(device.options.get("station", 0))) or station(vehicle.system)
    return setup_parameters(
        vehicle.flavour, vehicle.kind, state, device.ttl, device.limits.get("speed"), station=number
    )


def _add_places(parser: argparse.ArgumentParser) -> None:
    """Adds options for the positions of vehicles at power-on."""
    parser.add_argument(
        "--origin",
        type=origin,
        metavar="LATITUDE,LONGITUDE,ALTITUDE",
        help="position of all vehicles at power-on",
    )
    parser.add_argument(
        "--stand", type=stand, action="append", default=[], metavar="SYSTEM:NORTH,EAST,DOWN,HEADING",
        help="position of one vehicle at power-on, in m from --origin, and its heading in rad",
    )  # fmt: skip


SIM = MavlinkSim()
