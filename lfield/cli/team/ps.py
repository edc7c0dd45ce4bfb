"""`lfield ps`: what runs where."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from typing import TYPE_CHECKING, Any

from lfield.cli.mission_argument import add_mission, running_team

if TYPE_CHECKING:
    from lfield.cli.views.picture import Answers
    from lfield.errors import LfieldError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_mission(parser)
    parser.add_argument("--json", action="store_true", help="print what the hosts say as JSON")
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="where a host is reached"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every host answered, 69 when one or more did not."""
    from lfield.net.tcp import TcpTransport
    from lfield.operator.ask import ask_all

    transport = TcpTransport(1 << 20, connect_timeout=2.0)
    answers = asyncio.run(ask_all(transport, running_team(args).reached))
    if args.json:
        print(json.dumps({host: _plain(answer) for host, answer in answers.items()}, indent=2))
    else:
        _show(answers)
    return 69 if any(isinstance(answer, Exception) for answer in answers.values()) else 0


def _plain(answer: dict[str, Any] | LfieldError) -> dict[str, Any]:
    return {"error": str(answer)} if isinstance(answer, Exception) else answer


def _show(answers: Answers) -> None:
    from rich.console import Console

    from lfield.cli.views.picture import picture

    Console().print(picture(answers))
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            print(f"{host}: {answer}", file=sys.stderr)
