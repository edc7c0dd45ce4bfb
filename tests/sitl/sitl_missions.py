"""Missions for a real autopilot, and the lfield processes that run them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from sitl_simulators import Simulator

ROOT = Path(__file__).parents[2]
#: The bindings of the examples to simulators.
REAL = ROOT / "sim-adapters" / "real"
#: Speed limit of every binding here in m/s; below the default speeds of the autopilots (10, 5 and 5).
SPEED = 3.0
#: Seconds from a cold start until a vehicle may be armed.
READY = 120.0
#: Lines of output of a failed command that are shown.
MAX_LAST_LINES = 40

#: All kinds of motion: goals and velocities.
TOUR = {
    "copter": """
include <mavlink/copter.L>;
coordinator Tour {
    init(string[] arg) {
        Copter it = findCopter(arg[1]);
        it.takeOff(8.0);
        it.goTo(25.0, 0.0, -8.0);
        it.move(0.0, 2.5, 0.0, 4.0);
        it.goTo(0.0, 0.0, -8.0);
        it.land();
        print("the tour is over");
    }
}
""",
    "rover": """
include <mavlink/rover.L>;
coordinator Tour {
    init(string[] arg) {
        Rover it = findRover(arg[1]);
        it.start();
        it.goTo(20.0, 0.0);
        it.move(0.0, 2.5, 4.0);
        it.goTo(0.0, 0.0);
        it.stop();
        print("the tour is over");
    }
}
""",
}
#: Only opens the vehicle and ends.
OPEN = """
resource Vehicle { Mavlink fc; init(string[] arg) { } }
coordinator Nothing { init(string[] arg) { } }
"""
#: A short flight: takeoff, one goal, landing.
HOP = """
include <mavlink/copter.L>;
coordinator Hop {
    init(string[] arg) {
        Copter it = findCopter(arg[1]);
        it.takeOff(4.0);
        it.goTo(6.0, 0.0, -4.0);
        it.land();
        print("the hop is over");
    }
}
"""
#: Motors on and off.
ARM = """
resource Motors {
    Mavlink fc;
    init(string[] arg) { fc.waitReady(90.0); fc.arm(); fc.disarm(); write("armed and disarmed\\n"); }
}
"""
#: Flies with velocity setpoints until the host is stopped.
AWAY = """
resource Copter {
    Mavlink fc;
    init(string[] arg) {
        fc.waitReady(90.0);
        fc.arm();
        fc.takeoff(6.0);
        write("on its way\\n");
        while (true) { fc.setVelocity(1.0, 0.0, 0.0); sleep(0.1); }
    }
}
"""


@dataclass(frozen=True)
class Mission:
    """A deployment file whose one vehicle is a simulator."""

    deploy: Path

    @classmethod
    def on(cls, simulator: Simulator, folder: Path, program: str, agents: str, endpoint: str = "") -> Mission:
        """Writes the mission; `agents` is the deployment; its first agent has the device `fc`."""
        folder.mkdir(parents=True, exist_ok=True)
        agent = agents.partition(":")[2].partition("@")[0]
        vehicle = simulator.kind.vehicle
        (folder / "mission.L").write_text(program)
        (folder / "mission.dL").write_text(agents)
        (folder / "mission.devices.yaml").write_text(
            f"silence: 1.0\nagents:\n  {agent}:\n    devices:\n      fc:\n"
            f"        driver: mavlink\n        endpoint: '{endpoint or simulator.endpoint}'\n"
            f"        system: {simulator.system}\n        kind: {vehicle}\n        safe_state: land\n"
            f"        limits: {{speed: {SPEED}}}\n        waivers: [device_watchdog]\n"
        )
        return cls(folder / "mission.dL")


class Command:
    """A running lfield command, with stdout and stderr in one file."""

    def __init__(self, folder: Path, *arguments: str | Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = folder / "output.txt"
        environment = {**os.environ, "LFIELD_RUNS": "here", "XDG_STATE_HOME": str(folder)}
        with self._file.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "lfield", *map(str, arguments)],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self.arguments = " ".join(map(str, arguments))

    @property
    def output(self) -> str:
        """The output of the command so far."""
        return self._file.read_text(errors="replace")

    @property
    def last_lines(self) -> str:
        """The command line, and the last lines of the output."""
        return f"$ lfield {self.arguments}\n" + "\n".join(self.output.splitlines()[-MAX_LAST_LINES:])

    def prints(self, text: str, bound: float) -> bool:
        """Whether the command prints `text` within `bound` seconds and before its end."""
        end = time.monotonic() + bound
        while text not in self.output and time.monotonic() < end and self.process.poll() is None:
            time.sleep(0.1)
        return text in self.output

    def wait_for(self, text: str, bound: float) -> None:
        """Waits until the command prints `text`. Fails after `bound` seconds or if the command ends."""
        assert self.prints(text, bound), f"no output '{text}' within {bound:g} s\n{self.last_lines}"

    def wait(self, bound: float) -> int:
        """Wait for the exit status of the command. Fails if it does not end within `bound` seconds."""
        try:
            return self.process.wait(bound)
        except subprocess.TimeoutExpired:
            self.end()
            raise AssertionError(f"the command did not end within {bound:g} s\n{self.last_lines}") from None

    def succeeds(self, bound: float) -> None:
        """Waits for the end of the command. Fails if its status is not 0."""
        status = self.wait(bound)
        assert status == 0, f"the command ended with status {status}\n{self.last_lines}"

    def end(self) -> None:
        """Stops the command, which makes its devices safe; kills it after a time-out."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(180.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    @property
    def guard(self) -> int:
        """The pid of the only guard of this host. Fails if there is none."""
        file = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        children = [int(word) for word in file.read_text().split()]
        assert len(children) == 1, f"there must be one guard, not {children}\n{self.last_lines}"
        return children[0]
