"""Runs two missions at the same time, and kills hosts with SIGKILL in the middle of a call.

    python examples/04-the-mission-survives/run.py

In the mission `self`, a killed host is restarted after 1 s, as by systemd, and resumes from its journal; this
occurs twice. In the mission `quorum`, a killed host is not restarted, and another host continues the
coordinator. Each simulated device is a separate process. So it continues when its host is killed, as a real
vehicle does.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from team import Failed, Team

from lfield import exit_status

HERE = Path(__file__).parent
SERVOS = "dynamixel --servo 1:XM540-W270 --servo 2:XM540-W270"
#: The simulated device at each endpoint of the devices files.
MISSION = {
    "udp:127.0.0.1:14550": "mavlink --listen udp:127.0.0.1:0 --set-up land --land 2 --param WPNAV_SPEED=500",
    "udp:127.0.0.1:14560": "mavlink --listen udp:127.0.0.1:0 --kind rover --system 2 --set-up hold",
    "socketcan:can0": "can --listen socketcand:127.0.0.1:0 --device cia402:5,counts=10000",
    "serial:/dev/ttyUSB0:57600": SERVOS,
}
TABLE = {"serial:/dev/ttyUSB0:57600": SERVOS, "serial:/dev/ttyUSB1:57600": SERVOS}
#: Each kill: the output of the coordinator to wait for, the delay in seconds, the host, the current action.
KILLS = (
    ("the scout is at (4, 2)", 0.8, "sky", "the copter flies back, and the coordinator is with it"),
    ("the truck is there", 1.5, "ground", "the hook goes down; this is also the coordinator's home"),
)
#: Seconds from the kill of a host until its restart: the time of real processes, so the script sleeps.
RESTART_DELAY = 1.0


class Report:
    """The events of one mission, with times."""

    def __init__(self, team: Team) -> None:
        self._team, self._started_at = team, time.monotonic()
        self._events: list[tuple[float, str, str]] = []

    def add(self, at: float, event: str, text: str) -> None:
        """Adds an event."""
        self._events.append((at, event, text))

    def after(self, at: float) -> str:
        """A time since the start of the mission, as text."""
        return f"after {at - self._started_at:.1f} s"

    @property
    def lines(self) -> list[str]:
        """All events, and the exceptions that the program has printed, in order."""
        exceptions = [
            (line.at, "caught", line.text.split(": ", 2)[2])
            for line in self._team.lines
            if ": caught at" in line.text
        ]
        return [f"{event:8} {text}" for _, event, text in sorted([*self._events, *exceptions])]


def kill_and_restart_hosts(team: Team, report: Report) -> None:
    """Kills hosts, and restarts each one. The coordinator resumes from the journal."""
    reached = 0.0
    for text, seconds, host, action in KILLS:
        reached = team.wait_for(text, reached).at
        time.sleep(seconds)
        killed = team.kill(host, action)
        report.add(killed, "killed", f"{host} {report.after(killed)}: {action}")
        time.sleep(RESTART_DELAY)
        restarted = time.monotonic()
        team.start(host)
        resumed = team.wait_for("survivor resumed from the journal", restarted).at
        report.add(resumed, "back", f"{resumed - restarted:.1f} s after the start of its new process")
    done = team.wait_for("survivor: complete").at
    report.add(done, "complete", report.after(done))


def kill_one_host_permanently(team: Team, report: Report) -> None:
    """Kills the coordinator's host, and does not restart it. The coordinator continues on another host."""
    host = team.wait_for("part 8 is in the box").host
    time.sleep(0.5)
    killed = team.kill(host, "its arm takes part 9, and the coordinator is with it")
    report.add(killed, "killed", f"{host} {report.after(killed)}, permanently: its arm takes part 9")
    lost = "; ".join(output_since_arrival(team, host))
    recovery = team.wait_for("was recovered on", killed)
    report.add(recovery.at, "back", f"on {recovery.host}, {recovery.at - killed:.1f} s after the kill")
    report.add(recovery.at, "lost", f"the hop to {host}, and what came after it: {lost}")
    done = team.wait_for("clearer: complete", killed).at
    report.add(done, "complete", f"{report.after(done)}, without {host}")


def output_since_arrival(team: Team, host: str) -> list[str]:
    """The coordinator's output on a host since its last arrival there."""
    parts = [line for line in team.lines if line.text.startswith("clearer: part")]
    last_on_other = max((number for number, line in enumerate(parts) if line.host != host), default=-1)
    return [line.text.removeprefix("clearer: ") for line in parts[last_on_other + 1 :]]


def run(team: Team, fakes: Mapping[str, str], scenario: Callable[[Team, Report], None]) -> list[str]:
    """Runs one mission; returns the lines of its report. Raises Failed."""
    report = Report(team)
    try:
        team.launch(fakes)
        scenario(team, report)
    finally:
        team.end()
    return report.lines


def main() -> int:
    """Runs both missions and prints their reports; returns the exit status."""
    with tempfile.TemporaryDirectory(prefix="lfield-survives-") as folder, ThreadPoolExecutor() as pool:
        mission = Team("self", HERE / "mission.dL", ("sky", "ground", "bench"), Path(folder))
        table = Team("quorum", HERE / "table.dL", ("port", "starboard", "tower"), Path(folder))
        first = pool.submit(run, mission, MISSION, kill_and_restart_hosts)
        try:
            # The starts of both missions need much processor time, so the second one starts later.
            mission.wait_for("sky listening ")
            second = pool.submit(run, table, TABLE, kill_one_host_permanently)
            print("", "self: hosts that are started again", *first.result(), sep="\n")
            print("", "quorum: a host that never comes back", *second.result(), sep="\n")
        except Failed as failed:
            print(f"the mission failed: {failed}", file=sys.stderr)
            return exit_status.FAILED
    return exit_status.DONE


if __name__ == "__main__":
    sys.exit(main())
