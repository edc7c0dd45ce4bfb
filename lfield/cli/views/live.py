"""The picture below the lines of `lfield up --all` in a terminal: who is where, redrawn twice a second."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from rich.console import Console
from rich.live import Live

from lfield.cli.views.picture import picture
from lfield.operator.ask import STATUS, ask_all, observer

INTERVAL = 0.5


class LiveView:
    """Asks all hosts for their status and shows it until stopped. Needs a running loop."""

    def __init__(self, addresses: Mapping[str, str]) -> None:
        self._addresses = addresses
        self._live = Live(
            console=Console(stderr=True, markup=False, emoji=False), auto_refresh=False, transient=True
        )
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to draw. From now on, lines for this terminal go through `print`."""
        self._live.start()
        self._task = asyncio.create_task(self._draw())

    async def _draw(self) -> None:
        transport = observer(connect_timeout=INTERVAL)
        while True:
            answers = await ask_all(transport, self._addresses, STATUS)
            self._live.update(picture(answers), refresh=True)
            await asyncio.sleep(INTERVAL)

    def print(self, line: str) -> None:
        """A line above the picture."""
        self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)

    async def stop(self) -> None:
        """Take the picture away."""
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._live.stop()
