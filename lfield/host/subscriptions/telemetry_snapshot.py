"""Telemetry snapshot of a host for its subscribers: agents, devices, links; sampled, not stored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lfield.devices.device_guards import DeviceGuards
from lfield.host.core import HostCore
from lfield.host.events.event_subscription import TelemetrySample
from lfield.host.status import STATE_PRIORITY, state_of, telemetry_of
from lfield.net.health.link_monitor import LinkFigures
from lfield.vm.agent import Agent
from lfield.vm.inspection import traceback
from lfield.vm.memory.layout import CALLING, THREAD_ID, THREAD_STATE
from lfield.vm.memory.threads import threads
from lfield.wire.events import AgentActivity, DeviceTelemetry, LinkTelemetry, TelemetryEvent
from lfield.wire.fields import MAX_LABEL, bounded_duration, truncate


def snapshot(
    core: HostCore, guards: DeviceGuards, links: Mapping[str, LinkFigures], now: float
) -> TelemetrySample:
    """Every agent with a thread, every device with telemetry, and every link."""
    return dict([*_agents(core), *_devices(guards, now), *_links(links)])


def _agents(core: HostCore) -> Iterator[tuple[str, tuple[object, TelemetryEvent]]]:
    for agent in core.machine.agents.values():
        activity = agent_activity(agent, core)
        yield agent.id, (activity, activity)


def agent_activity(agent: Agent, core: HostCore) -> AgentActivity:
    """The activity of an agent: that of its most active thread."""
    w = agent.block.w
    places = list(threads(agent.block))
    state = truncate(state_of(agent, core, [w[place + THREAD_STATE] for place in places]), MAX_LABEL)
    if not places:
        return AgentActivity(agent.id, state, "", 0, "")
    busiest = min(places, key=lambda place: STATE_PRIORITY.index(w[place + THREAD_STATE]))
    at = traceback.innermost(agent.block, core.machine.program, busiest)
    file, line = (at.file, at.line) if at is not None else ("", 0)
    waits = truncate(_wait_text(agent, core, busiest), MAX_LABEL)
    return AgentActivity(agent.id, state, truncate(file, MAX_LABEL), line, waits)


def _wait_text(agent: Agent, core: HostCore, place: int) -> str:
    """The portal that a coordinator has called, or the instruction that a thread of a resource waits for."""
    w = agent.block.w
    if agent.member.kind == "resource":
        return core.commands.wait_reason(agent, w[place + THREAD_ID])
    if not agent.frozen and w[place + THREAD_STATE] != CALLING:
        return ""
    called = core.machine.itinerary.current_target(agent)
    return ".".join(filter(None, (called[0].id, called[1]))) if called is not None else ""


def _devices(guards: DeviceGuards, now: float) -> Iterator[tuple[str, tuple[object, TelemetryEvent]]]:
    last_contact = guards.last_contact
    for name, values in guards.telemetry.items():
        if (when := last_contact.get(name)) is not None:
            measured = DeviceTelemetry(
                truncate(name, MAX_LABEL), telemetry_of(values), bounded_duration(now - when)
            )
            # Agent names contain no space.
            yield f"device {name}", (when, measured)


def _links(links: Mapping[str, LinkFigures]) -> Iterator[tuple[str, tuple[object, TelemetryEvent]]]:
    for host, figures in links.items():
        yield f"link {host}", (figures, LinkTelemetry(host, *figures[:4]))
