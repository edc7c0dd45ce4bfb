"""The way down of devices after an emergency stop: a table that is redrawn in a terminal, else lines."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext

from rich.live import Live
from rich.table import Table

from lfield.cli.views.trees import plain_console
from lfield.clock import Clock, SystemClock
from lfield.net.transport import Transport
from lfield.operator.addressed import Place
from lfield.operator.ask import STATUS, ask_all
from lfield.operator.descent import Descent
from lfield.text.values import telemetry_in_words
from lfield.text.visible import in_one_line

#: Seconds between two looks.
INTERVAL = 0.5


def watch(
    descent: Descent, transport: Transport, addresses: Mapping[Place, str], names: Mapping[Place, str]
) -> None:
    """Look until the descent is over, and show it. Ctrl-C raises KeyboardInterrupt, as everywhere."""
    live = Live(console=plain_console(), auto_refresh=False) if sys.stdout.isatty() else None
    shown: AbstractContextManager[object] = live or nullcontext()
    with shown:
        asyncio.run(_look(descent, transport, addresses, names, live, SystemClock()))


async def _look(
    descent: Descent,
    transport: Transport,
    addresses: Mapping[Place, str],
    names: Mapping[Place, str],
    live: Live | None,
    clock: Clock,
) -> None:
    while not descent.over:
        asked = {place: addresses[place] for place in addresses if place in descent.places}
        descent.at(clock.monotonic())
        for place, answer in (await ask_all(transport, asked, STATUS)).items():
            descent.told(place, answer)
        if live:
            live.update(_table(descent, names), refresh=True)
        else:
            _lines(descent, names)
        if not descent.over:
            await asyncio.sleep(INTERVAL)


def _lines(descent: Descent, names: Mapping[Place, str]) -> None:
    for device in descent.news():
        print(in_one_line(f"{names[device.place]}: {device.name}: {device.words}"), flush=True)


def _table(descent: Descent, names: Mapping[Place, str]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("HOST", "DEVICE", "NOW", "TELEMETRY"):
        table.add_column(column, no_wrap=column == "NOW")
    for device in descent.devices:
        values = telemetry_in_words(device.telemetry or {})
        table.add_row(*map(in_one_line, (names[device.place], device.name, device.words, values)))
    return table
