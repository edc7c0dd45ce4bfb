"""What a host tells `lfield ps`: plain data, strings and numbers only."""

from __future__ import annotations

from typing import Any

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.host.core import HostCore
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
from lfield.wire.messages import Known

#: The states of threads, the liveliest first.
_LIVELIEST = (READY, WAITING, CALLING, BLOCKED, SLEEPING, PARKED, DEAD)


def status_of(
    core: HostCore, peers: Peers, guards: Guards, address: str, up: float, clock: Clock
) -> dict[str, Any]:
    """The agents, coordinators, links and devices of a host that has been `up` for so many seconds."""
    now = clock.monotonic()
    return {
        "host": core.name,
        "address": address,
        "up": round(up, 3),
        "program": core.mission.program.digest.hex()[:16],
        "deployment": core.team.deployment.hex()[:16],
        "agents": [_agent(agent) for agent in core.machine.agents.values()],
        "coordinators": coordinators_of(core),
        "linked": sorted(peers.incarnations),
        "away": {name: round(now - since, 3) for name, since in peers.away.items()},
        "devices": {name: dict(values) for name, values in guards.telemetry.items()},
        "silences": {name: round(now - heard, 3) for name, heard in guards.heard.items()},
        "latched": dict(guards.latched),
        "directory": core.directory.status(),
    }


def coordinators_of(core: HostCore) -> list[dict[str, Any]]:
    """What a host knows of every coordinator it has seen."""
    return [_coordinator(known) for known in core.mobility.knowledge()]


def _agent(agent: Agent) -> dict[str, Any]:
    block = agent.block
    states = [block.w[place + THREAD_STATE] for place in threads(block)]
    return {
        "id": agent.id,
        "type": agent.member.type,
        "kind": agent.member.kind,
        "state": agent.ended or ("leaving" if agent.frozen else _busiest(states)),
        "hops": agent.hops,
        "served": agent.served,
        "heap": 8 * block.top,
        "limit": agent.limits.heap,
        "threads": len(states),
    }


def _busiest(states: list[int]) -> str:
    """One word for all threads of an agent: what the liveliest does."""
    return STATE_NAMES[min(states, key=_LIVELIEST.index)] if states else "idle"


def _coordinator(known: Known) -> dict[str, Any]:
    return {
        "id": known.agent,
        "generation": known.generation,
        "sequence": known.sequence,
        "hops": known.hops,
        "state": known.state,
        "where": known.where,
        "outcome": known.outcome,
        "detail": known.detail,
    }
