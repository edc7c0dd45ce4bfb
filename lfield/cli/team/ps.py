"""`lfield ps`: what runs where."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from lfield.errors import LfieldError

    Answers = dict[str, dict[str, Any] | LfieldError]

#: So many quantities of a device are shown, the first of its manifest; `--json` has all.
SHOWN = 8
#: A device that has not been heard for longer (seconds) is shown as silent: its telemetry is old.
SILENT = 3.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("--deploy", metavar="M.dL", type=Path, required=True, help="the deployment")
    parser.add_argument("--json", action="store_true", help="print what the hosts say as JSON")
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="where a host is reached"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every host answered, 69 when one or more did not."""
    from lfield.lang.deployment import read_deployment
    from lfield.mission.team import make_team, parse_maps
    from lfield.net.tcp import TcpTransport
    from lfield.operator import whereabouts
    from lfield.operator.ask import ask_all

    deployment = read_deployment(args.deploy, None)
    maps = whereabouts.find(bytes.fromhex(deployment.hash)) | parse_maps(args.map, deployment)
    team = make_team(deployment, maps)
    transport = TcpTransport(1 << 20, connect_timeout=2.0)
    answers = asyncio.run(ask_all(transport, dict(zip(team.hosts, team.addresses, strict=True))))
    if args.json:
        print(json.dumps({host: _plain(answer) for host, answer in answers.items()}, indent=2))
    else:
        _show(answers)
    return 69 if any(isinstance(answer, Exception) for answer in answers.values()) else 0


def _plain(answer: dict[str, Any] | LfieldError) -> dict[str, Any]:
    return {"error": str(answer)} if isinstance(answer, Exception) else answer


def _show(answers: Answers) -> None:
    from rich.console import Console

    Console().print(picture(answers))
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            print(f"{host}: {answer}", file=sys.stderr)


def picture(answers: Answers) -> Group:
    """The agents of all hosts with the coordinators that have ended or are in doubt, then the devices."""
    from rich.console import Group

    devices = _devices(answers)
    return Group(_agents(answers), "", devices) if devices.row_count else Group(_agents(answers))


def _devices(answers: Answers) -> Table:
    from rich.table import Table

    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "DEVICE", "STATE", "TELEMETRY"):
        shown.add_column(column)
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        for name, values in answer["devices"].items():
            state = _device_state(name, answer)
            words = [f"{quantity} {_value(value)}" for quantity, value in list(values.items())[:SHOWN]]
            words += [f"and {len(values) - SHOWN} more"] if len(values) > SHOWN else []
            shown.add_row(host, name, state, ", ".join(words))
    return shown


def _device_state(name: str, answer: dict[str, Any]) -> str:
    silence = answer["silences"].get(name, 0.0)
    if silence > SILENT:
        return f"silent {silence:.0f} s"
    return "safe" if name in answer["latched"] else "in use"


def _value(value: object) -> str:
    if isinstance(value, list):
        return f"({' '.join(_value(part) for part in value)})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _agents(answers: Answers) -> Table:
    from rich.table import Table

    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "AGENT", "TYPE", "STATE", "HOPS", "SERVED", "HEAP"):
        shown.add_column(column, justify="right" if column in ("HOPS", "SERVED", "HEAP") else "left")
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            shown.add_row(host, "-", "", "no answer", "", "", "")
            continue
        for agent in answer["agents"]:
            hops = str(agent["hops"]) if agent["kind"] == "coordinator" else ""
            served = str(agent["served"]) if agent["kind"] == "resource" else ""
            shown.add_row(
                host, agent["id"], agent["type"], agent["state"], hops, served, _size(agent["heap"])
            )
        for record in answer["coordinators"]:
            if record["state"] == "IN DOUBT" or (record["state"] == "EXITED" and record["where"] == host):
                state = f"{record['outcome'] or 'in doubt'}: {record['detail']}".splitlines()[0].rstrip(": ")
                shown.add_row(host, record["id"], "", state, str(record["hops"]), "", "")
    return shown


def _size(count: int) -> str:
    return f"{count} B" if count < 1024 else f"{count / 1024:.1f} KiB"
