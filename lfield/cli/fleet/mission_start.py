"""`lfield start` for robots with services: starts the mission's host on each of them."""

from __future__ import annotations

import argparse
import json
import os
import secrets
import sys
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import (
    FleetDesk,
    explained_interrupt,
    failure_status,
    open_desk,
    report_unreached,
    split_answers,
)
from lfield.errors import UsageError
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.operator.fleet.active_missions import ActiveMission
    from lfield.wire.service_messages import ServiceStatus

#: Seconds in which the hosts should be up and their coordinators started, and between two queries.
SETTLE_TIMEOUT, POLL_INTERVAL = 20.0, 0.5
#: Seconds for which all hosts must be up, and failures of a host after which it is not waited for.
STEADY, MAX_FAILURES = 2.0, 2
#: Phases in which a host runs, or will run by itself.
ACTIVE_PHASES = ("starting", "running", "waiting", "stopping")
#: Seconds for a host to be started; with --without its coordinators too.
START_TIMEOUT = 30.0


def start_on_robots(args: argparse.Namespace) -> int | None:
    """Start the mission whose bundle is active on the robots of the inventory; None without an inventory.

    0 when it runs on all hosts of its deployment; 1 when a host refuses or ends, or no coordinator runs; 69
    when one was not reached: then nothing was started, unless it is left out.
    """
    from lfield.inventory.location import find_inventory
    from lfield.operator.fleet.active_missions import active_missions, left_behind

    if find_inventory(args.inventory, os.environ) is None:
        return None
    desk = open_desk(args)
    desk.addresses(args.without)
    asked = [host for host in desk.hosts if host not in args.without]
    if not asked:
        raise UsageError("no host is left: --without names all of them")
    statuses, silent = split_answers(desk.statuses(asked))
    found = active_missions(statuses, args.without)
    if len(found) != 1:
        return _report_no_mission(args, statuses, silent, found)
    mission = found[0]
    # The other robots of the inventory have no part in it.
    if failed := {host: error for host, error in silent.items() if host in mission.hosts}:
        return _report_silent(args, failed, [host for host in mission.hosts if host in statuses])
    without = [host for host in args.without if host in mission.hosts]
    if others := _runs_of_other_bundles(desk, without, mission.digest):
        text = f"nothing was started: {listed(others)}; stop it first, or push one bundle to all"
        return _report(args, {}, {}, text)
    if left := left_behind(mission, statuses):
        # They have no part in a new run.
        text = f"nothing was started: {listed(left)} still runs the last mission: 'lfield stop' ends it"
        return _report(args, {}, {}, text)
    hosts = [host for host in mission.hosts if host in statuses]
    before = {host: statuses[host] for host in hosts}
    with explained_interrupt("hosts that have received the order start"):
        return _start(desk, before, mission, without, args)


def _report_no_mission(
    args: argparse.Namespace,
    statuses: Mapping[str, ServiceStatus],
    silent: Mapping[str, LfieldError],
    found: Sequence[ActiveMission],
) -> int:
    """Print why it is not known which mission to start; returns the exit status."""
    from lfield.operator.fleet.active_missions import divided_hosts

    if found:
        each = [f"{one.name or short_digest(one.digest)} on {listed(one.hosts)}" for one in found]
        text = f"several missions are active ({'; '.join(each)}): --without leaves out hosts of the others"
        return _report(args, {}, {}, f"nothing was started: {text}")
    if divided := divided_hosts(statuses):
        active = [f"{host}: {short_digest(statuses[host].active) or 'none'}" for host in divided]
        text = f"the active bundles differ ({listed(active)}): 'lfield push' activates one on all of them"
        return _report(args, {}, {}, f"nothing was started: {text}")
    if silent:
        return _report_silent(args, silent, list(statuses))
    text = (
        f"nothing was started: no bundle is active on {listed(list(statuses))}: 'lfield push' activates one"
    )
    return _report(args, {}, {}, text)


def _report_silent(args: argparse.Namespace, failed: Mapping[str, LfieldError], others: list[str]) -> int:
    report_unreached(failed, "")
    hint = "".join(f" --without {host}" for host in failed)
    text = f"; to start without them:{hint}" if others else ""
    return _report(args, {}, failed, f"nothing was started{text}")


def _runs_of_other_bundles(desk: FleetDesk, hosts: list[str], digest: bytes) -> list[str]:
    """The hosts that are left out, answer, and run another bundle."""
    statuses, _ = split_answers(desk.statuses(hosts))
    return [
        f"{host} runs bundle {short_digest(status.run.bundle)}"
        for host, status in statuses.items()
        if status.run.phase in ACTIVE_PHASES and status.run.bundle != digest
    ]


def _start(
    desk: FleetDesk,
    before: Mapping[str, ServiceStatus],
    mission: ActiveMission,
    without: list[str],
    args: argparse.Namespace,
) -> int:
    """Start the hosts, whose states `before` are known, and wait until they are up; the exit status."""
    from lfield.cli.fleet.status_view import differing_versions
    from lfield.operator.fleet.activation import ID_SIZE
    from lfield.operator.fleet.active_missions import idle_coordinators, idle_text, is_idle
    from lfield.wire.service_messages import CommandResult, MissionCommand

    if versions := differing_versions(before):
        print(versions, file=sys.stderr)
    hosts, continues, digest = list(before), _suspended(before), mission.digest
    order = MissionCommand("start", digest, without=without, order=secrets.token_bytes(ID_SIZE))
    results, failed = split_answers(desk.command(hosts, order, CommandResult, START_TIMEOUT))
    report_unreached(failed, ", its start is not confirmed")
    refusals = {host: result.trouble for host, result in results.items() if result.trouble}
    if refusals or failed:
        running = [host for host, result in results.items() if result.run.phase in ACTIVE_PHASES]
        return _report(args, refusals, failed, _partial_start_text(running, list(failed)))
    statuses, failed = _wait_until_up(desk, hosts)
    idle = idle_coordinators(mission, statuses)
    gone = {one.agent for one in idle}
    continues = [agent for agent in continues if agent not in gone]
    if not args.json:
        for agent in continues:
            print(escape_line(f"{agent} continues: it has not ended ('lfield stop --discard' would end it)"))
    if failed or (waits := _waits(statuses)):
        is_over = any(one.run.has_completed for one in statuses.values())
        what = "has ended with a failure" if is_over else "does not run on all hosts yet"
        text = f"the mission {what}: 'lfield status' shows it"
        return _report(args, _waits(statuses), failed, text, continues)
    waits = {one.host: idle_text(idle, one.host) for one in idle}
    bundle = short_digest(digest)
    if is_idle(mission, idle) or any(one.is_parked for one in idle):
        rest = (
            "but no coordinator runs there"
            if is_idle(mission, idle)
            else "but not all coordinators run there"
        )
        return _report(args, waits, {}, f"bundle {bundle} is up on {listed(hosts)}, {rest}", continues)
    is_over = all(one.run.has_completed for one in statuses.values())
    text = f"bundle {bundle} {'has run to its end' if is_over else 'runs'} on {listed(hosts)}"
    return _report(args, waits, {}, text, continues, done=True)


def _wait_until_up(
    desk: FleetDesk, hosts: Sequence[str]
) -> tuple[dict[str, ServiceStatus], dict[str, LfieldError]]:
    """Wait until all hosts are up and stay so, or it is clear that they will not.

    Returns the last states of the hosts, and those that were not reached.
    """
    end = time.monotonic() + SETTLE_TIMEOUT
    up_since: float | None = None
    #: When hosts have failed, and since when one has ended and does not restart.
    failures: set[tuple[str, float]] = set()
    gone_since: float | None = None
    while True:
        statuses, failed = split_answers(desk.statuses(hosts))
        now, waits = time.monotonic(), _waits(statuses)
        for host, status in statuses.items():
            if status.run.phase == "waiting":
                failures.add((host, status.run.since))
        phases = {status.run.phase for status in statuses.values()}
        up_since = None if waits or failed else up_since or now
        if up_since is not None and (now - up_since >= STEADY or "ended" in phases):
            return statuses, failed
        most = max((sum(host == one for one, _ in failures) for host in hosts), default=0)
        # A host whose mission has ended in order does not mean that others will not come up.
        gone = [host for host in waits if statuses[host].run.phase not in ("running", "starting", "waiting")]
        gone_since = gone_since or now if gone else None
        # The others may be in the middle of their start, or end too.
        is_stable = gone_since is not None and (len(gone) == len(waits) or now - gone_since >= STEADY)
        if now > end or is_stable or most >= MAX_FAILURES:
            return statuses, failed
        time.sleep(POLL_INTERVAL)


def _waits(statuses: Mapping[str, ServiceStatus]) -> dict[str, str]:
    """Why hosts do not run the mission."""
    reasons = {host: _waiting(status) for host, status in statuses.items()}
    return {host: reason for host, reason in reasons.items() if reason}


def _suspended(statuses: Mapping[str, ServiceStatus]) -> list[str]:
    """The coordinators that have not ended on hosts that do not run: a start continues them."""
    found = [
        one.agent
        for status in statuses.values()
        if status.run.phase not in ACTIVE_PHASES
        for one in status.unfinished
    ]
    return list(dict.fromkeys(found))


def _partial_start_text(running: list[str], unknown: list[str]) -> str:
    """What a start that was not carried out by all hosts has done."""
    parts = [f"it runs on {listed(running)}"] if running else []
    parts += [f"it may run on {listed(unknown)}"] if unknown else []
    if not parts:
        return "nothing was started"
    rest = "'lfield status' shows the state, 'lfield stop' ends it"
    return f"the mission was not started on all hosts: {' and '.join(parts)}; {rest}"


def _waiting(status: ServiceStatus) -> str:
    """Why a host does not run the mission; '' if it does, or has ended in order."""
    run = status.run
    if run.phase == "ended" and run.status == exit_status.DONE:
        return ""
    if run.phase == "waiting":
        return f"its host restarts: {run.reason}"
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
