"""Where every agent of a team stands and what it waits for, in words: for a mission that does not end."""

from __future__ import annotations

from lfield.host.core import HostCore
from lfield.simulate.fleet import Fleet
from lfield.vm.agent import Agent
from lfield.vm.inspect import traceback
from lfield.vm.memory.layout import STATE_NAMES, THREAD_STATE
from lfield.vm.memory.threads import threads


def standing(fleet: Fleet) -> list[str]:
    """A line for every thread of every agent, and for every host that is not there."""
    lines = []
    for name in fleet.mission.team.hosts:
        life = fleet.lives.get(name)
        if life is None:
            lines.append(f"{name} does not run")
            continue
        for agent in life.core.machine.agents.values():
            lines += _agent(life.core, agent)
    return lines


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
    state = STATE_NAMES[agent.block.w[place + THREAD_STATE]]
    if agent.member.kind != "coordinator":
        return state
    called = core.machine.calling(agent) if agent.frozen else None
    words = core.waits(agent) or state
    return f"{words} for {called[0].id}.{called[1]}()" if called else words
