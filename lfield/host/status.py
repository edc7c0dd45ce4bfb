"""What a host tells `lfield ps` and `lfield query`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.host.core import HostCore
from lfield.journal.journal import Journal
from lfield.journal.pages import CopyPage
from lfield.manifest import DeviceValue
from lfield.mission.access.release import Release
from lfield.net.peers import Peers
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
from lfield.wire.fields import MAX_LABEL, MAX_NUMBERS, Telemetry, age, clip
from lfield.wire.observing import (
    AgentStatus,
    BegunStatus,
    BundleStatus,
    DeviceStatus,
    JournalStatus,
    LinkStatus,
    ParkedStatus,
    ReservedStatus,
    Status,
)

#: The states of threads, the liveliest first.
LIVELIEST = (READY, WAITING, CALLING, BLOCKED, SLEEPING, PARKED, DEAD)

#: Of so many calls that were begun a host tells.
MOST_BEGUN = 1024


def status_of(
    core: HostCore,
    peers: Peers,
    guards: Guards,
    journal: Journal | None,
    address: str,
    up: float,
    clock: Clock,
    unkept: str,
) -> Status:
    """The status of a host that has been `up` for so many seconds, to the millisecond."""
    now = clock.monotonic()
    lateness = guards.lateness if guards.telemetry else None
    return Status(
        host=core.name,
        address=address,
        up=_since(up),
        program=core.mission.program.digest,
        deployment=core.team.deployment,
        agents=[_agent(agent, core) for agent in core.machine.agents.values()],
        coordinators=core.coordinators.keeping.on_record(core.mobility.knowledge(), core.name),
        devices=_devices(guards, now),
        links=[
            *(LinkStatus(host, None, *peers.watch.figures(host)) for host in sorted(peers.incarnations)),
            *(LinkStatus(host, _since(now - since)) for host, since in peers.away.items()),
        ],
        directory=core.directory.told(),
        late=_since(lateness.last_minute(now)) if lateness else None,
        silence=lateness.limit.silence if lateness else None,
        journal=_journal(journal, core, now) if journal is not None else None,
        lease=core.leases.left,
        paused=core.coordinators.paused,
        begun=[
            BegunStatus(call.agent, call.generation, call.resource, clip(call.portal), call.state)
            for call in core.machine.begun_calls()[:MOST_BEGUN]
        ],
        reserved=[
            ReservedStatus(held.resource, *held.holder, _since(now - held.since), _since(held.until - now))
            for held in core.reserving.held
        ],
        bundle=_bundle(core.mission.release),
        stopped=clip(core.coordinators.stopped),
        unkept=clip(unkept),
        refused=core.startup.readiness.refused,
        start=core.startup.status,
        epochs=core.orders.epochs,
    )


def _bundle(release: Release) -> BundleStatus | None:
    return BundleStatus(release.digest, clip(release.by), release.at) if release.digest else None


def _journal(journal: Journal, core: HostCore, now: float) -> JournalStatus:
    commits, trouble = journal.commits_last_minute(now), clip(core.coordinators.trouble or journal.trouble)
    return JournalStatus(commits, trouble, [_parked(page) for page in core.mobility.parked])


def _parked(page: CopyPage) -> ParkedStatus:
    state = "EXITED" if page.state == "ABSENT" else page.state
    return ParkedStatus(page.agent, page.generation, page.hops, page.program, state, page.target)


def _since(seconds: float) -> float:
    return round(age(seconds), 3)


def _agent(agent: Agent, core: HostCore) -> AgentStatus:
    block = agent.block
    states = [block.w[place + THREAD_STATE] for place in threads(block)]
    return AgentStatus(
        id=agent.id,
        type=clip(agent.member.type),
        kind="coordinator" if agent.member.kind == "coordinator" else "resource",
        state=state_of(agent, core, states),
        hops=agent.hops,
        served=agent.served,
        heap=8 * block.top,
        limit=agent.limits.heap,
        threads=len(states),
    )


def state_of(agent: Agent, core: HostCore, states: list[int]) -> str:
    """One word for what an agent does whose threads are in these states: what the liveliest does."""
    busiest = STATE_NAMES[min(states, key=LIVELIEST.index)] if states else "idle"
    return agent.ended or core.waits(agent) or busiest


def _devices(guards: Guards, now: float) -> list[DeviceStatus]:
    heard, latched, moving = guards.heard, guards.latched, guards.moving
    return [
        DeviceStatus(
            clip(name),
            telemetry_of(values),
            _since(now - heard[name]) if name in heard else None,
            clip(latched.get(name, "")),
            clip(moving.get(name, "")),
        )
        for name, values in guards.telemetry.items()
    ]


def telemetry_of(values: Mapping[str, DeviceValue]) -> dict[str, Telemetry]:
    """The values of a device as a message may carry them."""
    return {clip(name, MAX_LABEL): _shown(value) for name, value in values.items() if value is not None}


def _shown(value: bool | int | float | str | Sequence[int | float]) -> Telemetry:
    """A value as a message may carry it: of a long one the beginning."""
    match value:
        case bool() | int() | float():
            return value
        case str():
            return clip(value)
        case _:
            return list(value[:MAX_NUMBERS])
