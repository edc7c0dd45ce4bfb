"""Checkpoints, replays and the debugger, for the figure `record`: prints the samples by case as JSON.

The checkpoints are of teams in virtual time. In the recording of one hour a coordinator hops between two
hosts five times a second.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.recording_target import RecordingDirectory, RecordingMemory
from lfield.mission.loader import load_mission
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.recording_files import TeamRecording, load_team
from lfield.replay.team_check import check_team
from lfield.simulate.host_fleet import Fleet, FleetOptions

HERE = Path(__file__).parent
#: Seconds of the longest recording, and the size limit of its files.
HOUR, LIMIT = 3600.0, 1 << 30
#: Rounds of measurements that take less than a second.
ROUNDS = 10


def timed(work: Callable[[], object]) -> float:
    """Seconds of a call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def stored(snapshots: CoreSnapshots) -> bytes:
    """A checkpoint in its stored form."""
    return zlib.compress(snapshots.capture(), 1)


def checkpoints(example: Path, seconds: float) -> dict[str, list[float]]:
    """Seconds and bytes of the checkpoints of a team."""
    made: list[CoreSnapshots] = []
    fleet = Fleet(
        load_mission(example, simulate=True),
        1,
        on_start=lambda name, life: made.append(CoreSnapshots(life.host.core)),
        options=FleetOptions(record=RecordingMemory()),
    )
    fleet.run(seconds)
    durations, sizes = [], []
    for snapshots in made:
        for _ in range(ROUNDS):
            durations.append(timed(partial(stored, snapshots)))
        sizes.append(float(len(stored(snapshots))))
    fleet.close()
    return {"time": durations, "size": sizes}


def recorded_hour(folder: Path, seconds: float) -> TeamRecording:
    """Record two hosts for `seconds`."""
    (folder / "mission.L").write_text((HERE / "walk.L").read_text(encoding="utf-8"), encoding="utf-8")
    agents = "//Post:near@a\n//Post:far@b\n//Walker:walker@a?0.2&1000\n"
    (folder / "mission.dL").write_text(agents, encoding="utf-8")
    target = RecordingDirectory(folder / "records", LIMIT)
    fleet = Fleet(load_mission(folder / "mission.dL"), 1, options=FleetOptions(record=target))
    fleet.run(seconds)
    for name in list(fleet.runs):
        fleet.stop(name)
    fleet.run(10.0)
    fleet.close()
    return load_team([folder / "records"])


def steps_back(debugger: Debugger) -> list[float]:
    """Seconds of steps back from the end, in order."""
    debugger.go_to(debugger.team.end)
    found = []
    for _ in range(ROUNDS):
        found.append(timed(lambda: debugger.step(backward=True)))
    return found


def samples_by_case(seconds: float) -> dict[str, list[float]]:
    """All samples by case."""
    examples = HERE.parents[2] / "examples"
    small = checkpoints(examples / "01-first-flight/mission.dL", 10.0)
    cases = {f"checkpoint, example 01: {name}": found for name, found in small.items()}
    with tempfile.TemporaryDirectory() as place:
        team = recorded_hour(Path(place), seconds)
        parts = [part for each in team.incarnations for part in each.parts]
        covered = statistics.mean(part.ended_at - part.started_at for part in parts)
        elapsed = timed(lambda: check_team(team))
        cases["replay of two hosts: times real time"] = [covered / elapsed]
        debuggers: list[Debugger] = []
        cases["debugger: opened"] = [
            timed(lambda: debuggers.append(Debugger(TeamTimeline(parts, team.mission))))
        ]
        (debugger,) = debuggers
        debugger.enter()
        first, *more = steps_back(debugger)
        cases["debugger: first step back from the end"] = [first]
        cases["debugger: further steps back"] = more
        debugger.go_to(debugger.team.start)
        debugger.enter()
        for text in (f"number == {int(seconds / 0.2) // 2 * 2 - 200}", "isLate"):
            target = debugger.condition_target(text)
            elapsed = timed(lambda target=target: debugger.search(target))  # type: ignore[misc]
            cases[f"debugger: until {text.partition(' ')[0]}, the whole hour"] = [elapsed]
            debugger.go_to(debugger.team.start)
    return cases


if __name__ == "__main__":
    print(json.dumps(samples_by_case(float(sys.argv[1]) if len(sys.argv) > 1 else HOUR)))
