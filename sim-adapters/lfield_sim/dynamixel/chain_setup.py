"""Creates and serves the servos of a command line until it is stopped."""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Mapping
from pathlib import Path

from lfield.errors import UsageError
from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.chain_server import ChainServer
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.servo_chain import FAULTS, ServoChain
from lfield_sim.dynamixel.servo_model import model_named
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Faults
from lfield_sim.state_log import StateLog


def _servos(args: argparse.Namespace, default: str) -> tuple[list[Servo], Mapping[str, str]]:
    """The servos of a command line, and their names by id. Raises UsageError."""
    servos, names = [], {}
    for text in args.servo or [f"1:{default}"]:
        number, _, rest = text.partition(":")
        model, _, name = rest.partition(":")
        if not number.isdecimal() or not 0 <= int(number) <= 252:
            raise UsageError(f"--servo {text}: write ID:MODEL[:NAME], with an id from 0 to 252")
        if str(int(number)) in names:
            raise UsageError(f"--servo {text}: there is a servo {int(number)} already")
        names[str(int(number))] = name
        servos.append(_servo(int(number), model or default, args))
    return servos, names


def _servo(number: int, model: str, args: argparse.Namespace) -> Servo:
    servo = make_servo(model_named(model), asyncio.get_running_loop().time())
    protocol = 1 if args.protocol == "1.0" and servo.model.protocol == 2 else servo.model.protocol
    servo.start_with(number, args.baud, protocol, args.return_delay * 1e-6)
    return servo


def _calibrate(servos: list[Servo], path: str) -> None:
    """Sets the registers of servos as a calibration file of LeRobot says. Raises UsageError."""
    try:
        entries = json.loads(Path(path).read_text(encoding="utf-8")).values()
        registers = {
            entry["id"]: [
                int(entry[key]) for key in ("drive_mode", "homing_offset", "range_min", "range_max")
            ]
            for entry in entries
        }
    except (OSError, ValueError, AttributeError, KeyError, TypeError) as error:
        raise UsageError(f"--calibration {path}: it is not a calibration of LeRobot: {error!r}") from None
    for servo in servos:
        if servo.id in registers:
            servo.calibrate(*registers[servo.id])


async def serve(args: argparse.Namespace, default: str) -> None:
    """Serves until it is stopped; a servo without a model is a `default`. Raises UsageError and
    AddressError.
    """
    servos, names = _servos(args, default)
    for file in args.calibration:
        _calibrate(servos, file)
    chain = ServoChain(servos, Faults(FAULTS, names), seed=args.seed)
    path = Path(args.listen or f"/dev/{next(iter(names.values()), '') or 'ttyDXL'}").absolute()
    log = StateLog(args.log, {str(servo.id): servo.facts for servo in chain.servos})
    server = ChainServer(chain, path, log.write_changes)
    server.plug()
    server_task = asyncio.get_running_loop().create_task(server.run())
    try:
        try:
            chain.faults.apply([*(["echo=true"] if args.echo else []), *args.fault])
        except ValueError as error:
            raise UsageError(f"--fault: {error}") from None
        await serve_until_stopped(
            "dynamixel",
            f"serial:{path}:{args.baud}",
            ", ".join(f"{servo.id} {servo.model.name}" for servo in chain.servos),
            chain.faults,
            devices=names,
            until_stdin_closes=args.until_stdin_closes,
            facts={str(servo.id): servo.facts for servo in chain.servos},
        )
    finally:
        server_task.cancel()
        server.unplug()
        log.close()
