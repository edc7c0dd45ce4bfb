"""The Dynamixel fake for the command line: `lfield sim dynamixel`."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from lfield.driver.binding import DeviceBinding
from lfield.errors import UsageError
from lfield_sim.dynamixel.chain import Chain
from lfield_sim.dynamixel.faults import FAULTS
from lfield_sim.dynamixel.model import BAUDS, model_named
from lfield_sim.dynamixel.server import Server
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.faults import Faults, add_fault_option
from lfield_sim.serving import serve_until_told

#: What a binding that names no model gets.
DEFAULT_MODEL = "XM430-W350"
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
        parser.add_argument("--protocol", choices=("1.0", "2.0"), default="2.0", help="of the servos (2.0)")
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
        for device in sorted(devices, key=lambda device: "ids" not in device.options):
            model = str(device.options.get("model") or DEFAULT_MODEL)
            group = device.options.get("ids")
            if isinstance(group, list):
                servos.update({int(id): (model, f"{device.name}.{id}") for id in group})
            else:
                servos[int(str(device.options.get("id", 1)))] = (model, device.name)
        options = ["--baud", str(FAST_BAUD)]
        for id, (model, name) in sorted(servos.items()):
            options += ["--servo", f"{id}:{model}:{name}"]
        return options

    def run(self, args: argparse.Namespace) -> int:
        """Serve until told to end; 0. Raises UsageError."""
        servos, names = _servos(args)
        faults = Faults(FAULTS, names)
        chain = Chain(servos, faults, seed=args.seed)
        with contextlib.ExitStack() as stack:
            folder = args.listen or stack.enter_context(
                tempfile.TemporaryDirectory(prefix="lfield-dynamixel-")
            )
            path = Path(folder).absolute() if args.listen else Path(folder) / "ttyDXL"
            asyncio.run(_serve(chain, path, args, names))
        return 0


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
    servo = Servo(model_named(model), time.monotonic())
    protocol = servo.model.items["protocol_type"]
    wanted = 1 if args.protocol == "1.0" else 2
    if not protocol.low <= wanted <= protocol.high:
        raise UsageError(f"a {servo.model.name} does not speak protocol {args.protocol}")
    if not 0 <= args.return_delay <= 508:
        raise UsageError(f"--return-delay {args.return_delay}: write microseconds from 0 to 508")
    if BAUDS.index(args.baud) > servo.model.items["baud_rate"].high:
        raise UsageError(f"a {servo.model.name} is not as fast as {args.baud} baud")
    settings = {
        "id": number,
        "baud_rate": BAUDS.index(args.baud),
        "return_delay_time": args.return_delay // 2,
        "protocol_type": wanted,
    }
    for name, value in settings.items():
        servo.table.put(name, value)
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
