"""Runs a mission on virtual time with simulated devices, and records its hosts in memory.

`lfield debug mission.dL` debugs such recordings. The same seed gives the same run.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from lfield.host.recording.recording_target import RecordingMemory
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.recording.segments import MAGIC, SegmentReader
from lfield.replay.host_recording import HostRecording
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.testing.mission.mission_fakes import MissionFakes
from lfield.testing.mission.mission_team import DAY

#: Seconds for which hosts run on after all coordinators have ended.
SETTLE_TIME = 1.0


def record_mission(
    path: Path,
    seconds: float,
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda seconds: None,
) -> tuple[list[HostRecording], Mission]:
    """The recordings of a deployment that runs until its end, for at most so many seconds; and the mission.

    Raises LfieldError.
    """
    mission = load_mission(path, simulate=True)
    memory = RecordingMemory()
    fakes = MissionFakes({}, lambda *arguments: None)
    options = FleetOptions(
        mission.bindings.unreachable_after, SETTLE_TIME, time_of_day=DAY[0], clock_drift=0.0, record=memory
    )
    fleet = Fleet(mission, seed, plug=fakes.plug, options=options)
    try:
        _run(fleet, fakes, seconds, on_progress)
        run = fleet.mission
    finally:
        fleet.close()
    return recordings_in(memory), run


def recordings_in(memory: RecordingMemory) -> list[HostRecording]:
    """The recordings of the incarnations of hosts, in the order of their starts."""
    frames = [
        [record for data in sink.frames for record in SegmentReader(BytesIO(MAGIC + data))]
        for _, _, sink in memory.sinks
    ]
    return [HostRecording(each) for each in frames if each]


def _run(fleet: Fleet, fakes: MissionFakes, seconds: float, on_progress: Callable[[float], None]) -> None:
    """Runs until all hosts have ended, and raises an exception of a simulated device."""
    while fleet.now < seconds and (fleet.runs or not fleet.left):
        fleet.run(min(1.0, seconds - fleet.now))
        for failure in fakes.failures:
            raise failure
        on_progress(fleet.now)
