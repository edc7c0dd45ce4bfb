"""Hosts as processes: started, killed, stopped, and restarted; all their output lines are kept."""

from __future__ import annotations

import asyncio
import signal
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import Callable, Sequence
from pathlib import Path

#: Seconds after which a host that ended by itself is restarted, as by systemd.
RESTART_DELAY = 1.0
#: Seconds for a host to end after SIGTERM.
END_TIMEOUT = 15.0
#: The line of a host when a coordinator of its journal is recovered.
GOES_ON = ("resumed from the journal", " restarted: ")


class HostProcess:
    """One host of the team, with all its restarts. `command` starts it; `on_line` receives its output."""

    def __init__(self, name: str, command: Sequence[str], log: Path, on_line: Callable[[str], None]) -> None:
        self.name, self._command, self._on_line = name, command, on_line
        self._log = log.open("a", encoding="utf-8")
        self._process: Process | None = None
        self._started_at = 0.0
        self._should_run = False
        self._life: asyncio.Task[None] | None = None
        #: Exit statuses of processes that ended without a signal of the test.
        self.gave_up: list[int] = []
        #: Seconds from the start of a process until a coordinator of its journal ran again.
        self.recoveries: list[float] = []

    @property
    def runs(self) -> bool:
        """True while the process runs."""
        return self._process is not None and self._process.returncode is None

    def start(self) -> None:
        """Run the host, with restarts, until it is killed."""
        if not self._should_run:
            self._should_run = True
            self._life = asyncio.ensure_future(self._live())

    async def kill(self) -> None:
        """Send SIGKILL: the host ends without output or cleanup."""
        self._should_run = False
        self._send(signal.SIGKILL)
        await self._gone()

    def stop(self) -> None:
        """Send SIGSTOP."""
        self._send(signal.SIGSTOP)

    def resume(self) -> None:
        """Send SIGCONT."""
        self._send(signal.SIGCONT)

    async def end(self) -> bool:
        """Send SIGTERM; returns true if the host ends in time with status 0."""
        self._should_run = False
        self._send(signal.SIGTERM)
        try:
            await asyncio.wait_for(self._gone(), END_TIMEOUT)
        except TimeoutError:
            await self.kill()
        self._log.close()
        return self._process is not None and self._process.returncode == 0

    def _send(self, number: signal.Signals) -> None:
        if self._process is not None and self.runs:
            self._note(f"--- {number.name}")
            self._process.send_signal(number)

    async def _gone(self) -> None:
        if self._life is not None:
            await asyncio.shield(self._life)

    async def _live(self) -> None:
        while self._should_run:
            self._note("--- started")
            self._started_at = time.monotonic()
            arguments = (sys.executable, "-m", "lfield", *self._command)
            process = await asyncio.create_subprocess_exec(
                *arguments, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT
            )
            self._process = process
            if not self._should_run:
                process.kill()
            assert process.stdout is not None
            async for line in process.stdout:
                self._line(line.decode(errors="replace").rstrip("\n"))
            status = await process.wait()
            self._note(f"--- ended with {status}")
            if self._should_run:
                self.gave_up.append(status)
                await asyncio.sleep(RESTART_DELAY)

    def _line(self, line: str) -> None:
        self._note(line)
        if any(words in line for words in GOES_ON):
            self.recoveries.append(time.monotonic() - self._started_at)
        self._on_line(line)

    def _note(self, line: str) -> None:
        self._log.write(f"{time.time():.3f} {line}\n")
        self._log.flush()
