"""`lfield stop`: stops the mission on all robots in order; with --discard its coordinators end too."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from lfield.cli.fleet.desk import (
    add_desk,
    add_without,
    explained_interrupt,
    failure_status,
    open_desk,
    report_unreached,
    split_answers,
)
from lfield.errors import UsageError
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.wire.service_messages import CommandResult

#: Seconds for a host to end: its devices come to rest first, a vehicle in the air lands.
STOP_TIMEOUT = 300.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_without(parser, "do not stop this host")
    parser.add_argument(
        "--discard",
        action="store_true",
        help="also end the coordinators that have not ended; without it 'lfield start' continues them",
    )
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """0 when all hosts have stopped; 1 when one refuses, 69 when one was not reached."""
    from lfield.wire.service_messages import CommandResult, MissionCommand

    desk = open_desk(args)
    desk.addresses(args.without)
    hosts = [host for host in desk.hosts if host not in args.without]
    if not hosts:
        raise UsageError("no host is left: --without names all of them")
    with explained_interrupt("hosts that have received the order stop; vehicles land first"):
        stopped, failed = split_answers(
            desk.command(hosts, MissionCommand("stop"), CommandResult, STOP_TIMEOUT)
        )
        if args.discard and not failed:
            # Only when every host has stopped: a coordinator on another one could continue.
            order = MissionCommand("stop", discards=True)
            stopped, failed = split_answers(desk.command(hosts, order, CommandResult, STOP_TIMEOUT))
    if args.json:
        print(json.dumps({**_as_data(stopped), **{host: error.as_data() for host, error in failed.items()}}))
    else:
        _show(stopped)
        report_unreached(failed, ", not stopped" + (", nothing was discarded" if args.discard else ""))
    return failure_status(failed)


def _as_data(stopped: Mapping[str, CommandResult]) -> dict[str, object]:
    return {
        host: {"phase": result.run.phase, "discarded": list(result.discarded), "trouble": result.trouble}
        for host, result in stopped.items()
    }


def _show(stopped: Mapping[str, CommandResult]) -> None:
    for host, result in stopped.items():
        gone = f"; discarded: {listed(result.discarded)}" if result.discarded else ""
        print(escape_line(f"{host}: {result.run.phase}{gone}"))
