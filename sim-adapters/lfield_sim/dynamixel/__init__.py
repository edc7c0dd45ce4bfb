"""The Dynamixel fake for the command line: `lfield sim dynamixel`."""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from lfield.driver.binding import DeviceBinding
from lfield.errors import UsageError
from lfield_sim.dynamixel.ax import make_servo
from lfield_sim.dynamixel.chain import FAULTS, Chain
from lfield_sim.dynamixel.model import BAUDS, model_named
from lfield_sim.dynamixel.server import Server
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.faults import Faults, add_fault_option
from lfield_sim.serving import serve_until_told

#: What a binding that names no model gets.
DEFAULT_MODEL, DEFAULT_MODEL_1 = "XM430-W350", "AX-12A"
#: The speed of a bus that `lfield up --sim` starts.
FAST_BAUD = 1_000_000


class DynamixelSim:
    """A chain of servos on a desk (see `lfield.driver.sims.Sim`)."""

    name = "dynamixel"
    help = "Dynamixel servos on a serial port (a pseudo-terminal)."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """The servos, their port and its speed."""
        parser.add_argument(
            "--servo",
            action="append",
            default=[],
            metavar="ID:MODEL[:NAME]",
            help="one servo; as often as wanted",
        )
        parser.add_argument(
            "--listen", default="", metavar="PATH", help="of the port (in a new temporary folder)"
        )
        parser.add_argument("--baud", type=int, choices=BAUDS, default=57_600, help="of the servos (57600)")
        parser.add_argument(
            "--protocol", choices=("1.0", "2.0"), default="2.0", help="where a model has both (2.0)"
        )
        parser.add_argument(
            "--return-delay",
            type=int,
            default=500,
            metavar="US",
            help="before they answer, in microseconds (500)",
        )
        parser.add_argument("--seed", type=int, default=1, metavar="N", help="of random faults (1)")
        parser.add_argument(
            "--until-stdin-closes", action="store_true", help="end with the one who started it"
        )
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The servos of all bindings of a bus; those of a group are named GROUP.ID."""
        servos: dict[int, tuple[str, str]] = {}
        # Groups first: a servo that is bound by itself too goes by that name.
        for device in sorted(devices, key=lambda device: "ids" not in device.options):
            group = device.options.get("ids")
            if isinstance(group, list):
                servos.update({int(id): (_model(device), f"{device.name}.{id}") for id in group})
            else:
                servos[int(str(device.options.get("id", 1)))] = (_model(device), device.name)
        options = ["--baud", str(FAST_BAUD)]
        for id, (model, name) in sorted(servos.items()):
            options += ["--servo", f"{id}:{model}:{name}"]
        old = all(device.options.get("protocol") == 1 and device.options.get("model") for device in devices)
        return [*options, "--protocol", "1.0"] if old else options

    def run(self, args: argparse.Namespace) -> int:
        """Serve until told to end; 0. Raises UsageError."""
        servos, names = _servos(args)
        faults = Faults(FAULTS, names)
        chain = Chain(servos, faults, seed=args.seed)
        with tempfile.TemporaryDirectory(prefix="lfield-dynamixel-") as folder:
            path = Path(args.listen or f"{folder}/ttyDXL").absolute()
            asyncio.run(_serve(chain, path, args, names))
        return 0


def _model(device: DeviceBinding) -> str:
    """The model of a binding, or one that speaks its protocol."""
    default = DEFAULT_MODEL_1 if device.options.get("protocol") == 1 else DEFAULT_MODEL
    return str(device.options.get("model") or default)


def _servos(args: argparse.Namespace) -> tuple[list[Servo], Mapping[str, str]]:
    """The servos of a command line, and their names by id. Raises UsageError."""
    servos, names = [], {}
    for text in args.servo or [f"1:{DEFAULT_MODEL}"]:
        number, _, rest = text.partition(":")
        model, _, name = rest.partition(":")
        if not number.isdecimal() or not 0 <= int(number) <= 252:
            raise UsageError(f"--servo {text}: write ID:MODEL[:NAME], with an id from 0 to 252")
        if str(int(number)) in names:
            raise UsageError(f"--servo {text}: there is a servo {int(number)} already")
        names[str(int(number))] = name
        servos.append(_servo(int(number), model or DEFAULT_MODEL, args))
    return servos, names


def _servo(number: int, model: str, args: argparse.Namespace) -> Servo:
    servo = make_servo(model_named(model), time.monotonic())
    protocol = 1 if args.protocol == "1.0" else servo.model.protocol
    servo.start_with(number, args.baud, protocol, args.return_delay * 1e-6)
    return servo


async def _serve(chain: Chain, path: Path, args: argparse.Namespace, names: Mapping[str, str]) -> None:
    server = Server(chain, path)
    server.plug()
    moving = asyncio.get_running_loop().create_task(server.run())
    try:
        try:
            chain.faults.apply(args.fault)
        except ValueError as error:
            raise UsageError(f"--fault: {error}") from None
        await serve_until_told(
            "dynamixel",
            f"serial:{path}:{args.baud}",
            ", ".join(f"{servo.id} {servo.model.name}" for servo in chain.servos),
            chain.faults,
            devices=names,
            until_stdin_closes=args.until_stdin_closes,
        )
    finally:
        moving.cancel()
        server.unplug()


SIM = DynamixelSim()
