"""A team as its streams tell it, as a table: who is where and what it does, and how every device is."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from lfield.operator.descent import SILENT
from lfield.operator.sight.seen import AgentSeen, DeviceSeen, HostSeen, Seen
from lfield.text.values import telemetry_in_words
from lfield.text.visible import in_one_line


def table(seen: Seen, *, starting: bool = False) -> Group:
    """Agents by their hosts, a line for each host that is not heard; then devices.

    While the hosts are `starting`, one that has not answered yet is not reported as missing.
    """
    devices = _devices(seen)
    return Group(_agents(seen, starting), *(("", devices) if devices.row_count else ()))


def _agents(seen: Seen, starting: bool) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "AGENT", "TYPE", "STATE", "AT", "HOPS", "SERVED"):
        shown.add_column(column, justify="right" if column in ("HOPS", "SERVED") else "left")
    for name, host in seen.hosts.items():
        here = [agent for agent in seen.agents.values() if agent.host == name and _is_known(agent)]
        if not host.linked or not here:
            _add(shown, name, "-", "", _host_state(host, starting))
        for agent in here:
            moves = agent.kind == "coordinator"
            counts = ("" if agent.hops is None else str(agent.hops), "") if moves else ("", str(agent.served))
            _add(shown, name, agent.agent, agent.type, _agent_state(agent), _place(agent), *counts)
    return shown


def _is_known(agent: AgentSeen) -> bool:
    return agent.age is not None


def _host_state(host: HostSeen, starting: bool) -> str:
    if host.linked:
        return "up, no agents"
    if host.age is None:
        return "starting" if starting else host.trouble
    return f"last heard {host.age:.0f} s ago: {host.trouble}"


def _agent_state(agent: AgentSeen) -> str:
    if agent.finished:
        return f"{agent.finished}: {agent.detail}".splitlines()[0].rstrip(": ")
    if agent.doubt:
        return f"in doubt: {agent.doubt}"
    return f"on its way to {agent.to}" if agent.to else agent.state


def _place(agent: AgentSeen) -> str:
    """Where in its program it stands, and what it waits for."""
    line = f"{agent.file}:{agent.line}" if agent.line and not agent.finished else ""
    return ", ".join(filter(None, (line, agent.waits and f"waits for {agent.waits}")))


def _devices(seen: Seen) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "DEVICE", "STATE", "TELEMETRY"):
        shown.add_column(column, no_wrap=column == "STATE")
    for vehicle in seen.vehicles.values():
        for device in vehicle.devices:
            told = {name: reading.value for name, reading in device.readings.items()}
            _add(shown, device.host, device.name, _device_state(device), telemetry_in_words(told))
    return shown


def _device_state(device: DeviceSeen) -> str:
    if device.silent is not None and device.silent > SILENT:
        return f"silent {device.silent:.0f} s"
    if not device.latched:
        return "in use" if device.silent is not None else "no telemetry yet"
    if not device.confirmed:
        return "safe state not confirmed"
    return f"safe: {device.moving}" if device.moving else "safe, at rest"


def _add(shown: Table, *cells: str) -> None:
    """A row of what hosts say of programs, devices and themselves; a terminal obeys none of it."""
    shown.add_row(*map(in_one_line, cells))
