"""Where every agent of a team stands and what it waits for, in words: for a mission that does not end."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.host.core import HostCore
from lfield.simulate.fleet import Fleet, Life
from lfield.text.suggest import listed
from lfield.vm.agent import Agent
from lfield.vm.inspect import traceback
from lfield.vm.memory.layout import CALLING, STATE_NAMES, THREAD_PC, THREAD_STATE, WAITING
from lfield.vm.memory.threads import threads


def standing(fleet: Fleet) -> list[str]:
    """A line for every thread of every agent, and for every host that is not there."""
    lines = []
    for name in fleet.mission.team.hosts:
        life = fleet.lives.get(name)
        if life is None:
            lines.append(f"{name} does not run")
            continue
        lines += _links(life, fleet.mission.team.hosts)
        for agent in life.core.machine.agents.values():
            lines += _agent(life.core, agent)
    return lines


def _links(life: Life, hosts: Sequence[str]) -> list[str]:
    """Which hosts it does not hear, of those that it has tried to reach."""
    away = [host for host in hosts if host in life.host.peers.away]
    return [f"{life.core.name} has no link with {listed(away)}"] if away else []


def _agent(core: HostCore, agent: Agent) -> list[str]:
    if agent.ended:
        return [f"{agent.id} on {core.name}: {agent.ended}"]
    block, found = agent.block, []
    for place in threads(block):
        stack = traceback.lines(block, core.mission.program, place)
        found.append(f"{agent.id} on {core.name}: {_does(core, agent, place)} {' '.join(stack[:1])}".rstrip())
    return found or [f"{agent.id} on {core.name}: idle"]


def _does(core: HostCore, agent: Agent, place: int) -> str:
    """What a thread does, in a word, and for what of a portal or a device it waits."""
    state = agent.block.w[place + THREAD_STATE]
    if state == WAITING:
        return f"waits for {_instruction(core, agent, place)}"
    if agent.id in core.machine.attached.stand_ins:
        return "its double has not answered yet"
    if agent.member.kind != "coordinator":
        return STATE_NAMES[state]
    called = core.machine.calling(agent) if agent.frozen or state == CALLING else None
    words = core.waits(agent) or "waits"
    if called is None:
        return core.waits(agent) or STATE_NAMES[state]
    return f"{words} for {called[0].id}.{called[1]}()" if called[1] else f"{words} to reserve {called[0].id}"


def _instruction(core: HostCore, agent: Agent, place: int) -> str:
    """The instruction of a device that a thread waits for."""
    group = core.machine.engine.group(agent.block.w[place + THREAD_PC])
    call = core.mission.program.core.device_calls[group.head.a]
    return f"{call.field}.{call.instruction}()"
