"""`lfield estop`: every device of a running mission into its safe state, and who did not confirm."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from lfield.cli.mission_argument import add_mission, running_team

if TYPE_CHECKING:
    from lfield.errors import LfieldError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_mission(parser)
    parser.add_argument("--reason", metavar="TEXT", default="", help="a sentence for the logs of the hosts")
    parser.add_argument(
        "--lift", action="store_true", help="the emergency is over: programs may release their devices again"
    )
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="where a host is reached"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every device of every host has confirmed, 69 when one did not or a host was not reached."""
    from lfield.net.tcp import TcpTransport
    from lfield.operator.ask import ask_all
    from lfield.wire.messages import EmergencyStop, clip

    reason = clip(f"the emergency stop was pressed{': ' if args.reason else ''}{args.reason}")
    transport = TcpTransport(1 << 20, connect_timeout=2.0)
    answers = asyncio.run(ask_all(transport, running_team(args).reached, EmergencyStop(reason, args.lift)))
    return _tell(answers, "may be released" if args.lift else "safe")


def _tell(answers: Mapping[str, dict[str, Any] | LfieldError], word: str) -> int:
    """A line for each device and each host without an answer; what is wrong goes to stderr."""
    wrong = False
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            wrong = True
            print(f"{host}: NOT REACHED, its devices have not confirmed: {answer}", file=sys.stderr)
            continue
        if not answer:
            print(f"{host}: has no devices")
        for device, problem in answer.items():
            wrong = wrong or bool(problem)
            print(
                f"{host}: {device}: {f'NOT CONFIRMED: {problem}' if problem else word}",
                file=sys.stderr if problem else sys.stdout,
            )
    return 69 if wrong else 0
