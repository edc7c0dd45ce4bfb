"""`lfield start` for robots with services: starts the mission's host on each of them."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import FleetDesk, failure_status, open_desk, report_unreached, split_answers
from lfield.errors import UsageError
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.wire.service_messages import ServiceStatus

#: Seconds in which the hosts should be up and their coordinators started, and between two queries.
SETTLE_TIMEOUT, POLL_INTERVAL = 20.0, 0.5
#: Phases in which a host runs, or will run by itself.
ACTIVE_PHASES = ("starting", "running", "waiting", "stopping")
#: Seconds for a host to be started; with --without its coordinators too.
START_TIMEOUT = 30.0


def start_on_robots(args: argparse.Namespace) -> int | None:
    """Start the mission on the robots of the inventory; None without an inventory.

    0 when it runs everywhere; 1 when a host refuses or ends; 69 when one was not reached: then nothing was
    started, unless it is left out.
    """
    from lfield.inventory.location import find_inventory

    if find_inventory(args.inventory, os.environ) is None:
        return None
    desk = open_desk(args)
    desk.addresses(args.without)
    statuses, failed = split_answers(desk.statuses([host for host in desk.hosts if host not in args.without]))
    if failed:
        report_unreached(failed, "")
        hint = "".join(f" --without {host}" for host in failed)
        return _report(args, {}, failed, f"nothing was started; to start without them:{hint}")
    if not statuses:
        raise UsageError("no host is left: --without names all of them")
    digests = {status.active for status in statuses.values()}
    if len(digests) > 1:
        each = [f"{host}: {short_digest(status.active) or 'none'}" for host, status in statuses.items()]
        return _report(args, {}, {}, f"nothing was started: the active bundles differ ({listed(each)})")
    digest = next(iter(digests))
    if others := _runs_of_other_bundles(desk, args.without, digest):
        text = f"nothing was started: {listed(others)}; stop it first, or push one bundle to all"
        return _report(args, {}, {}, text)
    return _start(desk, statuses, digest, args)


def _runs_of_other_bundles(desk: FleetDesk, hosts: list[str], digest: bytes) -> list[str]:
    """The hosts that are left out, answer, and run another bundle."""
    statuses, _ = split_answers(desk.statuses(hosts))
    return [
        f"{host} runs bundle {short_digest(status.run.bundle)}"
        for host, status in statuses.items()
        if status.run.phase in ACTIVE_PHASES and status.run.bundle != digest
    ]


def _start(
    desk: FleetDesk, before: Mapping[str, ServiceStatus], digest: bytes, args: argparse.Namespace
) -> int:
    """Start the hosts, whose states `before` are known, and wait until they are up; the exit status."""
    from lfield.wire.service_messages import CommandResult, MissionCommand

    hosts, continues = list(before), _suspended(before)
    order = MissionCommand("start", digest, without=args.without)
    results, failed = split_answers(desk.ask(hosts, order, CommandResult, START_TIMEOUT))
    report_unreached(failed, ", not started")
    refusals = {host: result.trouble for host, result in results.items() if result.trouble}
    if refusals or failed:
        return _report(args, refusals, failed, "the mission was not started on all hosts")
    if not args.json:
        for agent in continues:
            print(escape_line(f"{agent} continues: it has not ended ('lfield stop --discard' would end it)"))
    end = time.monotonic() + SETTLE_TIMEOUT
    while True:
        statuses, failed = split_answers(desk.statuses(hosts))
        waits = {host: _waiting(status) for host, status in statuses.items() if _waiting(status)}
        ended = [host for host, status in statuses.items() if status.run.phase not in ("running", "starting")]
        if not (waits or failed) or ended or time.monotonic() > end:
            break
        time.sleep(POLL_INTERVAL)
    if not waits and not failed:
        return _report(
            args, {}, {}, f"bundle {short_digest(digest)} runs on {listed(hosts)}", continues, done=True
        )
    text = "the mission does not run on all hosts yet: 'lfield status' shows it"
    return _report(args, waits, failed, text, continues)


def _suspended(statuses: Mapping[str, ServiceStatus]) -> list[str]:
    """The coordinators that have not ended on hosts that do not run: a start continues them."""
    found = [
        one.agent
        for status in statuses.values()
        if status.run.phase not in ACTIVE_PHASES
        for one in status.unfinished
    ]
    return list(dict.fromkeys(found))


def _waiting(status: ServiceStatus) -> str:
    """Why a host does not run the mission; '' if it does, or has ended in order."""
    run = status.run
    if run.phase == "ended" and run.status == exit_status.DONE:
        return ""
    return run.reason or ("" if run.phase == "running" else run.phase)


def _report(
    args: argparse.Namespace,
    waits: Mapping[str, str],
    failed: Mapping[str, LfieldError],
    text: str,
    continues: Sequence[str] = (),
    *,
    done: bool = False,
) -> int:
    """Print the result; returns the exit status."""
    if args.json:
        errors = {host: error.as_data() for host, error in failed.items()}
        data = {"started": done, "continues": list(continues), "waits": dict(waits), "errors": errors}
        print(json.dumps({**data, "text": text}))
    else:
        for host, reason in waits.items():
            print(escape_line(f"{host}: {reason}"), file=sys.stderr)
        print(escape_line(text), file=sys.stdout if done else sys.stderr)
    if failed:
        return failure_status(failed)
    return exit_status.DONE if done else exit_status.FAILED
