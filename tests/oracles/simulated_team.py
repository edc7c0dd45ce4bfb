"""A simulated team, and real operator commands for it, in virtual time.

The commands run in this process. The event loop of a process on a simulated computer replaces their event
loop, and runs the whole team.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command_lines import recorded

from lfield.clock import SystemClock
from lfield.event_loop import spawn
from lfield.mission.loader import load_mission
from lfield.net.tcp_transport import TcpTransport
from lfield.operator import client
from lfield.simulate.host_fleet import PORT, Fleet, copies, host_at_address

DEPLOYMENT = Path(__file__).parent / "team" / "patrol.dL"
#: Seconds of virtual time between two checks for the end of a command.
STEP = 0.05
#: The limit of a command in seconds of virtual time.
TIMEOUT = 200.0
#: The most characters of one output, enough for the status of three hosts as JSON.
KEPT = 40_000


class SimulatedTeam:
    """The team of `team/patrol.dL`, and a computer for the commands."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.fleet = Fleet(load_mission(DEPLOYMENT, simulate=True), seed=1)
        self._folder = folder
        self._process = self.fleet.add_station("desk", random.Random(2))
        clock = self._process.loop.machine.clock
        patch.setattr(SystemClock, "monotonic", lambda self: clock.monotonic())
        patch.setattr(SystemClock, "time", lambda self: clock.time())
        patch.setattr(client, "TcpTransport", partial(TcpTransport, identify=host_at_address))
        patch.setattr(asyncio, "run", self._run)
        patch.setattr(asyncio, "Runner", partial(_Runner, self._run))

    def __call__(self, line: str) -> str:
        """Run a command line for this mission, and return it with its output."""
        maps = " ".join(f"--map {host}={host}:{PORT}" for host in self.fleet.mission.team.hosts)
        mission = f" --deploy {DEPLOYMENT} {maps}"
        return recorded(line + mission, self._folder, most=KEPT).replace(mission, "")

    def wait_for(self, agent: str, host: str) -> None:
        """Advance time until a coordinator is on a host."""
        while all(start[0] != agent or host not in hosts for start, hosts in copies(self.fleet).items()):
            self.fleet.run(STEP)

    def _run(self, work: Coroutine[Any, Any, Any], **_: object) -> Any:
        """Replace `asyncio.run`. Raises the exceptions of the coroutine."""
        results: list[Callable[[], Any]] = []

        async def kept() -> None:
            try:
                result = await work
                results.append(lambda: result)
            except Exception as error:
                failure = error
                results.append(partial(_raise, failure))

        self._process.loop.enter(lambda: spawn(kept()))
        end = self.fleet.now + TIMEOUT
        while not results:
            assert self.fleet.now < end, "the command does not end"
            self.fleet.run(STEP)
        return results[0]()


class _Runner:
    """Replaces `asyncio.Runner`, with the only method that commands use."""

    def __init__(self, run: Callable[..., Any]) -> None:
        self.run = run

    def __enter__(self) -> _Runner:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def _raise(error: Exception) -> None:
    raise error
