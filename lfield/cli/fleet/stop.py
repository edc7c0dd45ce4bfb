"""`lfield stop`: stops the mission on all robots in order; with --discard its coordinators end too."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import (
    add_desk,
    add_without,
    explained_interrupt,
    failure_status,
    open_desk,
    report_unreached,
)
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.wire.service_messages import CommandResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_without(parser, "do not stop this host")
    parser.add_argument(
        "--discard",
        action="store_true",
        help="also end the coordinators that have not ended; without it 'lfield start' continues them",
    )
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when all hosts have stopped; 3 when vehicles of one may not be at rest.

    Returns 1 when one refuses, 69 when one was not reached.
    """
    from lfield.client import mission_stop

    desk = open_desk(args)
    hosts = mission_stop.hosts_to_stop(desk, args.without)
    with explained_interrupt("hosts that have received the order stop; vehicles land first"):
        found = asyncio.run(mission_stop.stop_mission(desk, hosts, discards=args.discard))
    if args.json:
        print(json.dumps(found.as_data()))
    else:
        _show(found.stopped, found.checked)
        notice = "nothing was discarded"
        report_unreached(found.errors, ", not stopped" + (f", {notice}" if args.discard else ""))
        if found.problems and args.discard:
            print(f"{notice}: repeat it when the vehicles have been checked", file=sys.stderr)
    return exit_status.UNSAFE if found.problems else failure_status(found.errors)


def _show(stopped: Mapping[str, CommandResult], checked: Mapping[str, str]) -> None:
    for host, result in stopped.items():
        discarded = f"; discarded: {listed(result.discarded)}" if result.discarded else ""
        print(escape_line(f"{host}: {result.run.phase}{discarded}"))
        if reason := checked.get(host):
            print(escape_line(f"{host}: its host had ended before ({reason}); its vehicles count as checked"))
        if result.trouble:
            print(escape_line(f"{host}: {result.trouble}"), file=sys.stderr)
