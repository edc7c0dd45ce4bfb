"""Where everybody stands now: the telemetry of a host that its watchers are told, looked at and not kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lfield.devices.guards import Guards
from lfield.host.core import HostCore
from lfield.host.sight.watcher import Sample
from lfield.host.status import LIVELIEST, state_of, telemetry_of
from lfield.net.health.watch import Figures
from lfield.vm.agent import Agent
from lfield.vm.inspect import traceback
from lfield.vm.memory.layout import CALLING, THREAD_ID, THREAD_STATE
from lfield.vm.memory.threads import threads
from lfield.wire.events import Measured, Path, Standing, Thinned
from lfield.wire.fields import MAX_LABEL, age, clip


def sample(core: HostCore, guards: Guards, links: Mapping[str, Figures], now: float) -> Sample:
    """Every agent that has a thread, every device that was ever heard, and every link."""
    return dict([*_agents(core), *_devices(guards, now), *_links(links)])


def _agents(core: HostCore) -> Iterator[tuple[str, tuple[object, Thinned]]]:
    for agent in core.machine.agents.values():
        standing = _standing(agent, core)
        yield agent.id, (standing, standing)


def _standing(agent: Agent, core: HostCore) -> Standing:
    """The liveliest of its threads is shown."""
    w = agent.block.w
    places = list(threads(agent.block))
    state = clip(state_of(agent, core, [w[place + THREAD_STATE] for place in places]), MAX_LABEL)
    if not places:
        return Standing(agent.id, state, "", 0, "")
    busiest = min(places, key=lambda place: LIVELIEST.index(w[place + THREAD_STATE]))
    at = traceback.innermost(agent.block, core.machine.program, busiest)
    file, line = (at.file, at.line) if at is not None else ("", 0)
    waits = clip(_waits(agent, core, busiest), MAX_LABEL)
    return Standing(agent.id, state, clip(file, MAX_LABEL), line, waits)


def _waits(agent: Agent, core: HostCore, place: int) -> str:
    """The portal that a coordinator has called, or the instruction that a thread of a resource waits for."""
    w = agent.block.w
    if agent.member.kind == "resource":
        return core.commands.waits(agent, w[place + THREAD_ID])
    if not agent.frozen and w[place + THREAD_STATE] != CALLING:
        return ""
    called = core.machine.calling(agent)
    return ".".join(filter(None, (called[0].id, called[1]))) if called is not None else ""


def _devices(guards: Guards, now: float) -> Iterator[tuple[str, tuple[object, Thinned]]]:
    heard = guards.heard
    for name, values in guards.telemetry.items():
        if (when := heard.get(name)) is not None:
            measured = Measured(clip(name, MAX_LABEL), telemetry_of(values), age(now - when))
            # No agent's name has a space.
            yield f"device {name}", (when, measured)


def _links(links: Mapping[str, Figures]) -> Iterator[tuple[str, tuple[object, Thinned]]]:
    for host, figures in links.items():
        yield f"link {host}", (figures, Path(host, *figures))
