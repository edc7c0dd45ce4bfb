"""Starts the mission whose bundle is active on the robots of an inventory; waits until its hosts are up."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.client.service_desk import FleetDesk, split_answers
from lfield.errors import UsageError
from lfield.operator.fleet.activation import ID_SIZE
from lfield.operator.fleet.active_missions import (
    ActiveMission,
    active_missions,
    divided_hosts,
    idle_coordinators,
    idle_text,
    is_idle,
    left_behind,
)
from lfield.text.suggestions import listed
from lfield.wire.fields import short_digest
from lfield.wire.service_messages import CommandResult, MissionCommand

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.wire.service_messages import ServiceStatus

#: Seconds in which the hosts should be up and their coordinators started, and between two queries.
SETTLE_TIMEOUT, POLL_INTERVAL = 20.0, 0.5
#: Seconds for which all hosts must be up, and failures of a host after which it is not waited for.
STEADY, MAX_FAILURES = 2.0, 2
#: Phases in which a host runs, or will run by itself.
ACTIVE_PHASES = ("starting", "running", "waiting", "stopping")
#: Seconds for a host to be started; with --without its coordinators too.
START_TIMEOUT = 30.0


@dataclass(frozen=True, slots=True)
class StartResult:
    """The result of a start: whether the mission runs on all hosts of its deployment, as a sentence.

    `continues` are coordinators that had not ended, `waits` the hosts that do not run it, with the reasons.
    `unreached` are the hosts that did not answer an order or the first question, with the errors, `errors`
    also those that did not answer later. `consequence` is the effect on a host, as the end of a sentence.
    """

    text: str
    is_started: bool = False
    continues: Sequence[str] = ()
    waits: Mapping[str, str] = field(default_factory=dict)
    errors: Mapping[str, LfieldError] = field(default_factory=dict)
    unreached: Mapping[str, LfieldError] = field(default_factory=dict)
    consequence: str = ""

    def as_data(self) -> dict[str, object]:
        """The result as JSON data, as of `lfield start --json`."""
        return {
            "started": self.is_started,
            "continues": list(self.continues),
            "waits": dict(self.waits),
            "errors": {host: error.as_data() for host, error in self.errors.items()},
            "text": self.text,
        }


@dataclass(frozen=True, slots=True)
class StartPlan:
    """A start that may be ordered: the mission, the states of the hosts, and the hosts that are left out."""

    mission: ActiveMission
    before: Mapping[str, ServiceStatus]
    without: Sequence[str]


async def plan_start(desk: FleetDesk, without: Sequence[str] = ()) -> StartPlan | StartResult:
    """The start of the mission whose bundle is active on the robots; or the reason why no host is started.

    Raises UsageError.
    """
    desk.addresses(without)
    queried_hosts = [host for host in desk.hosts if host not in without]
    if not queried_hosts:
        raise UsageError("no host is left: --without names all of them")
    statuses, silent = split_answers(await desk.current_statuses(queried_hosts))
    found = active_missions(statuses, without)
    if len(found) != 1:
        return _no_mission(statuses, silent, found)
    mission = found[0]
    # The other robots of the inventory are not part of the mission.
    if failed := {host: error for host, error in silent.items() if host in mission.hosts}:
        return _silent(failed, [host for host in mission.hosts if host in statuses])
    left_out = [host for host in without if host in mission.hosts]
    if others := await _runs_of_other_bundles(desk, left_out, mission.digest):
        text = f"nothing was started: {listed(others)}; stop it first, or push one bundle to all"
        return StartResult(text)
    if still_running := left_behind(mission, statuses):
        # These hosts are not part of a new run.
        text = (
            f"nothing was started: {listed(still_running)} still runs the last mission: 'lfield stop' ends it"
        )
        return StartResult(text)
    hosts = [host for host in mission.hosts if host in statuses]
    return StartPlan(mission, {host: statuses[host] for host in hosts}, left_out)


def _no_mission(
    statuses: Mapping[str, ServiceStatus], silent: Mapping[str, LfieldError], found: Sequence[ActiveMission]
) -> StartResult:
    """The reason why the mission to start is unknown."""
    if found:
        each = [
            f"{mission.name or short_digest(mission.digest)} on {listed(mission.hosts)}" for mission in found
        ]
        text = f"several missions are active ({'; '.join(each)}): --without leaves out hosts of the others"
        return StartResult(f"nothing was started: {text}")
    if divided := divided_hosts(statuses):
        active = [f"{host}: {short_digest(statuses[host].active) or 'none'}" for host in divided]
        text = f"the active bundles differ ({listed(active)}): 'lfield push' activates one on all of them"
        return StartResult(f"nothing was started: {text}")
    if silent:
        return _silent(silent, list(statuses))
    text = f"no bundle is active on {listed(list(statuses))}: 'lfield push' activates one"
    return StartResult(f"nothing was started: {text}")


def _silent(failed: Mapping[str, LfieldError], others: list[str]) -> StartResult:
    hint = "".join(f" --without {host}" for host in failed)
    text = f"; to start without them:{hint}" if others else ""
    return StartResult(f"nothing was started{text}", errors=failed, unreached=failed)


async def _runs_of_other_bundles(desk: FleetDesk, hosts: list[str], digest: bytes) -> list[str]:
    """The hosts that are left out, answer, and run another bundle."""
    statuses, _ = split_answers(await desk.current_statuses(hosts))
    return [
        f"{host} runs bundle {short_digest(status.run.bundle)}"
        for host, status in statuses.items()
        if status.run.phase in ACTIVE_PHASES and status.run.bundle != digest
    ]


async def start_mission(desk: FleetDesk, plan: StartPlan) -> StartResult:
    """Start the hosts, and wait until they are up."""
    mission, before = plan.mission, plan.before
    hosts, continues, digest = list(before), _suspended(before), mission.digest
    id, without = secrets.token_bytes(ID_SIZE), list(plan.without)
    order = MissionCommand("start", digest, without=without, order=id, is_assistant=desk.is_assistant)
    results, failed = split_answers(await desk.order(hosts, order, CommandResult, START_TIMEOUT))
    refusals = {host: result.trouble for host, result in results.items() if result.trouble}
    if refusals or failed:
        running = [host for host, result in results.items() if result.run.phase in ACTIVE_PHASES]
        text = _partial_start_text(running, list(failed))
        return StartResult(
            text, waits=refusals, errors=failed, unreached=failed, consequence=", its start is not confirmed"
        )
    statuses, failed = await wait_until_up(desk, hosts)
    idle = idle_coordinators(mission, statuses)
    idle_agents = {coordinator.agent for coordinator in idle}
    continues = [agent for agent in continues if agent not in idle_agents]
    if failed or _waits(statuses):
        is_over = any(coordinator.run.has_completed for coordinator in statuses.values())
        state = "has ended with a failure" if is_over else "does not run on all hosts yet"
        text = f"the mission {state}: 'lfield status' shows it"
        return StartResult(text, continues=continues, waits=_waits(statuses), errors=failed)
    waits = {coordinator.host: idle_text(idle, coordinator.host) for coordinator in idle}
    bundle = short_digest(digest)
    if is_idle(mission, idle) or any(coordinator.is_parked for coordinator in idle):
        remark = (
            "but no coordinator runs there"
            if is_idle(mission, idle)
            else "but not all coordinators run there"
        )
        text = f"bundle {bundle} is up on {listed(hosts)}, {remark}"
        return StartResult(text, continues=continues, waits=waits)
    is_over = all(coordinator.run.has_completed for coordinator in statuses.values())
    text = f"bundle {bundle} {'has run to its end' if is_over else 'runs'} on {listed(hosts)}"
    return StartResult(text, True, continues, waits)


async def wait_until_up(
    desk: FleetDesk, hosts: Sequence[str]
) -> tuple[dict[str, ServiceStatus], dict[str, LfieldError]]:
    """Wait until all hosts are up and stay so, or it is clear that they will not.

    Returns the last states of the hosts, and those that were not reached.
    """
    clock = asyncio.get_running_loop().time
    end = clock() + SETTLE_TIMEOUT
    up_since: float | None = None
    #: The times of failures of hosts, and the time since which one has ended and does not restart.
    failures: set[tuple[str, float]] = set()
    ended_since: float | None = None
    while True:
        statuses, failed = split_answers(await desk.current_statuses(hosts))
        now, waits = clock(), _waits(statuses)
        for host, status in statuses.items():
            if status.run.phase == "waiting":
                failures.add((host, status.run.since))
        phases = {status.run.phase for status in statuses.values()}
        up_since = None if waits or failed else up_since or now
        if up_since is not None and (now - up_since >= STEADY or "ended" in phases):
            return statuses, failed
        maximum_failures = max(
            (sum(host == failed_host for failed_host, _ in failures) for host in hosts), default=0
        )
        # A host whose mission has ended in order does not mean that others will not come up.
        ended_hosts = [
            host for host in waits if statuses[host].run.phase not in ("running", "starting", "waiting")
        ]
        ended_since = ended_since or now if ended_hosts else None
        # The others may be in the middle of their start, or end too.
        is_stable = ended_since is not None and (
            len(ended_hosts) == len(waits) or now - ended_since >= STEADY
        )
        if now > end or is_stable or maximum_failures >= MAX_FAILURES:
            return statuses, failed
        await asyncio.sleep(POLL_INTERVAL)


def _waits(statuses: Mapping[str, ServiceStatus]) -> dict[str, str]:
    """The reasons why hosts do not run the mission."""
    reasons = {host: _waiting(status) for host, status in statuses.items()}
    return {host: reason for host, reason in reasons.items() if reason}


def _suspended(statuses: Mapping[str, ServiceStatus]) -> list[str]:
    """The coordinators that have not ended on hosts that do not run: a start continues them."""
    found = [
        coordinator.agent
        for status in statuses.values()
        if status.run.phase not in ACTIVE_PHASES
        for coordinator in status.unfinished
    ]
    return list(dict.fromkeys(found))


def _partial_start_text(running: list[str], unknown: list[str]) -> str:
    """The effect of a start that not all hosts have executed."""
    parts = [f"it runs on {listed(running)}"] if running else []
    parts += [f"it may run on {listed(unknown)}"] if unknown else []
    if not parts:
        return "nothing was started"
    advice = "'lfield status' shows the state, 'lfield stop' ends it"
    return f"the mission was not started on all hosts: {' and '.join(parts)}; {advice}"


def _waiting(status: ServiceStatus) -> str:
    """The reason why a host does not run the mission; '' if it does, or has ended in order."""
    run = status.run
    if run.phase == "ended" and run.status == exit_status.DONE:
        return ""
    if run.phase == "waiting":
        return f"its host restarts: {run.reason}"
    return run.reason or ("" if run.phase == "running" else run.phase)
