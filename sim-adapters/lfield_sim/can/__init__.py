"""The CAN fake for the command line: `lfield sim can`. See sim-adapters/README.md."""

from __future__ import annotations

import argparse
import asyncio
import os
import selectors
from collections.abc import Sequence

from lfield.driver.binding import DeviceBinding
from lfield.errors import UsageError
from lfield.text.number_arguments import whole_between
from lfield_sim.faults import Faults, add_fault_option
from lfield_sim.state_log import StateLog, add_log_option

#: The endpoint kind of a pty (PATH is a link to it); the other kind is `socketcand:HOST:PORT`.
_PTY = "slcan-pty"


def parse_listen(text: str) -> tuple[str, str, int]:
    """Splits `socketcand:HOST:PORT` or `slcan-pty[:PATH]` into kind, host or path, and port. Raises
    UsageError.
    """
    kind, _, rest = text.partition(":")
    if kind == _PTY:
        return _PTY, os.path.abspath(rest) if rest else "", 0
    host, _, port = rest.rpartition(":")
    if kind != "socketcand" or not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"cannot listen on '{text}'; write socketcand:HOST:PORT (port 0: any free one) or {_PTY}[:PATH]"
        )
    return kind, host, int(port)


class CanSim:
    """A simulated CAN bus with drives (see `lfield.driver.sims.Sim`)."""

    name = "can"
    help = "A CAN bus with CiA 402 drives, ODrive axes, DroneCAN nodes and devices by DBC file."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds endpoints, devices and faults."""
        parser.add_argument(
            "--listen",
            action="append",
            metavar="socketcand:HOST:PORT|slcan-pty[:PATH]",
            help="endpoint of the bus (repeatable; default: socketcand:127.0.0.1:0)",
        )
        parser.add_argument(
            "--device",
            action="append",
            default=[],
            metavar="KIND:NODE|FILE[:NAME][,KEY=VALUE]",
            help="device, for example cia402:5, odrive:3, dronecan:42 or dbc:FILE (repeatable)",
        )
        parser.add_argument(
            "--bitrate",
            type=whole_between(10_000, 1_000_000, "bits per second"),
            default=1_000_000,
            metavar="BIT/S",
            help="bit rate of the bus (default: 1000000)",
        )
        add_log_option(parser)
        add_fault_option(parser)
        parser.add_argument(
            "--until-stdin-closes", action="store_true", help="exit when standard input closes"
        )

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """A bus with the devices of these bindings behind socketcand; two bindings of one node share a
        device.
        """
        from lfield_sim.can.device_specs import merged, parse, spec_of

        specs: dict[str, str] = {}
        for binding in devices:
            text = spec_of(binding)
            id = parse(text).id
            specs[id] = merged(specs[id], text) if id in specs else text
        options = [argument for text in specs.values() for argument in ("--device", text)]
        return ["--listen", "socketcand:127.0.0.1:0", *options]

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped; returns 0."""
        # epoll rounds a wait up to a millisecond, which is eight frames; select does not.
        select = asyncio.SelectorEventLoop(selectors.SelectSelector())
        with asyncio.Runner(loop_factory=lambda: select) as runner:
            runner.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """As `run`, on the running loop."""
        from lfield_sim.can.can_bus import FAULTS
        from lfield_sim.can.can_server import serve
        from lfield_sim.can.device_specs import build, parse

        endpoints = [parse_listen(text) for text in args.listen or ["socketcand:127.0.0.1:0"]]
        specs = [parse(text) for text in args.device]
        names = {spec.id: spec.name for spec in specs}
        faults = Faults(FAULTS, names)
        try:
            faults.apply(args.fault)
        except ValueError as error:
            raise UsageError(f"--fault: {error}") from None
        devices = build(specs, faults)
        await serve(
            endpoints,
            devices,
            faults,
            StateLog(args.log, {device.id: device.facts for device in devices}),
            bitrate=args.bitrate,
            names=names,
            summary=" ".join(f"{spec.kind}:{spec.id}" for spec in specs),
            until_stdin_closes=args.until_stdin_closes,
        )


SIM = CanSim()
