"""`lfield stop`: stops the mission on all robots in order; with --discard its coordinators end too."""

from __future__ import annotations

import argparse
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
    """0 when all hosts have stopped; 3 when vehicles of one may not be at rest.

    1 when one refuses, 69 when one was not reached.
    """
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
        troubles = [host for host, result in stopped.items() if result.trouble]
        checked = {host: result.checked for host, result in stopped.items() if result.checked}
        if args.discard and not failed and not troubles:
            # Only when every host has stopped: a coordinator on another one could continue. And this order
            # says that the vehicles of a host that was killed meanwhile have been checked.
            order = MissionCommand("stop", discards=True)
            stopped, failed = split_answers(desk.command(hosts, order, CommandResult, STOP_TIMEOUT))
            troubles = [host for host, result in stopped.items() if result.trouble]
    if args.json:
        data = _as_data(stopped, checked)
        print(json.dumps({**data, **{host: error.as_data() for host, error in failed.items()}}))
    else:
        _show(stopped, checked)
        kept = "nothing was discarded"
        report_unreached(failed, ", not stopped" + (f", {kept}" if args.discard else ""))
        if troubles and args.discard:
            print(f"{kept}: repeat it when the vehicles have been checked", file=sys.stderr)
    return exit_status.UNSAFE if troubles else failure_status(failed)


def _as_data(stopped: Mapping[str, CommandResult], checked: Mapping[str, str]) -> dict[str, object]:
    return {
        host: {
            "phase": result.run.phase,
            "discarded": list(result.discarded),
            "trouble": result.trouble,
            "checked": checked.get(host, ""),
        }
        for host, result in stopped.items()
    }


def _show(stopped: Mapping[str, CommandResult], checked: Mapping[str, str]) -> None:
    for host, result in stopped.items():
        gone = f"; discarded: {listed(result.discarded)}" if result.discarded else ""
        print(escape_line(f"{host}: {result.run.phase}{gone}"))
        if why := checked.get(host):
            print(escape_line(f"{host}: its host had ended before ({why}); its vehicles count as checked"))
        if result.trouble:
            print(escape_line(f"{host}: {result.trouble}"), file=sys.stderr)
