"""Teams in virtual time whose hosts are recorded in memory, and the comparison of their replays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path

from lfield.host.recording.host_records import FrameHeader, HostRecord, encode_frame
from lfield.host.recording.recording_target import (
    BUNDLE_NAME,
    CORE_STEM,
    RecordingDirectory,
    RecordingMemory,
    RecordSink,
)
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.recording.folders import SUFFIX, create_folder
from lfield.recording.segments import MAGIC, SegmentReader, frame
from lfield.replay.host_recording import HostRecording
from lfield.replay.host_replay import HostReplay
from lfield.replay.team_check import ReplaySummary, check_part
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.vm.engine_interface import Engines
from lfield.vm.reference import ReferenceEngine

#: A coordinator that moves between two hosts, calls resources, and prints.
WALK_PROGRAM = """
resource Post {
    int seen;
    init(string[] arg) { seen = 0; }
    portal stamp(string who) emit int {
        seen = seen + 1;
        sleep(0.02);
        return seen;
    }
}
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        int number = 0;
        while (number < 1000000) {
            number = number + all[number % all.length()].stamp("walker");
            print(i2s(number));
            sleep(0.1);
        }
    }
}
"""
WALK_DEPLOYMENT = "//Post:north@north\n//Post:south@south\n//Walker:walker@north\n"


@dataclass(frozen=True, slots=True)
class RecordedTeam:
    """A mission that has run, and the frames of each incarnation, in the order of their starts."""

    mission: Mission
    hosts: tuple[tuple[str, tuple[bytes, ...]], ...]
    #: The recorded bundles, in the same order; none for a memory that does not keep them.
    bundles: tuple[bytes, ...] = ()

    def recordings(self) -> list[HostRecording]:
        """The recordings of the incarnations that had a turn."""
        return [HostRecording(frames) for _, frames in self.hosts if frames]

    def with_own_bundles(self) -> Iterator[RecordedTeam]:
        """Each incarnation alone, with the mission in its own recording. Raises BundleError."""
        for host, data in zip(self.hosts, self.bundles, strict=True):
            yield RecordedTeam(bundle.decode(data), (host,), (data,))


class MemoryWithBundles(RecordingMemory):
    """Recordings in memory, with the bundle of each incarnation."""

    def __init__(self) -> None:
        super().__init__()
        self.bundles: list[bytes] = []

    def open_sink(
        self, host: str, incarnation: int, wall_time: float, bundle: bytes, on_failure: Callable[[str], None]
    ) -> RecordSink:
        self.bundles.append(bundle)
        return super().open_sink(host, incarnation, wall_time, bundle, on_failure)


def walk_mission(folder: Path) -> Mission:
    """The mission of WALK_PROGRAM."""
    (folder / "mission.L").write_text(WALK_PROGRAM)
    (folder / "mission.dL").write_text(WALK_DEPLOYMENT)
    return load_mission(folder / "mission.dL")


def run_recorded(mission: Mission, seconds: float, seed: int = 1) -> RecordedTeam:
    """Run a team for some seconds of virtual time; its hosts then end as by a loss of power."""
    memory = MemoryWithBundles()
    fleet = Fleet(mission, seed, options=FleetOptions(record=memory))
    try:
        fleet.run(seconds)
        return recorded(fleet.mission, memory)
    finally:
        fleet.close()


def recorded(mission: Mission, memory: RecordingMemory) -> RecordedTeam:
    """The contents of the memory."""
    bundles = tuple(memory.bundles) if isinstance(memory, MemoryWithBundles) else ()
    hosts = ((host, tuple(contents_of(sink.frames))) for host, _, sink in memory.sinks)
    return RecordedTeam(mission, tuple(hosts), bundles)


def contents_of(frames: Iterable[bytes]) -> Iterator[bytes]:
    """The contents of frames in the form of a file."""
    for each in frames:
        yield from SegmentReader(BytesIO(MAGIC + each))


def compare(team: RecordedTeam, engines: Engines = ReferenceEngine, *, at_checkpoints: bool) -> ReplaySummary:
    """Replay all incarnations from their start, and also from each of their checkpoints."""
    found = ReplaySummary()
    for recording in team.recordings():
        checkpoints = checkpoint_turns(recording) if at_checkpoints else []
        for turn in (0, *checkpoints):
            found.parts.append(check_part(recording, HostReplay(recording, team.mission, engines, turn)))
    return found


def checkpoint_turns(recording: HostRecording) -> list[int]:
    """The turns that follow a checkpoint."""
    return [each.turn for each in recording.frames if each.header.kind == b"C"]


def run_into(folder: Path, mission: Mission, seconds: float, time_of_day: float | None = None) -> None:
    """Run a team for some seconds of virtual time, then stop it; its hosts are recorded into a directory."""
    target = RecordingDirectory(folder, 64 << 20)
    fleet = Fleet(mission, 1, options=FleetOptions(time_of_day=time_of_day, record=target))
    fleet.run(seconds)
    for name in list(fleet.runs):
        fleet.stop(name)
    fleet.run(20.0)
    fleet.close()


def write_folder(
    parent: Path, team: RecordedTeam, number: int = 0, wall: float = 1.8e9, cuts: Iterable[int] = ()
) -> Path:
    """Write an incarnation as `lfield up` does; a new file begins at the frames with the numbers `cuts`."""
    host, frames = team.hosts[number]
    folder = create_folder(parent, host, HostRecording(frames).start.incarnation, wall)
    (folder / BUNDLE_NAME).write_bytes(bundle.encode(team.mission))
    edges = [0, *cuts, len(frames)]
    for place, (first, last) in enumerate(pairwise(edges), 1):
        data = MAGIC + b"".join(map(frame, frames[first:last]))
        (folder / f"{CORE_STEM}-{place:06d}{SUFFIX}").write_bytes(data)
    return folder


def checkpoints_of(team: RecordedTeam, number: int = 0) -> list[int]:
    """The numbers of the frames that are checkpoints."""
    recording = HostRecording(team.hosts[number][1])
    return [place for place, each in enumerate(recording.frames) if each.header.kind == b"C"]


def content(records: list[HostRecord], kind: bytes, turns: int = 0) -> bytes:
    """Records as the content of a frame."""
    return encode_frame(records, FrameHeader(kind, 0.0, turns))
