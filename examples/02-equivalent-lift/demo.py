"""Runs the mission four times on fakes: as it is, then with one more robot that has failed each time.

    python examples/02-equivalent-lift/demo.py

Every host is a process of its own. Once the hook is down, the faults of the run are set with `lfield sim
fault`, as one could by hand; when `lfield query` says that the crane's host has noticed all of them, the
cart's computer is started, and so the parcel comes. Nothing is left to a fixed time. 0 means that in every
run whoever should lift the parcel did.
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

from lfield import exits
from lfield.cli.main import main as lfield
from lfield.testing.keys import Keyring

MISSION = Path(__file__).with_name("mission.dL")
HOSTS = ("yard", "air", "bench", "tool")
#: Its computer comes with the parcel.
CART = "cart"
#: Seconds for one step of the mission on a computer that has a lot else to do.
PATIENCE = 180.0

#: What hosts and devices say of themselves; the rest is the foreman's.
OTHERS = re.compile(r"(\w+\.\w+: |\w+ is up|linked with|lost the link|waiting for |closed a link)")

#: What fails in each run besides what has failed before: the device, its fault, and how people would say it.
FAILURES = (
    ("", "", "everything works"),
    ("crane.axis", "silence=true", "the crane's drive has lost its power"),
    ("sky.fc", "battery=0.15", "the copter's battery is low as well"),
    ("hand.motor", "dead=true", "and the hand's servo is dead"),
)
#: Who shall lift in each run, '' for nobody.
LIFTS = ("crane", "sky", "hand+arm", "")


class Failed(Exception):
    """The run did not go as it should: one sentence."""


@dataclass
class Host:
    """The process of one host, and who reads what it says."""

    process: subprocess.Popen[str]
    reader: threading.Thread


class Team:
    """The hosts of one run; all have ended when it is left."""

    def __init__(self, mission: Path) -> None:
        self._mission = mission
        self._maps = [f"--map={host}=127.0.0.1:{free_port()}" for host in (*HOSTS, CART)]
        # As on several computers, each host proves who it is: `lfield keys` makes these in the field.
        keyring = Keyring(mission.parent / "keys")
        self._keys = "--keys", str(keyring.give(*HOSTS, CART))
        # They take no other bundle: `lfield sign` does this.
        keyring.sign(mission)
        self._hosts: dict[str, Host] = {}
        self._said, self._shown = threading.Condition(), sys.stdout
        #: What the foreman has said.
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
        """Start a host, with the fakes of its devices."""
        # Nobody waits for the cart's host, which is to come, and nothing is kept beyond the run.
        options = ("--sim", "--volatile", "--first-start", "--until-done", "--lost-after", "900")
        words = ("up", str(self._mission), "--host", host, *options, *self._maps, *self._keys)
        command = [sys.executable, "-m", "lfield", *words]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        reader = threading.Thread(target=self._read, args=(host, process), daemon=True)
        self._hosts[host] = Host(process, reader)
        reader.start()

    def ended(self) -> int:
        """Wait until all hosts have ended; returns the worst of their statuses. Raises Failed."""
        end = time.monotonic() + PATIENCE
        for name, host in self._hosts.items():
            try:
                host.process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                raise Failed(f"the host {name} has not ended")
            host.reader.join()
        return exits.worst(host.process.returncode for host in self._hosts.values())

    def wait_for(self, words: str) -> None:
        """Until the foreman has said this. Raises Failed."""
        end = time.monotonic() + PATIENCE
        with self._said:
            while not any(words in line for line in self.lines):
                if time.monotonic() > end or any(h.process.poll() is not None for h in self._hosts.values()):
                    raise Failed(f"the foreman has not said that {words}")
                self._said.wait(0.2)

    def best(self) -> str | None:
        """Who would lift, as the host of the crane sees it now: '' nobody, None while that is not known."""
        question = ("query", "Lift where payload >= 0.2", "--deploy", str(self._mission), "--at", "yard")
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            status = lfield([*question, "--json", *self._maps, *self._keys])
        if status not in (exits.DONE, exits.FAILED):
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
            # Not to wherever a question's answer goes just then.
            print(f"{host:5} | {line}", end="", file=self._shown, flush=True)
            with self._said:
                self.lines.append(line)
                self._said.notify_all()


def free_port() -> int:
    """A port of loopback that nobody has, and that the kernel gives to no connection's near end."""
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port
    raise Failed("a hundred ports between 20000 and 32000 are all taken")


def run(mission: Path, number: int) -> None:
    """One run. Raises Failed unless who should lift the parcel did."""
    wanted = LIFTS[number]
    with Team(mission) as team:
        team.wait_for("the parcel is coming")
        fail(FAILURES[1 : number + 1])
        end = time.monotonic() + PATIENCE
        while (best := team.best()) != wanted:
            if time.monotonic() > end:
                raise Failed(f"the hosts have not noticed what failed: {best or 'nobody'} would lift")
            time.sleep(0.2)
        team.start(CART)
        status = team.ended()
    # A device that has failed cannot be seen in its safe state, however well the mission went.
    if status != (exits.UNSAFE if number else exits.DONE):
        raise Failed(f"the mission ended with {status}")
    if complaint := wrong(team.lines, wanted):
        raise Failed(complaint)


def wrong(said: list[str], wanted: str) -> str:
    """What is wrong with who has lifted by what the foreman said, '' when nothing is."""
    tried, lifted = "", []
    for line in said:
        if found := re.match(r"foreman: (\S+) shall lift", line):
            tried = found[1]
        elif line.startswith("foreman: the parcel went up"):
            lifted.append(tried)
    if lifted == ([wanted] if wanted else []):
        return ""
    return f"{' and '.join(lifted) or 'nobody'} has lifted the parcel, not {wanted or 'nobody'}"


def fail(failures: tuple[tuple[str, str, str], ...]) -> None:
    """Set the faults of the fakes."""
    for device, fault, words in failures:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            status = lfield(["sim", "fault", device, fault])
        if status:
            raise Failed(f"{device} has not taken {fault}")
        print(f"      | ({words})", flush=True)


def main() -> int:
    """All four runs, until one does not end as it should."""
    with tempfile.TemporaryDirectory() as folder:
        mission = Path(folder) / "mission.lfm"
        subprocess.run(
            [sys.executable, "-m", "lfield", "build", str(MISSION), "--output", str(mission)],
            check=True,
            capture_output=True,
        )
        for number, (_, _, words) in enumerate(FAILURES):
            print(f"\nRun {number + 1}: {words}", flush=True)
            try:
                run(mission, number)
            except Failed as failed:
                print(f"run {number + 1}: {failed}", file=sys.stderr)
                return exits.FAILED
    return exits.DONE


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(exits.INTERRUPTED)
