"""The Dynamixel fake for the command line: `lfield sim dynamixel`. The servos are imported when it runs."""

from __future__ import annotations

import argparse
import asyncio
import tempfile
from collections.abc import Sequence

from lfield.driver.binding import DeviceBinding
from lfield.text.number_arguments import whole_between
from lfield_sim.faults import add_fault_option
from lfield_sim.state_log import add_log_option

#: Default models.
DEFAULT_MODEL = "XM430-W350"
#: Default models of the protocols that the default above does not have.
DEFAULT_MODELS = {0: "STS3215", 1: "AX-12A"}
#: The baud rate of a bus under `lfield up --sim`.
FAST_BAUD = 1_000_000


class DynamixelSim:
    """A simulated chain of servos (see `lfield.driver.sims.Sim`)."""

    name = "dynamixel"
    help = "Dynamixel and Feetech servos on a serial port (a pseudo-terminal)."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the servos, their port and its speed."""
        from lfield_sim.dynamixel.servo_model import BAUDS, STS_BAUDS

        bauds = sorted({*BAUDS, *STS_BAUDS})
        parser.add_argument(
            "--servo",
            action="append",
            default=[],
            metavar="ID:MODEL[:NAME]",
            help="servo on the bus (repeatable)",
        )
        parser.add_argument(
            "--listen",
            default="",
            metavar="PATH",
            help="path of the port (default: in a temporary directory)",
        )
        parser.add_argument(
            "--baud",
            type=whole_between(bauds[0], bauds[-1], "bauds"),
            choices=bauds,
            default=57_600,
            help="baud rate (default: 57600)",
        )
        parser.add_argument(
            "--protocol",
            choices=("1.0", "2.0"),
            default="2.0",
            help="protocol version of models that support both (default: 2.0)",
        )
        parser.add_argument(
            "--return-delay",
            type=whole_between(0, 1000, "microseconds"),
            default=500,
            metavar="US",
            help="return delay in microseconds (default: 500)",
        )
        parser.add_argument(
            "--seed",
            type=whole_between(0, 1 << 32),
            default=1,
            metavar="N",
            help="seed of random faults (default: 1)",
        )
        parser.add_argument(
            "--calibration",
            action="append",
            default=[],
            metavar="FILE",
            help="calibration file of LeRobot that the servos were set to (repeatable)",
        )
        parser.add_argument("--echo", action="store_true", help="the adapter echoes every transmitted byte")
        parser.add_argument(
            "--until-stdin-closes", action="store_true", help="exit when standard input closes"
        )
        add_log_option(parser)
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The servos of all bindings of a bus; those of a group are named GROUP.ID."""
        servos: dict[int, tuple[str, str]] = {}
        # Groups first: a servo with its own binding uses that name.
        for device in sorted(devices, key=lambda device: "ids" not in device.options):
            group = device.options.get("ids")
            if isinstance(group, list):
                servos.update({int(id): (_model(device), f"{device.name}.{id}") for id in group})
            else:
                servos[int(str(device.options.get("id", 1)))] = (_model(device), device.name)
        options = ["--baud", str(FAST_BAUD)]
        for id, (model, name) in sorted(servos.items()):
            options += ["--servo", f"{id}:{model}:{name}"]
        for path in sorted({str(d.options["calibration"]) for d in devices if d.options.get("calibration")}):
            options += ["--calibration", path]
        old = all(device.options.get("protocol") == 1 and device.options.get("model") for device in devices)
        return [*options, "--protocol", "1.0"] if old else options

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped; returns 0. Raises UsageError."""
        with tempfile.TemporaryDirectory(prefix="lfield-dynamixel-") as folder:
            args.listen = args.listen or f"{folder}/ttyDXL"
            asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """As `run`, on the running loop, at `args.listen`."""
        from lfield_sim.dynamixel.chain_setup import serve

        await serve(args, DEFAULT_MODEL)


def _model(device: DeviceBinding) -> str:
    """The model of a binding, or the default of its protocol."""
    protocol = device.options.get("protocol", 2)
    default = next((model for number, model in DEFAULT_MODELS.items() if number == protocol), DEFAULT_MODEL)
    return str(device.options.get("model") or default)


SIM = DynamixelSim()
