"""Reads recordings from directories: what belongs together, what can be replayed, and what is missing."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lfield.errors import BundleError, InputFileError, RecordingError
from lfield.host.inputs import Linked
from lfield.host.recording.host_records import VERSION, TurnRecord
from lfield.host.recording.recording_target import BUNDLE_NAME, CORE_STEM
from lfield.mission import bundle
from lfield.mission.mission import Mission
from lfield.recording.folders import SUFFIX, parse_folder, segments_of
from lfield.recording.segments import MAGIC, SegmentReader, version_of
from lfield.replay.host_recording import HostRecording
from lfield.text.input_files import read_bytes

#: The largest segment, in bytes: a ring of the largest limit has files of an eighth of it.
MAX_SEGMENT = 1 << 37


@dataclass(frozen=True, slots=True)
class Incarnation:
    """The recording of one incarnation: its folder, and its parts in order.

    It has one part, unless a file in its middle is missing or damaged: then a new part begins at the next
    checkpoint. `problems` says what is missing, a sentence each.
    """

    folder: Path
    parts: tuple[HostRecording, ...]
    problems: tuple[str, ...]

    @property
    def host(self) -> str:
        """The name of the host."""
        return self.parts[0].host

    @property
    def run(self) -> str:
        """The run id."""
        return self.parts[-1].runs[-1]

    @property
    def started_at(self) -> float:
        """The wall-clock time of its start, in seconds since 1970."""
        start = self.parts[0].start
        return start.wall


@dataclass(frozen=True, slots=True)
class TeamRecording:
    """The recordings of one run of a mission, by the time of their starts.

    `missing` are the hosts of the team without a recording. `problems` are sentences about damaged or missing
    parts, `others` the folders of other runs that were found and are not used.
    """

    mission: Mission
    incarnations: tuple[Incarnation, ...]
    missing: tuple[str, ...]
    problems: tuple[str, ...]
    others: tuple[Path, ...] = field(default=())


def load_team(paths: Sequence[Path], bundle_file: Path | None = None) -> TeamRecording:
    """The recordings in some directories; of several runs the newest. Raises RecordingError, InputFileError.

    A path is the folder of an incarnation, a directory of such folders, or a file in one. `bundle_file` is
    used where a folder has no bundle.
    """
    loaded, problems = [], []
    for folder in _folders(paths):
        try:
            loaded.append(load_incarnation(folder))
        except RecordingError as error:
            problems.append(f"{folder}: {error}")
    if not loaded:
        raise RecordingError("; ".join(problems) or "there is no recording here")
    loaded.sort(key=lambda each: each.started_at)
    groups = _runs(loaded)
    newest = max(groups, key=lambda group: max(each.started_at for each in group))
    mission = _mission(newest, bundle_file)
    recorded = {each.host for each in newest}
    missing = tuple(host for host in mission.team.hosts if host not in recorded)
    others = tuple(each.folder for group in groups if group is not newest for each in group)
    problems += [f"{each.folder}: {problem}" for each in newest for problem in each.problems]
    return TeamRecording(mission, tuple(newest), missing, tuple(problems), others)


def load_incarnation(folder: Path) -> Incarnation:
    """The recording of one incarnation. Raises RecordingError, InputFileError."""
    segments = segments_of(folder, CORE_STEM)
    if not segments:
        raise RecordingError(f"it has no file {CORE_STEM}-*{SUFFIX}")
    parts: list[HostRecording] = []
    problems: list[str] = []
    frames: list[bytes] = []
    expected = int(segments[0].stem.rpartition("-")[2])
    for path in segments:
        number = int(path.stem.rpartition("-")[2])
        if number != expected:
            problems.append(f"{path.name} follows a file that is missing")
            _add_part(parts, frames, problems)
        expected = number + 1
        gap = _read_segment(path, frames)
        if gap:
            problems.append(f"{path.name}: {gap}")
            _add_part(parts, frames, problems)
    _add_part(parts, frames, problems)
    if not parts:
        raise RecordingError("; ".join(problems))
    if not parts[0].is_from_start:
        problems.append(f"the beginning is missing, it starts at a checkpoint in {segments[0].name}")
    if parts[-1].gap and not problems:
        problems.append(f"{parts[-1].gap}: the host did not end in order")
    return Incarnation(folder, tuple(parts), tuple(problems))


def _add_part(parts: list[HostRecording], frames: list[bytes], problems: list[str]) -> None:
    if frames:
        try:
            parts.append(HostRecording(frames.copy()))
        except RecordingError as error:
            problems.append(str(error))
    frames.clear()


def _read_segment(path: Path, frames: list[bytes]) -> str:
    """Add the frames of a file; returns why it is not complete, '' if it is. Raises RecordingError."""
    data = read_bytes(path, MAX_SEGMENT)
    version = version_of(data)
    if version is None:
        return "it is no recording" if data else "it is empty"
    if version > MAGIC[-1]:
        raise RecordingError(
            f"{path.name} has format {version}, this lfield reads format {MAGIC[-1]}: use the newer lfield"
        )
    reader = SegmentReader(data)
    frames.extend(reader)
    return reader.end.reason and f"{reader.end.reason} at byte {reader.end.offset}"


def _folders(paths: Iterable[Path]) -> list[Path]:
    found: dict[Path, None] = {}
    for path in paths:
        if not path.exists():
            raise InputFileError(str(path), "it does not exist")
        place = path if path.is_dir() else path.parent
        # Also the folder of a guard, and a file in it.
        place = place.parent if parse_folder(place.parent) is not None else place
        if parse_folder(place) is not None or any(place.glob(f"{CORE_STEM}-*{SUFFIX}")):
            found[place] = None
            continue
        inner = sorted(each for each in place.iterdir() if each.is_dir() and parse_folder(each) is not None)
        if not inner:
            raise RecordingError(f"{path} has no recording")
        found.update(dict.fromkeys(inner))
    return list(found)


def _runs(loaded: Sequence[Incarnation]) -> list[list[Incarnation]]:
    """Recordings that belong together: by run id, and by links between their incarnations."""
    groups: list[tuple[set[object], list[Incarnation]]] = []
    for each in loaded:
        keys: set[object] = {part.start.incarnation for part in each.parts}
        keys.update(run for part in each.parts for run in part.runs)
        keys.update(number for part in each.parts for number in _peers(part))
        joined = [group for group in groups if group[0] & keys]
        groups = [group for group in groups if not group[0] & keys]
        members = [member for group in joined for member in group[1]]
        groups.append((keys.union(*(group[0] for group in joined)), [*members, each]))
    return [sorted(members, key=lambda each: each.started_at) for _, members in groups]


def _peers(recording: HostRecording) -> set[int]:
    """The incarnations of other hosts that it has met."""
    return {
        turn.entry.hello.incarnation
        for _, turn in recording.turns_from(0)
        if isinstance(turn, TurnRecord) and isinstance(turn.entry, Linked)
    }


def _mission(loaded: Sequence[Incarnation], bundle_file: Path | None) -> Mission:
    """The mission of recordings of one run. Raises RecordingError, BundleError, InputFileError."""
    for each in loaded:
        version = each.parts[0].start.version
        if version > VERSION:
            raise RecordingError(f"{each.folder} is of a newer lfield ({each.parts[0].start.lfield})")
    required = loaded[-1].parts[0].start.bundle
    candidates = [each.folder / BUNDLE_NAME for each in reversed(loaded)]
    candidates = [bundle_file] if bundle_file is not None else [path for path in candidates if path.exists()]
    for path in candidates:
        data = bundle.read_file(path)
        if bundle_file is None and hashlib.sha256(data).digest() != required:
            continue
        try:
            return bundle.decode(data)
        except BundleError as error:
            raise RecordingError(f"{path}: {error}") from None
    if not candidates:
        raise RecordingError(f"its bundle {BUNDLE_NAME} is missing: name one with --bundle FILE")
    raise RecordingError(f"{candidates[0]} is not the bundle of the recording: name it with --bundle FILE")
