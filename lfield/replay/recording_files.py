"""Reads recordings from directories: parts that belong together, parts that can be replayed, missing
parts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct, field

from lfield.errors import BundleError, InputFileError, RecordingError
from lfield.guard.recording.guard_segments import guard_problems
from lfield.host.inputs import Linked
from lfield.host.recording.host_records import StartRecord, TurnRecord
from lfield.host.recording.recording_target import BUNDLE_NAME, CORE_STEM
from lfield.mission import bundle
from lfield.mission.mission import Mission
from lfield.recording.folders import SUFFIX, parse_folder, segments_of, time_name
from lfield.recording.segments import MAGIC, SegmentReader
from lfield.replay.host_recording import HostRecording, require_valid
from lfield.text.input_files import error_reason


class Incarnation(Struct, frozen=True):
    """The recording of one incarnation: its folder, and its parts in order.

    The recording has one part, unless a file in its middle is missing or damaged: then a new part begins at
    the next checkpoint. `problems` describe missing data, a sentence each; `losses` are those about records
    before the end of the host's recording, which ends early if the host was killed.
    """

    folder: Path
    parts: tuple[HostRecording, ...]
    problems: tuple[str, ...]
    losses: tuple[str, ...]

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
        return self.parts[0].start.wall

    @property
    def started(self) -> tuple[str, float]:
        """A key that sorts starts: the time in the name of the folder, and that of the clock at the start.

        Names keep the order of the starts of a host also if its clock was wrong.
        """
        folder = parse_folder(self.folder)
        return time_name(max(0.0, self.started_at)) if folder is None else folder.started, self.started_at


class TeamRecording(Struct, frozen=True):
    """The recordings of one run of a mission, by the time of their starts.

    `missing` are the hosts of the team without a recording. `problems` are sentences about damaged or missing
    parts, `others` the folders of other runs that were found and are not used.
    """

    mission: Mission
    incarnations: tuple[Incarnation, ...]
    missing: tuple[str, ...]
    problems: tuple[str, ...]
    others: tuple[Path, ...] = field(default=())

    @property
    def losses(self) -> list[str]:
        """The data missing before the ends of the recordings, a sentence each."""
        return [f"{each.folder}: {loss}" for each in self.incarnations for loss in each.losses]


def load_team(paths: Sequence[Path], bundle_file: Path | None = None) -> TeamRecording:
    """The recordings in some directories; of several runs the newest. Raises RecordingError, InputFileError.

    A path is the folder of an incarnation, a file in one, or a directory of such folders or of directories of
    such folders. `bundle_file` is used for a folder without a bundle.
    """
    loaded, problems = [], []
    for folder in _folders(paths):
        try:
            loaded.append(load_incarnation(folder))
        except RecordingError as error:
            problems.append(f"{folder}: {error}")
    if not loaded:
        raise RecordingError("; ".join(problems) or "there is no recording here")
    loaded.sort(key=lambda each: each.started)
    groups = _runs(loaded)
    newest = max(groups, key=lambda group: max(each.started for each in group))
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
    losses: list[str] = []
    early_end = ""
    frames: list[bytes] = []
    expected = int(segments[0].stem.rpartition("-")[2])
    for path in segments:
        number = int(path.stem.rpartition("-")[2])
        if number != expected:
            losses.append(f"{path.name} follows a file that is missing")
            _add_part(parts, frames, losses)
        expected = number + 1
        gap = _read_segment(path, frames)
        if gap.reason and gap.is_cut and path == segments[-1]:
            early_end = f"{path.name}: {gap.reason}"
        elif gap.reason:
            losses.append(f"{path.name}: {gap.reason}")
            _add_part(parts, frames, losses)
    _add_part(parts, frames, losses)
    if not parts:
        raise RecordingError("; ".join([*losses, early_end] if early_end else losses) or "it has no record")
    if not parts[0].is_from_start:
        losses.append(f"the beginning is missing, it starts at a checkpoint in {segments[0].name}")
    if not early_end and parts[-1].gap and not losses:
        early_end = f"{parts[-1].gap}: the host still runs, or did not end in order"
    problems = [*losses, *([early_end] if early_end else []), *guard_problems(folder)]
    return Incarnation(folder, tuple(parts), tuple(problems), tuple(losses))


def _add_part(parts: list[HostRecording], frames: list[bytes], losses: list[str]) -> None:
    if frames:
        try:
            parts.append(HostRecording(frames.copy()))
        except RecordingError as error:
            losses.append(str(error))
    frames.clear()


class _Gap(NamedTuple):
    """The reason why a file is not complete, '' if it is; `is_cut`: the file only ends within a record."""

    reason: str = ""
    is_cut: bool = False


def _read_segment(path: Path, frames: list[bytes]) -> _Gap:
    """Add the frames of a file. Raises RecordingError for one of another format."""
    try:
        with path.open("rb") as stream:
            return _read_frames(path, SegmentReader(stream), frames)
    except FileNotFoundError:
        return _Gap("it was deleted meanwhile by the recorder")
    except OSError as error:
        raise InputFileError(str(path), error_reason(error)) from None


def _read_frames(path: Path, reader: SegmentReader, frames: list[bytes]) -> _Gap:
    if reader.end.offset < len(MAGIC):
        return _Gap("it is cut before its first record" if reader.end.offset else "it is empty", is_cut=True)
    if reader.problem:
        raise RecordingError(f"{path.name}: {reader.problem}")
    for place, each in enumerate(reader):
        try:
            require_valid(each)
        except RecordingError as error:
            return _Gap(f"record {place + 1}: {error}")
        frames.append(each)
    reason = reader.end.reason
    return _Gap(reason and f"{reason} at byte {reader.end.offset}", reader.end.is_cut)


def _folders(paths: Iterable[Path]) -> list[Path]:
    """The folders of incarnations in some directories, and in the directories in these.

    Of copies of one folder the first is used.
    """
    folders: dict[object, Path] = {}
    for path in paths:
        if not path.exists():
            raise InputFileError(str(path), "it does not exist")
        place = path if path.is_dir() else path.parent
        # Also the folder of a guard, and a file in it.
        place = place.parent if parse_folder(place.parent) is not None else place
        if parse_folder(place) is not None or any(place.glob(f"{CORE_STEM}-*{SUFFIX}")):
            inner = [place]
        else:
            inner = [each for folder in _directories(place) for each in _incarnations_in(folder)]
        if not inner:
            raise RecordingError(f"{path} has no recording")
        for each in inner:
            folders.setdefault(each if parse_folder(each) is None else each.name, each)
    return list(folders.values())


def _incarnations_in(folder: Path) -> list[Path]:
    """A folder of an incarnation, or those in another directory."""
    if parse_folder(folder) is not None:
        return [folder]
    try:
        return [each for each in _directories(folder) if parse_folder(each) is not None]
    except PermissionError:
        return []


def _directories(parent: Path) -> list[Path]:
    return sorted(each for each in parent.iterdir() if each.is_dir())


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
    return [sorted(members, key=lambda each: each.started) for _, members in groups]


def _peers(recording: HostRecording) -> set[int]:
    """The incarnations of other hosts that an incarnation has met."""
    return {
        turn.entry.hello.incarnation
        for _, turn in recording.turns_from(0)
        if isinstance(turn, TurnRecord) and isinstance(turn.entry, Linked)
    }


def _mission(loaded: Sequence[Incarnation], bundle_file: Path | None) -> Mission:
    """The mission of recordings of one run. Raises RecordingError, InputFileError."""
    starts = [part.start for each in loaded for part in each.parts]
    mission = _named_mission(bundle_file, starts) if bundle_file is not None else _own_mission(loaded)
    for start in starts:
        if start.host not in mission.team.hosts:
            raise RecordingError(f"its bundle has no host '{start.host}'")
    return mission


def _named_mission(path: Path, starts: Sequence[StartRecord]) -> Mission:
    """The mission in a named bundle, which must be that of the recording, as it ran or as it was read."""
    data = bundle.read_file(path)
    try:
        found = {hashlib.sha256(data).digest(), bundle.contents(data).digest}
        if not all(found & {start.bundle, start.release.digest} for start in starts):
            raise RecordingError(f"{path} is another bundle than that of the recording")
        return bundle.decode(data)
    except BundleError as error:
        raise RecordingError(f"{path}: {error}") from None


def _own_mission(loaded: Sequence[Incarnation]) -> Mission:
    """The mission in the bundle of the recordings."""
    required = loaded[-1].parts[0].start.bundle
    candidates = [each.folder / BUNDLE_NAME for each in reversed(loaded)]
    candidates = [path for path in candidates if path.exists()]
    for path in candidates:
        data = bundle.read_file(path)
        if hashlib.sha256(data).digest() != required:
            continue
        try:
            return bundle.decode(data)
        except BundleError as error:
            raise RecordingError(f"{path}: {error}") from None
    if not candidates:
        raise RecordingError(f"its bundle {BUNDLE_NAME} is missing: name one with --bundle FILE")
    raise RecordingError(f"{candidates[0]} is not the bundle of the recording: name it with --bundle FILE")
