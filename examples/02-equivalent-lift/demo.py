"""Runs the mission four times on simulated devices, with one more failed robot each time.

    python examples/02-equivalent-lift/demo.py

Every host is a process. Once the hook is down, the faults of the run are set with `lfield sim
fault`, as on the command line; when `lfield query` says that the crane's host has noticed all of them, the
cart's computer is started, and so the parcel comes. Nothing is left to a fixed time. 0 means that in every
run the expected lift has lifted the parcel.
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
#: Its computer comes with the parcel.
CART = "cart"
#: Seconds for one step of the mission on a busy computer.
PATIENCE = 180.0

#: Log lines of hosts and devices; the rest is the foreman's.
OTHERS = re.compile(r"(\w+\.\w+: |\w+ listening |link to |waiting for |link from )")

#: The additional failure of each run: device, fault and description.
FAILURES = (
    ("", "", "everything works"),
    ("crane.axis", "silence=true", "the crane's drive has lost its power"),
    ("sky.fc", "battery=0.15", "the copter's battery is low as well"),
    ("hand.motor", "dead=true", "and the hand's servo is dead"),
)
#: Who must lift in each run, '' for none.
LIFTS = ("crane", "sky", "hand+arm", "")


class Failed(Exception):
    """The run failed: one sentence."""


@dataclass
class Host:
    """The process of one host, and the thread that reads its output."""

    process: subprocess.Popen[str]
    reader: threading.Thread


class Team:
    """The hosts of one run; all have ended when it is left."""

    def __init__(self, mission: Path) -> None:
        self._mission = mission
        self._maps = [f"--map={host}=127.0.0.1:{free_port()}" for host in (*HOSTS, CART)]
        # As on several computers, each host authenticates; in the field `lfield keys` creates the keys.
        keyring = Keyring(mission.parent / "keys")
        self._keys = "--keys", str(keyring.give(*HOSTS, CART))
        # Hosts with keys accept signed bundles only, as by `lfield sign`.
        keyring.sign(mission)
        self._hosts: dict[str, Host] = {}
        self._said, self._shown = threading.Condition(), sys.stdout
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
            self.ended()
        except Failed:
            for host in self._hosts.values():
                host.process.kill()

    def start(self, host: str) -> None:
        """Starts a host, with its simulated devices."""
        # No host waits for the cart's, which comes later, and nothing is stored beyond the run.
        options = ("--sim", "--volatile", "--first-start", "--until-done", "--lost-after", "900")
        arguments = ("up", str(self._mission), "--host", host, *options, *self._maps, *self._keys)
        command = [sys.executable, "-m", "lfield", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        reader = threading.Thread(target=self._read, args=(host, process), daemon=True)
        self._hosts[host] = Host(process, reader)
        reader.start()

    def ended(self) -> int:
        """Waits until all hosts have ended; returns the worst of their statuses. Raises Failed."""
        end = time.monotonic() + PATIENCE
        for name, host in self._hosts.items():
            try:
                host.process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                raise Failed(f"the host {name} has not ended")
            host.reader.join()
        return exit_status.most_severe(host.process.returncode for host in self._hosts.values())

    def wait_for(self, text: str) -> None:
        """Waits for a text of the foreman. Raises Failed."""
        end = time.monotonic() + PATIENCE
        with self._said:
            while not any(text in line for line in self.lines):
                if time.monotonic() > end or any(h.process.poll() is not None for h in self._hosts.values()):
                    raise Failed(f"the foreman has not printed: {text}")
                self._said.wait(0.2)

    def best(self) -> str | None:
        """Who would lift now, according to the crane's host: '' for none, None while unknown."""
        question = ("query", "Lift where payload >= 0.2", "--deploy", str(self._mission), "--at", "yard")
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            status = lfield([*question, "--json", *self._maps, *self._keys])
        if status not in (exit_status.DONE, exit_status.FAILED):
            return None
        answer = json.loads(said.getvalue())
        if "yard" not in answer["answered"]:
            return None
        offers = answer["capabilities"][0]["offers"]
        return str(offers[0]["agent"]) if offers else ""

    def _read(self, host: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout
        for line in process.stdout:
            if OTHERS.match(line):
                continue
            # Not to stdout, which may be redirected for an answer at that time.
            print(f"{host:5} | {line}", end="", file=self._shown, flush=True)
            with self._said:
                self.lines.append(line)
                self._said.notify_all()


def free_port() -> int:
    """A free port of loopback, outside the kernel's ephemeral range."""
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise Failed("a hundred ports between 20000 and 32000 are all taken")


def run(mission: Path, number: int) -> None:
    """One run. Raises Failed unless the expected lift was used."""
    expected = LIFTS[number]
    with Team(mission) as team:
        team.wait_for("the parcel is coming")
        fail(FAILURES[1 : number + 1])
        end = time.monotonic() + PATIENCE
        while (best := team.best()) != expected:
            if time.monotonic() > end:
                raise Failed(f"the hosts have not noticed the failures: {best or 'no agent'} would lift")
            time.sleep(0.2)
        team.start(CART)
        status = team.ended()
    # The safe state of a failed device cannot be confirmed, even if the mission succeeded.
    if status != (exit_status.UNSAFE if number else exit_status.DONE):
        raise Failed(f"the mission ended with {status}")
    if complaint := wrong(team.lines, expected):
        raise Failed(complaint)


def wrong(said: list[str], expected: str) -> str:
    """What is wrong with the lift according to the foreman, '' for nothing."""
    tried, lifted = "", []
    for line in said:
        if found := re.match(r"foreman: (\S+) shall lift", line):
            tried = found[1]
        elif line.startswith("foreman: the parcel went up"):
            lifted.append(tried)
    if lifted == ([expected] if expected else []):
        return ""
    return f"{' and '.join(lifted) or 'no agent'} has lifted the parcel, not {expected or 'no agent'}"


def fail(failures: tuple[tuple[str, str, str], ...]) -> None:
    """Sets the faults of the simulated devices."""
    for device, fault, description in failures:
        with open(os.devnull, "w") as null_device, contextlib.redirect_stdout(null_device):
            status = lfield(["sim", "fault", device, fault])
        if status:
            raise Failed(f"{device} did not accept {fault}")
        print(f"      | ({description})", flush=True)


def main() -> int:
    """Runs all four, until one fails."""
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
