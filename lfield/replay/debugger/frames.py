"""The threads of a host and their stacks at a moment: a portal's frames are above its coordinator's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeGuard

from msgspec import Struct

from lfield.replay.debugger.moment import PORTAL_DEPTH, Moment, ThreadKey, thread_key
from lfield.replay.debugger.statement_table import SourceLine
from lfield.replay.debugger.value_tree import ValueReader
from lfield.vm.agent import Agent
from lfield.vm.inspection.traceback import stack
from lfield.vm.memory.layout import (
    FRAME_CALLER,
    FRAME_DEPTH,
    STATE_NAMES,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_STATE,
)
from lfield.vm.memory.threads import only_thread, place_of, threads


class StackFrame(Struct, frozen=True):
    """One frame of a logical thread: the agent and its thread, the method, the position. `frame` is its
    place in the agent's block. `line` is None without debug information.
    """

    key: ThreadKey
    host: str
    method: str
    line: SourceLine | None
    pc: int
    frame: int
    depth: int


def live_agents(moment: Moment) -> dict[str, Agent]:
    """The agents of the host that have not ended."""
    return {name: each for name, each in moment.agents.items() if not each.ended}


def thread_keys(moment: Moment) -> list[ThreadKey]:
    """The threads of a host: coordinators, and the threads of resources that no waiting coordinator is in."""
    found = []
    for name, agent in live_agents(moment).items():
        for place in threads(agent.block):
            key = thread_key(moment.core, name, agent.block.w[place + THREAD_ID])
            if display_key(moment, key) == key:
                found.append(key)
    return found


def display_key(moment: Moment, key: ThreadKey) -> ThreadKey:
    """The thread in whose stack a thread is shown: that of the coordinator which waits for it, or itself."""
    agent = moment.agents.get(key.agent)
    if agent is None or agent.member.kind == "coordinator":
        return key
    caller = moment.core.machine.served_calls.caller(agent, key.thread)
    if isinstance(caller, Agent) and caller.block.w[0]:
        return ThreadKey(caller.id, caller.id, only_thread(caller.block))
    return key


def state_name(moment: Moment, key: ThreadKey) -> str:
    """The activity of a thread: 'ready', 'sleeping', 'in a portal'."""
    agent = moment.agents.get(key.agent)
    place = place_of(agent.block, key.thread) if agent is not None else 0
    if agent is None or not place:
        return ""
    return "suspended" if agent.frozen else STATE_NAMES[agent.block.w[place + THREAD_STATE]]


def stack_of(moment: Moment, key: ThreadKey) -> list[StackFrame]:
    """The frames of a thread, innermost first; [] if it is not on this host."""
    agent = live_agents(moment).get(key.agent)
    if agent is None or not place_of(agent.block, key.thread):
        return []
    served = next(_served(moment, agent), None) if agent.member.kind == "coordinator" else None
    above = list(_frames(moment, served)) if served is not None else []
    frames = [*above, *_frames(moment, key)]
    caller = (
        None
        if agent.member.kind == "coordinator"
        else moment.core.machine.served_calls.caller(agent, key.thread)
    )
    if isinstance(caller, Agent):
        frames += _frames(moment, ThreadKey(caller.id, caller.id, only_thread(caller.block)))
    return frames


def frame_places(moment: Moment, key: ThreadKey) -> list[tuple[str, int]]:
    """The agents and places of the frames of `stack_of`."""
    agent = moment.agents.get(key.agent)
    if agent is None or agent.ended or not place_of(agent.block, key.thread):
        return []
    found: list[tuple[str, int]] = []
    if agent.member.kind == "coordinator":
        served = next(_served(moment, agent), None)
        found = [] if served is None else _places(moment, served.agent, served.thread)
        return [*found, *_places(moment, key.agent, key.thread)]
    found = _places(moment, key.agent, key.thread)
    caller = moment.core.machine.served_calls.caller(agent, key.thread)
    return [*found, *_places(moment, caller.id, only_thread(caller.block))] if _is_here(caller) else found


def coordinator_key(moment: Moment, name: str) -> ThreadKey | None:
    """The thread of a coordinator on this host; None if it is not here."""
    agent = moment.agents.get(name)
    if agent is None or agent.ended or agent.member.kind != "coordinator":
        return None
    return ThreadKey(name, name, only_thread(agent.block))


def followed_places(moment: Moment, key: ThreadKey) -> list[tuple[str, int]]:
    """The frames of a thread; if it was one of a portal and has ended, those of its coordinator.

    A coordinator that is on its way to another host has none.
    """
    if key.agent != key.logical and (found := frame_places(moment, key)):
        return found
    agent = moment.agents.get(key.logical)
    if agent is None or (agent.frozen and moment.core.coordinators.is_departing(agent)):
        return []
    caller = coordinator_key(moment, key.logical)
    return [] if caller is None else frame_places(moment, caller)


def _is_here(caller: object) -> TypeGuard[Agent]:
    return isinstance(caller, Agent)


def _places(moment: Moment, name: str, thread: int) -> list[tuple[str, int]]:
    block = moment.agents[name].block
    place = block.w[place_of(block, thread) + THREAD_FRAME]
    found = []
    while place:
        if block.w[place] >> 8 & 0xFFFFFF not in moment.table.library:
            found.append((name, place))
        place = block.w[place + FRAME_CALLER]
    return found


def _served(moment: Moment, coordinator: Agent) -> Iterator[ThreadKey]:
    """The threads of resources in which a coordinator waits."""
    for name, agent in moment.agents.items():
        if agent.member.kind != "resource" or agent.ended:
            continue
        for place in threads(agent.block):
            thread = agent.block.w[place + THREAD_ID]
            if moment.core.machine.served_calls.caller(agent, thread) is coordinator:
                yield ThreadKey(coordinator.id, name, thread)


def _frames(moment: Moment, key: ThreadKey) -> Iterator[StackFrame]:
    agent, program = moment.agents[key.agent], moment.table.program
    block = agent.block
    added = 0 if key.agent == key.logical else PORTAL_DEPTH
    for at in stack(block, program, place_of(block, key.thread)):
        if at.method in moment.table.library:
            continue
        depth = block.w[at.frame + FRAME_DEPTH] + added
        line = SourceLine(at.file, at.line) if at.line else None
        name = program.method_name(at.method)
        yield StackFrame(key, moment.core.name, name, line, at.pc, at.frame, depth)


def reader_of(moment: Moment, agent: str) -> ValueReader:
    """Reads the values of an agent of the host."""
    members = [member.id for member in moment.core.team.members]
    return ValueReader(moment.agents[agent].block, moment.table.program, members)
