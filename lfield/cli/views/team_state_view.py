"""The state of a team from its events, as tables of agents and devices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Group, JustifyMethod
from rich.table import Table

from lfield.operator.safe_state_progress import SILENCE_TIMEOUT
from lfield.operator.team_model.team_state import AgentState, DeviceState, HostState, TeamState
from lfield.text.terminal_escape import escape_line
from lfield.text.value_text import telemetry_text


def table(state: TeamState, *, starting: bool = False) -> Group:
    """Agents by host, with a row for each host that does not answer; then devices.

    While the hosts are `starting`, one that has not answered yet is not reported as missing.
    """
    devices = device_table(device for vehicle in state.vehicles.values() for device in vehicle.devices)
    return Group(_agents(state, starting), *(("", devices) if devices.row_count else ()))


def _agents(state: TeamState, starting: bool) -> Table:
    right = "HOPS", "SERVED"
    rows = new_table("HOST", "AGENT", "TYPE", "STATE", "AT", *right, right=right)
    for name, host in state.hosts.items():
        agents = [agent for agent in state.agents.values() if agent.host == name and _is_known(agent)]
        if not host.linked or not agents:
            add_row(rows, name, "-", "", _host_state(host, starting))
        for agent in agents:
            moves = agent.kind == "coordinator"
            counts = ("" if agent.hops is None else str(agent.hops), "") if moves else ("", str(agent.served))
            add_row(rows, name, agent.agent, agent.type, _agent_state(agent), _place(agent), *counts)
    return rows


def _is_known(agent: AgentState) -> bool:
    return agent.age is not None


def _host_state(host: HostState, starting: bool) -> str:
    if host.linked:
        return "up, no agents"
    if host.age is None:
        return "starting" if starting else host.problem
    return f"no answer for {host.age:.0f} s"


def _agent_state(agent: AgentState) -> str:
    if agent.finished:
        return f"{agent.finished}: {agent.detail}".splitlines()[0].rstrip(": ")
    if agent.doubt:
        return f"in doubt: {agent.doubt}"
    return f"migrating to {agent.target}" if agent.target else agent.state


def _place(agent: AgentState) -> str:
    """The position of an agent in the program, and the portal or instruction that it waits for."""
    line = f"{agent.file}:{agent.line}" if agent.line and not agent.finished else ""
    return ", ".join(filter(None, (line, agent.waits_for and f"waits for {agent.waits_for}")))


def device_table(devices: Iterable[DeviceState]) -> Table:
    """A row for each device; telemetry takes the lines it needs, the state has one."""
    rows = new_table("HOST", "DEVICE", "STATE", "TELEMETRY", unbroken=("STATE",))
    for device in devices:
        add_row(rows, device.host, device.name, _device_state(device), telemetry_text(device.telemetry))
    return rows


def _device_state(device: DeviceState) -> str:
    if device.telemetry_age is not None and device.telemetry_age > SILENCE_TIMEOUT:
        return f"silent {device.telemetry_age:.0f} s"
    if not device.latched:
        return "in use" if device.telemetry_age is not None else "no telemetry yet"
    if not device.confirmed:
        return "safe state not confirmed"
    return f"safe: {device.moving}" if device.moving else "safe, at rest"


def new_table(*columns: str, right: Sequence[str] = (), unbroken: Sequence[str] = ()) -> Table:
    """A table without lines; columns are aligned to the `right`, or their cells are not wrapped."""
    rows = Table(box=None, pad_edge=False)
    for column in columns:
        justify: JustifyMethod = "right" if column in right else "left"
        rows.add_column(column, justify=justify, no_wrap=column in unbroken)
    return rows


def add_row(rows: Table, *cells: str) -> None:
    """Add a row; control characters in the text of hosts and programs are escaped."""
    rows.add_row(*map(escape_line, cells))
