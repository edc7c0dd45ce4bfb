"""`lfield status`: bundle, signer, version and mission of each robot, and its refusals and waits."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from lfield.cli.fleet.desk import (
    add_desk,
    failure_status,
    open_desk,
    report_unreached,
)
from lfield.client.service_desk import split_answers

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.wire.service_messages import ServiceStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("hosts", metavar="HOST", nargs="*", help="hosts (default: all of the inventory)")
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when all services answer; 1 when one refuses, 69 when one was not reached."""
    desk = open_desk(args)
    reached, failed = split_answers(desk.statuses(args.hosts or desk.hosts))
    if args.json:
        print(json.dumps({**_as_data(reached), **{host: error.as_data() for host, error in failed.items()}}))
    else:
        _show(reached)
        report_unreached(failed, "")
    return failure_status(failed)


def _as_data(statuses: Mapping[str, ServiceStatus]) -> dict[str, object]:
    from lfield.cli.fleet.status_view import status_data

    return {host: status_data(status) for host, status in statuses.items()}


def _show(statuses: Mapping[str, ServiceStatus]) -> None:
    from lfield.cli.fleet.status_view import status_lines, status_table
    from lfield.cli.views.trees import plain_console

    if not statuses:
        return
    console = plain_console()
    console.print(status_table(statuses))
    for line in status_lines(statuses):
        console.print(line)
