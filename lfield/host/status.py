"""The status of a host for `lfield ps` and `lfield query`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.clock import Clock
from lfield.devices.device_guards import DeviceGuards
from lfield.host.core import HostCore
from lfield.journal.journal import Journal
from lfield.journal.records import CoordinatorRecord
from lfield.manifest import DeviceValue
from lfield.mission.access.signed_bundle import BundleId
from lfield.net.link_manager import LinkManager
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import (
    BLOCKED,
    CALLING,
    DEAD,
    PARKED,
    READY,
    SLEEPING,
    STATE_NAMES,
    THREAD_STATE,
    WAITING,
)
from lfield.vm.memory.threads import threads
from lfield.wire.fields import MAX_LABEL, MAX_NUMBERS, Telemetry, bounded_duration, truncate
from lfield.wire.observer_messages import (
    AgentStatus,
    BundleStatus,
    DeviceStatus,
    JournalStatus,
    LinkStatus,
    ParkedStatus,
    PendingCallStatus,
    ReservedStatus,
    Status,
)

#: The states of threads, the most active first.
STATE_PRIORITY = (READY, WAITING, CALLING, BLOCKED, SLEEPING, PARKED, DEAD)

#: The maximum number of pending calls in a status.
MAX_PENDING_CALLS = 1024


def status_of(
    core: HostCore,
    links: LinkManager,
    guards: DeviceGuards,
    journal: Journal | None,
    address: str,
    uptime: float,
    clock: Clock,
    persist_error: str,
) -> Status:
    """The status of a host that has run for `uptime` seconds, to the millisecond."""
    now = clock.monotonic()
    lateness = guards.lateness if guards.telemetry else None
    return Status(
        host=core.name,
        address=address,
        up=_since(uptime),
        program=core.mission.program.digest,
        deployment=core.team.deployment,
        agents=[_agent(agent, core) for agent in core.machine.agents.values()],
        coordinators=core.locator.known_states(),
        devices=_devices(guards, now),
        links=[
            *(
                LinkStatus(host, None, *links.monitor.figures(host), *links.standbys.paths(host))
                for host in sorted(links.incarnations)
            ),
            *(LinkStatus(host, _since(now - since)) for host, since in links.down_since.items()),
        ],
        directory=core.directory.entries(),
        late=_since(lateness.last_minute(now)) if lateness else None,
        silence=lateness.limit.silence if lateness else None,
        journal=_journal(journal, core, now) if journal is not None else None,
        lease=core.leases.remaining,
        paused=core.coordinators.is_pause_ordered,
        pending_calls=[
            PendingCallStatus(call.agent, call.generation, call.resource, truncate(call.portal), call.state)
            for call in core.machine.pending_calls.calls()[:MAX_PENDING_CALLS]
        ],
        reserved=[
            ReservedStatus(
                held.resource, *held.holder, _since(now - held.held_since), _since(held.expires_at - now)
            )
            for held in core.reservations.held
        ],
        bundle=_bundle(core.mission.release),
        stopped=truncate(core.coordinators.stopped),
        persist_error=truncate(persist_error),
        refused=core.startup.readiness.refused,
        start=core.startup.status,
        epochs=core.orders.epochs,
        ballot=core.coordinators.ballot,
        observers=links.monitor.observers.by_name(),
        reads=core.machine.operator_input.waiting_agents,
        startable=core.sequencing.startable_now,
    )


def _bundle(release: BundleId) -> BundleStatus | None:
    return BundleStatus(release.digest, truncate(release.by), release.at) if release.digest else None


def _journal(journal: Journal, core: HostCore, now: float) -> JournalStatus:
    commits, problem = (
        journal.commits_last_minute(now),
        truncate(core.coordinators.write_problem or journal.problem),
    )
    return JournalStatus(commits, problem, [_parked(record) for record in core.mobility.parked])


def _parked(record: CoordinatorRecord) -> ParkedStatus:
    state = "EXITED" if record.state == "ABSENT" else record.state
    return ParkedStatus(record.agent, record.generation, record.hops, record.program, state, record.target)


def _since(seconds: float) -> float:
    return round(bounded_duration(seconds), 3)


def _agent(agent: Agent, core: HostCore) -> AgentStatus:
    block = agent.block
    states = [block.w[place + THREAD_STATE] for place in threads(block)]
    return AgentStatus(
        id=agent.id,
        type=truncate(agent.member.type),
        kind="coordinator" if agent.member.kind == "coordinator" else "resource",
        state=state_of(agent, core, states),
        hops=agent.hops,
        served=agent.served,
        heap=8 * block.top,
        limit=agent.limits.heap,
        threads=len(states),
    )


def state_of(agent: Agent, core: HostCore, states: list[int]) -> str:
    """The state of an agent whose threads are in these states: the state of the most active thread."""
    busiest = STATE_NAMES[min(states, key=STATE_PRIORITY.index)] if states else "idle"
    return agent.ended or core.wait_reason(agent) or busiest


def _devices(guards: DeviceGuards, now: float) -> list[DeviceStatus]:
    last_contact, latched, moving = guards.last_contact, guards.latched, guards.moving
    return [
        DeviceStatus(
            truncate(name),
            telemetry_of(values),
            _since(now - last_contact[name]) if name in last_contact else None,
            truncate(latched.get(name, "")),
            truncate(moving.get(name, "")),
        )
        for name, values in guards.telemetry.items()
    ]


def telemetry_of(values: Mapping[str, DeviceValue]) -> dict[str, Telemetry]:
    """The values of a device, bounded for a message."""
    return {truncate(name, MAX_LABEL): _bounded(value) for name, value in values.items() if value is not None}


def _bounded(value: bool | int | float | str | Sequence[int | float]) -> Telemetry:
    """A value, bounded for a message: a long value is cut."""
    match value:
        case bool() | int() | float():
            return value
        case str():
            return truncate(value)
        case _:
            return list(value[:MAX_NUMBERS])
