"""What all figures share: rows of the table, statistics, child processes, and L programs in memory.

Machines are shared and noisy, so whatever is compared is measured in turns within one run, and a row shows
the ratio beside the number. Nothing here asserts a time.
"""

from __future__ import annotations

import ctypes
import os
import random
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from lfield.bytecode.program import Program
from lfield.clock import SystemClock
from lfield.testing.golden import Desk, team_for
from lfield.vm.contract import Limits
from lfield.vm.machine import Machine

#: The repository: children run in it, so that the commands in the table can be copied.
ROOT = Path(__file__).resolve().parents[2]

#: Seconds a child may take to say something before the figure is given up.
PATIENCE = 60.0

_PR_SET_PDEATHSIG = 1
_prctl = ctypes.CDLL(None).prctl


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table, its numbers already in words. `ratio` is explained by the figure's title."""

    case: str
    measured: str
    median: str
    p99: str = ""
    ratio: str = ""
    target: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One measurement: what it shows, its rows, and what a reader must know to judge them."""

    title: str
    rows: Sequence[Row]
    notes: Sequence[str] = field(default_factory=tuple)


class ChildError(Exception):
    """A child process that ended or stayed silent; says what it wrote to stderr."""


# --- statistics ---------------------------------------------------------------------------------------


def percentile(samples: Iterable[float], percent: float) -> float:
    """The smallest sample that so many percent of them do not exceed."""
    ordered = sorted(samples)
    return ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))]


def median(samples: Iterable[float]) -> float:
    """The 50th percentile."""
    return percentile(samples, 50)


def in_turns(contenders: Mapping[str, Callable[[], Iterable[float]]], rounds: int) -> dict[str, list[float]]:
    """Samples of every contender, measured one after the other in each round.

    The order is reversed in every other round, so that nobody is always first.
    """
    samples: dict[str, list[float]] = {name: [] for name in contenders}
    order = list(contenders)
    for _ in range(rounds):
        for name in order:
            samples[name].extend(contenders[name]())
        order.reverse()
    return samples


def timed(work: Callable[[], object]) -> float:
    """Seconds one call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


# --- numbers in words ---------------------------------------------------------------------------------


def microseconds(seconds: float) -> str:
    """A short time."""
    count = seconds * 1e6
    return f"{count:.3f} µs" if count < 1 else f"{count:.1f} µs" if count < 100 else f"{count:.0f} µs"


def milliseconds(seconds: float) -> str:
    """A longer time."""
    return f"{seconds * 1e3:.1f} ms"


def times(ratio: float) -> str:
    """A ratio."""
    return f"{ratio:.2g}x" if ratio < 0.1 else f"{ratio:.2f}x" if ratio < 10 else f"{ratio:.0f}x"


def size(count: int) -> str:
    """A number of bytes."""
    return f"{count} B" if count < 1024 else f"{count // 1024} KiB"


# --- child processes ----------------------------------------------------------------------------------


class Child:
    """A process that is read line by line. The kernel kills it when this process ends, however it ends."""

    def __init__(self, words: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        self.started = time.perf_counter()
        self._process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=ROOT,
            env=environment,
            preexec_fn=_die_with_parent,
        )
        self._words = words
        self._unread = b""

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def line(self, patience: float = PATIENCE) -> str:
        """The next line of its stdout. Raises ChildError when none comes."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        end = time.monotonic() + patience
        while b"\n" not in self._unread:
            ready, _, _ = select.select([descriptor], [], [], max(0.0, end - time.monotonic()))
            data = os.read(descriptor, 1 << 16) if ready else b""
            if not data:
                raise ChildError(self._obituary("ended" if ready else f"said nothing for {patience:g} s"))
            self._unread += data
        line, _, self._unread = self._unread.partition(b"\n")
        return line.decode()

    def lines(self) -> list[str]:
        """The lines of its stdout that are there already; does not wait."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        while select.select([descriptor], [], [], 0.0)[0]:
            data = os.read(descriptor, 1 << 16)
            if not data:
                break
            self._unread += data
        *lines, self._unread = self._unread.split(b"\n")
        return [line.decode() for line in lines]

    def pause(self) -> None:
        """Stop it where it stands, so that it costs nothing while others are measured."""
        os.kill(self.pid, signal.SIGSTOP)

    def go_on(self) -> None:
        """Let it run again."""
        os.kill(self.pid, signal.SIGCONT)

    def wait(self) -> None:
        """Return when it has ended well. Raises ChildError when it has not."""
        if self._process.wait(PATIENCE):
            raise ChildError(self._obituary("failed"))

    def end(self) -> None:
        """Kill it and wait for it."""
        self._process.kill()
        self._process.communicate()

    def _obituary(self, what: str) -> str:
        self._process.kill()
        _, told = self._process.communicate()
        return f"{' '.join(self._words)} {what}:\n{told.decode(errors='replace')}"


class Children:
    """Children that end with a `with` statement."""

    def __init__(self) -> None:
        self._children: list[Child] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for child in self._children:
            child.end()

    def start(self, *words: str, environment: Mapping[str, str] | None = None) -> Child:
        """Start a command, in this process' environment unless another is given."""
        child = Child(words, environment)
        self._children.append(child)
        return child


def _die_with_parent() -> None:
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def free_port() -> int:
    """A loopback port that nobody listens on now."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


# --- L programs in memory -----------------------------------------------------------------------------


def stage(program: Program, heap: int = 1 << 23) -> tuple[Machine, Desk]:
    """A machine on which one agent of every unit of the program is about to start; `heap` in bytes."""
    desk = Desk()
    team = team_for(program, [])
    machine = Machine(program, team, 0, desk, SystemClock(), random.Random(1))
    for member in team:
        machine.start(member, Limits(heap=heap), generation=1)
    return machine, desk


def play(machine: Machine, desk: Desk) -> list[str]:
    """Run a staged machine until nothing can happen any more; returns what its agents wrote and printed."""
    while (pause := machine.run()) is not None:
        time.sleep(pause)
    for agent in desk.endings:
        if agent.ended == "died":
            raise RuntimeError(agent.report)
    return desk.output
