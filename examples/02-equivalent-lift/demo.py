"""Runs the mission four times on simulated devices, with one more failed device in each run.

    python examples/02-equivalent-lift/demo.py

Each host is a process. When the hook is down, the script sets the faults of the run with `lfield sim fault`.
When `lfield query` shows that the crane's host has detected all faults, the script starts the cart's host,
and the parcel arrives. No step depends on a fixed delay. The exit status is 0 if the expected robot lifted
the parcel in every run.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from lfield import exit_status
from lfield.cli.main import main as lfield
from lfield.testing.keyring import Keyring

MISSION = Path(__file__).with_name("mission.dL")
HOSTS = ("yard", "air", "bench", "tool")
#: The host that arrives with the parcel.
CART = "cart"
#: Seconds: maximum duration of one step of the mission on a busy computer.
STEP_TIMEOUT = 180.0

#: Log lines of hosts and devices. The other lines are the foreman's.
HOST_LINE = re.compile(r"(\w+\.\w+: |\w+ listening |link to |waiting for |link from )")

#: The additional failure of each run: device, fault and description.
FAILURES = (
    ("", "", "everything works"),
    ("crane.axis", "silence=true", "the crane's drive has lost its power"),
    ("sky.fc", "battery=0.15", "the copter's battery is low as well"),
    ("hand.motor", "dead=true", "and the hand's servo is dead"),
)
#: The agent that must lift in each run, '' for none.
EXPECTED_AGENTS = ("crane", "sky", "hand+arm", "")


class Failed(Exception):
    """The run failed: one sentence."""


@dataclass
class Host:
    """The process of one host, and the thread that reads its output."""

    process: subprocess.Popen[str]
    reader: threading.Thread


class Team:
    """The hosts of one run. A context manager that ends all hosts on exit."""

    def __init__(self, mission: Path) -> None:
        self._mission = mission
        self._maps = [f"--map={host}=127.0.0.1:{free_port()}" for host in (*HOSTS, CART)]
        # The hosts authenticate each other, as in the field, where `lfield keys` creates the keys.
        keyring = Keyring(mission.parent / "keys")
        self._keys = "--keys", str(keyring.give(*HOSTS, CART))
        # Hosts with keys accept only signed bundles. In the field, `lfield sign` signs them.
        keyring.sign(mission)
        self._hosts: dict[str, Host] = {}
        self._line_added = threading.Condition()
        # `best_agent` redirects sys.stdout.
        self._stdout = sys.stdout
        #: The foreman's output.
        self.lines: list[str] = []

    def __enter__(self) -> Team:
        for host in HOSTS:
            self.start(host)
        return self

    def __exit__(self, *_: object) -> None:
        for host in self._hosts.values():
            host.process.terminate()
        try:
            self.wait_until_ended()
        except Failed:
            for host in self._hosts.values():
                host.process.kill()

    def start(self, host: str) -> None:
        """Starts a host and its simulated devices, without storage beyond the run."""
        options = ("--sim", "--volatile", "--first-start", "--until-done", "--lost-after", "900")
        arguments = ("up", str(self._mission), "--host", host, *options, *self._maps, *self._keys)
        command = [sys.executable, "-m", "lfield", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        reader = threading.Thread(target=self._read, args=(host, process), daemon=True)
        self._hosts[host] = Host(process, reader)
        reader.start()

    def wait_until_ended(self) -> int:
        """Waits until all hosts have ended; returns their most severe exit status. Raises Failed."""
        end = time.monotonic() + STEP_TIMEOUT
        for name, host in self._hosts.items():
            try:
                host.process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                raise Failed(f"the host {name} has not ended")
            host.reader.join()
        return exit_status.most_severe(host.process.returncode for host in self._hosts.values())

    def wait_for(self, text: str) -> None:
        """Waits for a line of the foreman that contains a text. Raises Failed."""
        end = time.monotonic() + STEP_TIMEOUT
        with self._line_added:
            while not any(text in line for line in self.lines):
                if time.monotonic() > end or any(h.process.poll() is not None for h in self._hosts.values()):
                    raise Failed(f"the foreman has not printed: {text}")
                self._line_added.wait(0.2)

    def best_agent(self) -> str | None:
        """The best agent for a lift, according to the crane's host: '' for none, None while unknown."""
        query = ("query", "Lift where payload >= 0.2", "--deploy", str(self._mission), "--at", "yard")
        output = io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
            status = lfield([*query, "--json", *self._maps, *self._keys])
        if status not in (exit_status.DONE, exit_status.FAILED):
            return None
        answer = json.loads(output.getvalue())
        if "yard" not in answer["answered"]:
            return None
        offers = answer["capabilities"][0]["offers"]
        return str(offers[0]["agent"]) if offers else ""

    def _read(self, host: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout
        for line in process.stdout:
            if HOST_LINE.match(line):
                continue
            print(f"{host:5} | {line}", end="", file=self._stdout, flush=True)
            with self._line_added:
                self.lines.append(line)
                self._line_added.notify_all()


def free_port() -> int:
    """A free port of loopback, outside the kernel's ephemeral range."""
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise Failed("no free port found between 20000 and 32000")


def run(mission: Path, number: int) -> None:
    """Runs the mission once. Raises Failed unless the expected agent lifted the parcel."""
    expected = EXPECTED_AGENTS[number]
    with Team(mission) as team:
        team.wait_for("the parcel is coming")
        set_faults(FAILURES[1 : number + 1])
        end = time.monotonic() + STEP_TIMEOUT
        while (best := team.best_agent()) != expected:
            if time.monotonic() > end:
                raise Failed(f"the hosts have not detected the failures: the best agent is {best or 'none'}")
            time.sleep(0.2)
        team.start(CART)
        status = team.wait_until_ended()
    # The safe state of a failed device cannot be confirmed, even if the mission succeeded.
    if status != (exit_status.UNSAFE if number else exit_status.DONE):
        raise Failed(f"the mission ended with exit status {status}")
    if error := lift_error(team.lines, expected):
        raise Failed(error)


def lift_error(lines: list[str], expected: str) -> str:
    """The error in the foreman's output if another agent than expected lifted, otherwise ''."""
    agent, lifted = "", []
    for line in lines:
        if found := re.match(r"foreman: (\S+) shall lift", line):
            agent = found[1]
        elif line.startswith("foreman: the parcel went up"):
            lifted.append(agent)
    if lifted == ([expected] if expected else []):
        return ""
    return f"{' and '.join(lifted) or 'no agent'} has lifted the parcel, not {expected or 'no agent'}"


def set_faults(failures: tuple[tuple[str, str, str], ...]) -> None:
    """Sets faults of simulated devices. Raises Failed."""
    for device, fault, description in failures:
        with open(os.devnull, "w") as null_device, contextlib.redirect_stdout(null_device):
            status = lfield(["sim", "fault", device, fault])
        if status:
            raise Failed(f"{device} did not accept {fault}")
        print(f"      | ({description})", flush=True)


def main() -> int:
    """Runs the mission four times, until a run fails."""
    with tempfile.TemporaryDirectory() as folder:
        mission = Path(folder) / "mission.lfm"
        subprocess.run(
            [sys.executable, "-m", "lfield", "build", str(MISSION), "--output", str(mission)],
            check=True,
            capture_output=True,
        )
        for number, (_, _, description) in enumerate(FAILURES):
            print(f"\nRun {number + 1}: {description}", flush=True)
            try:
                run(mission, number)
            except Failed as failed:
                print(f"run {number + 1}: {failed}", file=sys.stderr)
                return exit_status.FAILED
    return exit_status.DONE


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(exit_status.INTERRUPTED)
