"""Where every agent of a team stands and what it waits for, in words: for a mission that does not end."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from lfield.simulate.fleet import Fleet, Life
from lfield.testing.mission.watching import Hop
from lfield.text.suggest import listed
from lfield.vm.agent import Agent, Member
from lfield.vm.inspect import traceback
from lfield.vm.memory.layout import (
    BLOCKED,
    CALLING,
    STATE_NAMES,
    THREAD_PC,
    THREAD_STATE,
    W_GENERATION,
    W_HOPS,
    W_OWNER,
    WAITING,
)
from lfield.vm.memory.threads import place_of, threads


def standing(fleet: Fleet, ended: Mapping[str, str], hops: Sequence[Hop]) -> list[str]:
    """A line for every thread of every agent, for every host that is not there, and for every coordinator
    that is nowhere. `ended` says how coordinators did, `hops` where they were."""
    lines = []
    for name in fleet.mission.team.hosts:
        life = fleet.lives.get(name)
        if life is None:
            lines.append(f"{name} does not run")
            continue
        lines += _links(life, fleet.mission.team.hosts)
        if life.core.coordinators.paused:
            lines.append(f"{name} is paused: nothing runs there until it is resumed")
        for agent in life.core.machine.agents.values():
            if not _has_left(fleet, agent):
                lines += _agent(fleet, life, agent)
    there = {id for life in fleet.lives.values() for id in life.core.machine.agents}
    missing = (member for member in fleet.mission.team.coordinators if member.id not in there)
    return lines + [_missing(fleet, member, ended.get(member.id, ""), hops) for member in missing]


def _missing(fleet: Fleet, member: Member, outcome: str, hops: Sequence[Hop]) -> str:
    """A coordinator that is on no host."""
    if outcome:
        return f"{member.id}: {outcome}"
    home = fleet.mission.team.hosts[member.host]
    last = next((hop.target for hop in reversed(hops) if hop.agent == member.id), "")
    host = last or home
    if host not in fleet.lives:
        return f"{member.id} is nowhere: {'it was on' if last else 'it begins on'} {host}, which does not run"
    about = re.compile(rf"(^|.* and ){re.escape(member.id)} ")
    said = [text.strip() for _, name, text in fleet.log if name == host and about.match(text)]
    why = f"; {host} said: {said[-1]}" if said else ""
    return f"{member.id} is nowhere: {'it was last on' if last else 'it has not begun on'} {host}{why}"


def _has_left(fleet: Fleet, agent: Agent) -> bool:
    """Whether a coordinator goes on elsewhere already; only the answer of that host is on its way here."""
    copies = [life.core.machine.agents.get(agent.id) for life in fleet.lives.values()]
    return agent.frozen and any(copy is not None and _is_later(copy, agent) for copy in copies)


def _is_later(copy: Agent, agent: Agent) -> bool:
    """Whether it is the same start, after more hops."""
    mine, other = agent.block.w, copy.block.w
    return other[W_GENERATION] == mine[W_GENERATION] and other[W_HOPS] > mine[W_HOPS]


def _links(life: Life, hosts: Sequence[str]) -> list[str]:
    """Which hosts it does not hear, of those that it has tried to reach."""
    away = [host for host in hosts if host in life.host.peers.away]
    return [f"{life.core.name} has no link with {listed(away)}"] if away else []


def _agent(fleet: Fleet, life: Life, agent: Agent) -> list[str]:
    core = life.core
    if agent.ended:
        return [f"{agent.id} on {core.name}: {agent.ended}"]
    here = f"{agent.id} on {core.name}:"
    found = [
        f"{here} {_does(fleet, life, agent, place)} {_stands(life, agent, place)}".rstrip()
        for place in threads(agent.block)
    ]
    return found or [f"{here} idle"]


def _stands(life: Life, agent: Agent, place: int) -> str:
    """Where a thread is, as `at Post.work (walk.L:4)`."""
    return " ".join(traceback.lines(agent.block, life.core.mission.program, place)[:1])


def _does(fleet: Fleet, life: Life, agent: Agent, place: int) -> str:
    """What a thread does, in a word, and for what of a portal, a device or a lock it waits."""
    state = agent.block.w[place + THREAD_STATE]
    if state == WAITING:
        return f"waits for {_instruction(life, agent, place)}"
    if agent.id in life.core.machine.attached.stand_ins:
        return "its double has not answered yet"
    if state == BLOCKED:
        return f"waits for the lock {_holder(life, agent)},"
    if agent.member.kind == "coordinator":
        return _waits(fleet, life, agent, state)
    return STATE_NAMES[state]


def _waits(fleet: Fleet, life: Life, agent: Agent, state: int) -> str:
    """What a coordinator waits for: a call that it makes, or those that its `together` has begun anywhere."""
    core = life.core
    called = core.machine.calling(agent) if agent.frozen or state == CALLING else None
    lives = fleet.lives.values()
    begun = [call for one in lives for call in one.core.machine.begun_calls() if call.agent == agent.id]
    names = [f"{call.resource}.{call.portal}()" for call in begun if call.state == "running"]
    if called:
        first = f"{called[0].id}.{called[1]}()"
        beside = [name for name in names if name != first]
        what = f"for {first}" if called[1] else f"to reserve {called[0].id}"
        words = f"{core.waits(agent) or 'waits'} {what}"
        return f"{words}, beside {listed(beside)}" if beside else words
    running = listed(names) if names else ""
    if running and state == CALLING:
        return f"waits for {running}"
    return core.waits(agent) or STATE_NAMES[state]


def _holder(life: Life, agent: Agent) -> str:
    """Who has the lock of a resource, and where that stands."""
    thread = agent.block.w[W_OWNER]
    place = place_of(agent.block, thread)
    if not place:
        return "that is free"
    caller = life.core.machine.caller(agent, thread)
    return f"that {caller.id if caller else agent.id} holds {_stands(life, agent, place)}"


def _instruction(life: Life, agent: Agent, place: int) -> str:
    """The instruction of a device that a thread waits for."""
    group = life.core.machine.engine.groups[agent.block.w[place + THREAD_PC]]
    call = life.core.mission.program.core.device_calls[group.head.a]
    return f"{call.field}.{call.instruction}()"
