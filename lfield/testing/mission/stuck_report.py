"""A description of the waits of every agent of a team, for a mission that does not end."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.testing.mission.recorders import Hop
from lfield.text.suggestions import listed
from lfield.vm.agent import POLLS, WAITS, Agent, TeamMember
from lfield.vm.inspection import traceback
from lfield.vm.memory.layout import (
    BLOCKED,
    CALLING,
    STATE_NAMES,
    THREAD_ID,
    THREAD_PC,
    THREAD_STATE,
    W_GENERATION,
    W_HOPS,
    W_OWNER,
    WAITING,
)
from lfield.vm.memory.threads import place_of, threads


def stuck_report(fleet: Fleet, ended: Mapping[str, str], hops: Sequence[Hop]) -> list[str]:
    """A line for every thread of every agent, every missing host, and every lost coordinator. `ended` has the
    outcomes of coordinators, `hops` their migrations.
    """
    lines = []
    for name in fleet.mission.team.hosts:
        run = fleet.runs.get(name)
        if run is None:
            lines.append(f"{name} is not running")
            continue
        lines += _links(run, fleet.mission.team.hosts)
        if run.core.coordinators.paused:
            lines.append(f"{name} is paused")
        for agent in run.core.machine.agents.values():
            if not _has_left(fleet, agent):
                lines += _agent(fleet, run, agent)
    present = {id for run in fleet.runs.values() for id in run.core.machine.agents}
    missing = (member for member in fleet.mission.team.initial_coordinators if member.id not in present)
    return lines + [_missing(fleet, member, ended.get(member.id, ""), hops) for member in missing]


def _missing(fleet: Fleet, member: TeamMember, outcome: str, hops: Sequence[Hop]) -> str:
    """A coordinator that is on no host."""
    if outcome:
        return f"{member.id}: {outcome}"
    origin = fleet.mission.team.hosts[member.host]
    last = next((hop.target for hop in reversed(hops) if hop.agent == member.id), "")
    host = last or origin
    if host not in fleet.runs:
        return (
            f"{member.id} is missing: {'it was on' if last else 'it starts on'} {host}, which is not running"
        )
    about = re.compile(rf"(^|.* and ){re.escape(member.id)} ")
    messages = [text.strip() for _, name, text in fleet.log if name == host and about.match(text)]
    log_text = f"; {host} logged: {messages[-1]}" if messages else ""
    return (
        f"{member.id} is on no host: {'it was last on' if last else 'it has not started on'} {host}{log_text}"
    )


def _has_left(fleet: Fleet, agent: Agent) -> bool:
    """Whether a coordinator has migrated already, with the confirmation still on its way."""
    copies = [run.core.machine.agents.get(agent.id) for run in fleet.runs.values()]
    return agent.frozen and any(copy is not None and _is_later(copy, agent) for copy in copies)


def _is_later(copy: Agent, agent: Agent) -> bool:
    """Whether a copy is of the same epoch after more hops."""
    own, other = agent.block.w, copy.block.w
    return other[W_GENERATION] == own[W_GENERATION] and other[W_HOPS] > own[W_HOPS]


def _links(run: HostRun, hosts: Sequence[str]) -> list[str]:
    """Peers that the host has tried to reach and is not connected to."""
    unreachable = [host for host in hosts if host in run.host.peers.down_since]
    return [f"{run.core.name} has no link with {listed(unreachable)}"] if unreachable else []


def _agent(fleet: Fleet, run: HostRun, agent: Agent) -> list[str]:
    core = run.core
    if agent.ended:
        return [f"{agent.id} on {core.name}: {agent.ended}"]
    prefix = f"{agent.id} on {core.name}:"
    found = [
        f"{prefix} {_activity(fleet, run, agent, place)} {_position(run, agent, place)}".rstrip()
        for place in threads(agent.block)
    ]
    return found or [f"{prefix} idle"]


def _position(run: HostRun, agent: Agent, place: int) -> str:
    """The position of a thread: `at Post.work (walk.L:4)`."""
    return " ".join(traceback.lines(agent.block, run.core.mission.program, place)[:1])


def _activity(fleet: Fleet, run: HostRun, agent: Agent, place: int) -> str:
    """The activity of a thread, and the portal, device or lock that it waits for."""
    state = agent.block.w[place + THREAD_STATE]
    if state == WAITING:
        return f"waits for {_instruction(run, agent, place)}"
    if agent.id in run.core.machine.hooks.stubs:
        return "its double has not returned yet"
    if agent.monitor_waits.get(agent.block.w[place + THREAD_ID]) in (WAITS, POLLS):
        return "waits until its condition holds,"
    if state == BLOCKED:
        return f"waits for the lock {_holder(run, agent)},"
    if agent.member.kind == "coordinator":
        return _waits(fleet, run, agent, state)
    return STATE_NAMES[state]


def _waits(fleet: Fleet, run: HostRun, agent: Agent, state: int) -> str:
    """The calls that a coordinator waits for: its call, or the calls of its `together`."""
    core = run.core
    called = core.machine.itinerary.current_target(agent) if agent.frozen or state == CALLING else None
    runs = fleet.runs.values()
    pending = [
        call for each in runs for call in each.core.machine.pending_calls.calls() if call.agent == agent.id
    ]
    names = [f"{call.resource}.{call.portal}()" for call in pending if call.state == "running"]
    if called:
        first = f"{called[0].id}.{called[1]}()"
        others = [name for name in names if name != first]
        target = f"for {first}" if called[1] else f"to reserve {called[0].id}"
        text = f"{core.wait_reason(agent) or 'waits'} {target}"
        return f"{text}, beside {listed(others)}" if others else text
    running = listed(names) if names else ""
    if running and state == CALLING:
        return f"waits for {running}"
    return core.wait_reason(agent) or STATE_NAMES[state]


def _holder(run: HostRun, agent: Agent) -> str:
    """The holder of the lock of a resource, and its position."""
    thread = agent.block.w[W_OWNER]
    place = place_of(agent.block, thread)
    if not place:
        return "that is free"
    caller = run.core.machine.served_calls.caller(agent, thread)
    return f"that {caller.id if caller else agent.id} holds {_position(run, agent, place)}"


def _instruction(run: HostRun, agent: Agent, place: int) -> str:
    """The device instruction that a thread waits for."""
    group = run.core.machine.engine.groups[agent.block.w[place + THREAD_PC]]
    call = run.core.mission.program.core.device_calls[group.head.a]
    return f"{call.field}.{call.instruction}()"
