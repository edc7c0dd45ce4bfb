"""Two missions on simulated devices whose computers are killed with SIGKILL in the middle of a call, side by
side.

    python examples/04-the-mission-survives/run.py

Under `self` a host is started again, as systemd does, and goes on; twice. Under `quorum` one never comes
back, and another host continues without it. Each simulated device is a separate process, so it outlives the
computer that drives it, as a real vehicle does. Each host has a journal.
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
#: What the coordinator prints before its host is killed, the delay in seconds, the host, and the present
#: action.
KILLS = (
    ("the scout is at (4, 2)", 0.8, "sky", "the copter flies back, and the coordinator is with it"),
    ("the truck is there", 1.5, "ground", "the hook goes down; this is also the coordinator's home"),
)
#: Seconds after which systemd restarts a host.
AGAIN = 1.0


class Report:
    """The report about one mission: what happened, with times."""

    def __init__(self, team: Team) -> None:
        self._team, self._started_at = team, time.monotonic()
        self._rows: list[tuple[float, str, str]] = []

    def row(self, at: float, what: str, text: str) -> None:
        """Adds an event."""
        self._rows.append((at, what, text))

    def after(self, at: float) -> str:
        """A time, in words."""
        return f"after {at - self._started_at:.1f} s"

    @property
    def lines(self) -> list[str]:
        """All events, and all exceptions of the program, in order."""
        reported = [
            (x.at, "told", x.text.split(": ", 2)[2]) for x in self._team.lines if ": told at" in x.text
        ]
        return [f"{what:8} {text}" for _, what, text in sorted([*self._rows, *reported])]


def started_again(team: Team, report: Report) -> None:
    """Each killed host is restarted, and resumes from its journal."""
    said = 0.0
    for text, seconds, host, what in KILLS:
        said = team.wait_for(text, said).at
        time.sleep(seconds)
        killed = team.kill(host, what)
        report.row(killed, "killed", f"{host} {report.after(killed)}: {what}")
        time.sleep(AGAIN)
        again = time.monotonic()
        team.start(host)
        back = team.wait_for("survivor resumed from the journal", again).at
        report.row(back, "back", f"{back - again:.1f} s after the start of its new process")
    done = team.wait_for("survivor: complete").at
    report.row(done, "complete", report.after(done))


def gone_for_good(team: Team, report: Report) -> None:
    """The host that has the coordinator is killed, and stays away."""
    here = team.wait_for("part 8 is in the box").host
    time.sleep(0.5)
    killed = team.kill(here, "its arm takes part 9, and the coordinator is with it")
    report.row(killed, "killed", f"{here} {report.after(killed)}, permanently: its arm takes part 9")
    behind = "; ".join(output_since_arrival(team, here))
    gone_on = team.wait_for("was recovered on", killed)
    report.row(gone_on.at, "back", f"on {gone_on.host}, {gone_on.at - killed:.1f} s after the kill")
    report.row(gone_on.at, "lost", f"the hop to {here}, and what came after it: {behind}")
    done = team.wait_for("clearer: complete", killed).at
    report.row(done, "complete", f"{report.after(done)}, without {here}")


def output_since_arrival(team: Team, here: str) -> list[str]:
    """The coordinator's output on a host since its arrival, which its newest shadow lacks."""
    said = [x for x in team.lines if x.text.startswith("clearer: part")]
    elsewhere = max((number for number, x in enumerate(said) if x.host != here), default=-1)
    return [x.text.removeprefix("clearer: ") for x in said[elsewhere + 1 :]]


def run(team: Team, fakes: Mapping[str, str], story: Callable[[Team, Report], None]) -> list[str]:
    """Runs one mission; returns its report. Raises Failed."""
    report = Report(team)
    try:
        team.launch(fakes)
        story(team, report)
    finally:
        team.end()
    return report.lines


def main() -> int:
    """The command."""
    with tempfile.TemporaryDirectory(prefix="lfield-survives-") as folder, ThreadPoolExecutor() as pool:
        mission = Team("self", HERE / "mission.dL", ("sky", "ground", "bench"), Path(folder))
        table = Team("quorum", HERE / "table.dL", ("port", "starboard", "tower"), Path(folder))
        first = pool.submit(run, mission, MISSION, started_again)
        try:
            # Starting needs most of the processor: one after the other.
            mission.wait_for("sky listening ")
            second = pool.submit(run, table, TABLE, gone_for_good)
            print("", "self: hosts that are started again", *first.result(), sep="\n")
            print("", "quorum: a host that never comes back", *second.result(), sep="\n")
        except Failed as failed:
            print(f"the mission failed: {failed}", file=sys.stderr)
            return exit_status.FAILED
    return exit_status.DONE


if __name__ == "__main__":
    sys.exit(main())
