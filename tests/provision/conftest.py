"""A bench of robots for the tests, and a desk with wheels for them."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from robot_bench.desk import Desk, make_wheels
from robot_bench.robots import BenchRobot, RobotBench


@dataclass(frozen=True)
class Outcome:
    """The result of `lfield provision --json`: exit status, and the reports of all steps."""

    status: int
    reports: list[dict[str, object]]
    stderr: str

    def states(self, host: str) -> dict[str, str]:
        """The last state of each step of a host."""
        return {str(each["step"]): str(each["state"]) for each in self.reports if each["host"] == host}

    def last(self, host: str) -> dict[str, object]:
        """The last report of a host."""
        return [each for each in self.reports if each["host"] == host][-1]


class Trial:
    """A desk on a bench."""

    def __init__(self, bench: RobotBench, desk: Desk) -> None:
        self.bench, self.desk = bench, desk

    def write_inventory(self, *robots: BenchRobot, extra: str = "") -> None:
        """The inventory of these robots."""
        self.desk.write_inventory({robot.name: robot.address for robot in robots}, extra)

    def provision(self, *arguments: object) -> Outcome:
        """Runs `lfield provision` to its end."""
        command = self.desk.provision("--json", *arguments)
        done = self.bench.run(command, self.desk.environment)
        reports = [json.loads(line) for line in done.stdout.splitlines()]
        return Outcome(done.returncode, reports, done.stderr)

    def kill_at(self, step: str) -> None:
        """Runs `lfield provision`, and sends SIGKILL when the command reports a step as running."""
        self.provision_until(step, lambda process: process.kill())

    def provision_until(
        self, step: str, action: Callable[[subprocess.Popen[str]], object], *, signum: int = -signal.SIGKILL
    ) -> dict[str, object]:
        """Runs `lfield provision`, calls `action` when a step is running; returns the last report."""
        command = self.bench.command(self.desk.provision("--json"))
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, env=self.desk.environment
        ) as process:
            assert process.stdout is not None
            reached, report = False, {}
            for line in process.stdout:
                report = json.loads(line)
                if not reached and report["step"] == step and report["state"] == "running":
                    reached = True
                    action(process)
        assert reached, f"{step} was not reached"
        assert process.returncode == signum
        return report


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheels for all tests."""
    folder = tmp_path_factory.mktemp("wheels")
    make_wheels(folder)
    return folder


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[Trial]:
    """A desk with keys and wheels, and a bench without robots."""
    folder = tmp_path_factory.mktemp("bench")
    desk = Desk(folder / "home")
    desk.home.mkdir()
    desk.make_keys()
    desk.collect_wheels(wheels)
    with RobotBench(folder) as bench:
        yield Trial(bench, desk)
