"""`lfield start` for robots with services: starts the mission's host on each of them."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import explained_interrupt, failure_status, open_desk, report_unreached
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.client.mission_start import StartResult


def start_on_robots(args: argparse.Namespace) -> int | None:
    """Start the mission whose bundle is active on the robots of the inventory; None without an inventory.

    Returns 0 when it runs on all hosts of its deployment; 1 when a host refuses or ends, or no coordinator
    runs; 69 when one was not reached: then no host was started, unless the missing one is left out.
    """
    from lfield.inventory.location import find_inventory

    if find_inventory(args.inventory, os.environ) is None:
        return None
    from lfield.cli.fleet.status_view import differing_versions
    from lfield.client import mission_start

    desk = open_desk(args)
    plan = asyncio.run(mission_start.plan_start(desk, args.without))
    if isinstance(plan, mission_start.StartResult):
        return _report(args, plan)
    with explained_interrupt("hosts that have received the order start"):
        if versions := differing_versions(plan.before):
            print(versions, file=sys.stderr)
        return _report(args, asyncio.run(mission_start.start_mission(desk, plan)))


def _report(args: argparse.Namespace, start: StartResult) -> int:
    """Print the result; returns the exit status."""
    report_unreached(start.unreached, start.consequence)
    if args.json:
        print(json.dumps(start.as_data()))
    else:
        for agent in start.continues:
            print(escape_line(f"{agent} continues: it has not ended ('lfield stop --discard' would end it)"))
        for host, reason in start.waits.items():
            print(escape_line(f"{host}: {reason}"), file=sys.stderr)
        print(escape_line(start.text), file=sys.stdout if start.is_started else sys.stderr)
    if start.errors:
        return failure_status(start.errors)
    return exit_status.DONE if start.is_started else exit_status.FAILED
