"""The picture below the lines of `lfield up --all` in a terminal: who is where, redrawn twice a second."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping

from rich.live import Live

from lfield.cli.views.console import PlainConsole
from lfield.cli.views.seen_view import table
from lfield.clock import SystemClock
from lfield.mission.mission import Mission
from lfield.operator.ask import observer
from lfield.operator.sight.following.follower import Follower
from lfield.operator.sight.picture.roll import roll_of
from lfield.operator.sight.watched import Watched
from lfield.text.visible import unguarded

INTERVAL = 0.5
#: A host that has not answered after so many seconds is shown as missing, with the reason.
OVERDUE = 20.0


class LiveView:
    """Follows the hosts of a mission by their doors at `addresses`, until stopped. Needs a running loop."""

    def __init__(self, mission: Mission, addresses: Mapping[str, str]) -> None:
        self._addresses = addresses
        self._live = Live(
            console=PlainConsole(file=unguarded(sys.stderr), markup=False, emoji=False),
            auto_refresh=False,
            transient=True,
        )
        self._sight = Watched(roll_of(mission.name, mission.team, mission), SystemClock())
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin to draw. From now on, lines for this terminal go through `print`."""
        self._live.start()
        follower = Follower(
            observer(connect_timeout=INTERVAL),
            list(self._addresses),
            self._reach,
            self._sight,
            SystemClock(),
            telemetry=1.0 / INTERVAL,
        )
        self._tasks = [asyncio.create_task(follower.run()), asyncio.create_task(self._draw())]

    async def _reach(self, host: str) -> str:
        return self._addresses[host]

    async def _draw(self) -> None:
        loop = asyncio.get_running_loop()
        overdue = loop.time() + OVERDUE
        while True:
            self._live.update(table(self._sight.seen(), starting=loop.time() < overdue), refresh=True)
            await asyncio.sleep(INTERVAL)

    def print(self, line: str) -> None:
        """A line above the picture."""
        self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)

    async def stop(self) -> None:
        """Take the picture away."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._live.stop()
