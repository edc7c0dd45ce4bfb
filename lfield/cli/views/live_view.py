"""The table below the log lines of `lfield up --all` in a terminal, redrawn twice a second."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import termios
from collections.abc import Mapping
from contextlib import suppress
from typing import TextIO

from rich.live import Live

from lfield.cli.views.console import PlainConsole
from lfield.cli.views.team_state_view import table
from lfield.client.team_watch import TeamWatch
from lfield.clock import SystemClock
from lfield.mission.mission import Mission
from lfield.operator.client import observer_transport
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.operator.team_model.team_contents import team_contents
from lfield.text.terminal_escape import unescaped_stream

INTERVAL = 0.5
#: A host that has not answered within this time (s) is shown as missing, with the reason.
OVERDUE = 20.0


class LiveView:
    """Table of agents and devices, from the events of the hosts at the control sockets `addresses`."""

    def __init__(self, mission: Mission, addresses: Mapping[str, str]) -> None:
        self._addresses = addresses
        self._live = Live(
            console=PlainConsole(file=unescaped_stream(sys.stderr), markup=False, emoji=False),
            auto_refresh=False,
            transient=True,
        )
        self._state = TeamWatch(team_contents(mission.name, mission.team, mission), SystemClock())
        self._tasks: list[asyncio.Task[None]] = []
        self._echo = _TerminalEcho(sys.stderr)

    def start(self) -> None:
        """Start to draw, in the running loop. Lines for this terminal then go through `print`."""
        self._echo.disable()
        self._live.start()
        follower = EventFollower(
            observer_transport(connect_timeout=INTERVAL),
            list(self._addresses),
            self._locate,
            self._state,
            SystemClock(),
            FollowOptions(telemetry=1.0 / INTERVAL),
        )
        self._tasks = [asyncio.create_task(follower.run()), asyncio.create_task(self._draw())]

    async def _locate(self, host: str) -> str:
        return self._addresses[host]

    async def _draw(self) -> None:
        loop = asyncio.get_running_loop()
        overdue = loop.time() + OVERDUE
        while True:
            self._live.update(table(self._state.snapshot(), starting=loop.time() < overdue), refresh=True)
            await asyncio.sleep(INTERVAL)

    def print(self, line: str) -> None:
        """Print a line above the table."""
        self._live.console.print(line, markup=False, highlight=False, soft_wrap=True)

    async def stop(self) -> None:
        """Erase the table."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        # Rich draws the last picture in full, and cannot erase more lines than the terminal has.
        self._live.update("", refresh=True)
        self._live.stop()
        self._echo.restore()


class _TerminalEcho:
    """The echo of keys on a terminal: `^C` and Enter would move the cursor, and a line of the table stay."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._is_disabled = False

    def disable(self) -> None:
        """Disable the echo, unless this process is in the background: the kernel would stop it."""
        # The process has no controlling terminal, or it cannot be set.
        with suppress(OSError, termios.error):
            if os.tcgetpgrp(self._stream.fileno()) == os.getpgrp():
                self._is_disabled = self._set(is_on=False)

    def restore(self) -> None:
        """Enable the echo again."""
        if self._is_disabled:
            # The process may have been moved to the background.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU})
            try:
                with suppress(OSError, termios.error):
                    self._set(is_on=True)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _set(self, *, is_on: bool) -> bool:
        """Set the echo; returns whether it was different before."""
        settings = termios.tcgetattr(self._stream.fileno())
        flags = settings[3] | termios.ECHO if is_on else settings[3] & ~termios.ECHO
        has_changed = flags != settings[3]
        settings[3] = flags
        termios.tcsetattr(self._stream.fileno(), termios.TCSANOW, settings)
        return bool(has_changed)
