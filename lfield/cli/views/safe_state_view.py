"""The progress of devices to rest after an emergency stop: a table that is redrawn in a terminal, else
lines.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext

from rich.live import Live
from rich.table import Table

from lfield.cli.views.team_state_view import add_row, new_table
from lfield.cli.views.trees import plain_console
from lfield.clock import Clock, SystemClock
from lfield.net.transport import Transport
from lfield.operator.client import SNAPSHOT, ask_all
from lfield.operator.safe_state_progress import SafeStateProgress
from lfield.operator.targets import HostRef
from lfield.operator.team_model.host_model import host_states
from lfield.text.terminal_escape import escape_line
from lfield.text.value_text import telemetry_text

#: Seconds between two polls.
INTERVAL = 0.5


def watch_progress(
    progress: SafeStateProgress,
    transport: Transport,
    addresses: Mapping[HostRef, str],
    names: Mapping[HostRef, str],
) -> None:
    """Poll and print until the devices are at rest. Ctrl-C raises KeyboardInterrupt."""
    live = Live(console=plain_console(), auto_refresh=False) if sys.stdout.isatty() else None
    display: AbstractContextManager[object] = live or nullcontext()
    with display:
        asyncio.run(_poll(progress, transport, addresses, names, live, SystemClock()))


async def _poll(
    progress: SafeStateProgress,
    transport: Transport,
    addresses: Mapping[HostRef, str],
    names: Mapping[HostRef, str],
    live: Live | None,
    clock: Clock,
) -> None:
    while not progress.is_over:
        queried = {place: addresses[place] for place in addresses if place in progress.host_refs}
        progress.set_time(clock.monotonic())
        for place, host in host_states(await ask_all(transport, queried, SNAPSHOT)).items():
            progress.on_host(place, host)
        if live:
            live.update(_table(progress, names), refresh=True)
        else:
            _lines(progress, names)
        if not progress.is_over:
            await asyncio.sleep(INTERVAL)


def _lines(descent: SafeStateProgress, names: Mapping[HostRef, str]) -> None:
    for device in descent.changes():
        print(escape_line(f"{names[device.host_ref]}: {device.name}: {device.activity}"), flush=True)


def _table(descent: SafeStateProgress, names: Mapping[HostRef, str]) -> Table:
    table = new_table("HOST", "DEVICE", "NOW", "TELEMETRY", unbroken=("NOW",))
    for device in descent.devices:
        values = telemetry_text(device.telemetry or {})
        add_row(table, names[device.host_ref], device.name, device.activity, values)
    return table
