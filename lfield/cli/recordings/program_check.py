"""Common parts of `lfield replay --program` and `lfield test --from`: a program on a recorded world."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.errors import InputFileError, UsageError
from lfield.text.suggestions import listed

if TYPE_CHECKING:
    from lfield.mission.mission import Mission
    from lfield.replay.call_log import CallDifference, CallLog, LoggedCall
    from lfield.replay.recording_files import TeamRecording
    from lfield.vm.engine_interface import Engines


def check_program(
    recording: TeamRecording, path: Path, engines: Engines, *, as_json: bool, quiet: bool = False
) -> int:
    """Run the program of a mission on a recording and report the differences of its calls.

    Returns 0 for the same calls, 1 for others, 65 if the recording cannot tell. Raises ProgramError,
    RecordingError.
    """
    from lfield.replay.program_replay import mission_with, run_program
    from lfield.replay.team_order import TeamOrder

    mission = mission_with(recording, _load(path))
    order = TeamOrder([part for each in recording.incarnations for part in each.parts])
    recorded = run_program(recording, order, recording.mission, engines)
    replayed = run_program(recording, order, mission, engines, recorded)
    difference = recorded.first_difference(replayed)
    unknown = _unknown_reason(recording, recorded) if difference is None else ""
    if as_json:
        print(json.dumps({**_as_data(recording, recorded, replayed, difference), "unknown": unknown}))
    else:
        for line in gap_lines(recording):
            print(f"lfield: {line}", file=sys.stderr)
        if unknown:
            print(f"lfield: {path}: unknown whether it makes the recorded calls: {unknown}", file=sys.stderr)
        elif not quiet or difference is not None:
            print("\n".join(_lines(recording, path, recorded, replayed, difference)))
    if unknown:
        return exit_status.DATA
    return exit_status.DONE if difference is None else exit_status.FAILED


def _unknown_reason(recording: TeamRecording, recorded: CallLog) -> str:
    """The reason why equal calls prove nothing, '' if they do prove it."""
    if recording.missing:
        return f"no recording of {listed(recording.missing)}"
    if recording.losses:
        return recording.losses[0]
    if recorded.missed_calls:
        return f"{recorded.missed_calls} recorded device calls cannot be repeated"
    return "" if recorded.count else "the recorded program makes no portal or device call"


def utc_time(at: float, digits: int) -> str:
    """The time of day of seconds since 1970, with digits of the second."""
    try:
        return time.strftime("%H:%M:%S", time.gmtime(at)) + f"{at % 1:.{digits}f}"[1:]
    except (OverflowError, ValueError, OSError):  # a damaged recording
        return f"{at:g} s"


def gap_lines(recording: TeamRecording) -> list[str]:
    """The missing parts of a recording, a line each."""
    lines = [f"incomplete: {problem}" for problem in recording.problems]
    if recording.missing:
        lines.append(f"no recording of: {', '.join(recording.missing)}")
    if recording.others:
        lines.append(f"not used, of other runs: {', '.join(path.name for path in recording.others)}")
    return lines


def named_mission_file(recording: TeamRecording, paths: list[str]) -> Path:
    """The mission to test: the named one, or that of the recording in the working directory.

    Raises UsageError, InputFileError.
    """
    if len(paths) > 1:
        raise UsageError("with --from name one deployment or none")
    path = Path(paths[0]) if paths else Path(f"{recording.mission.name}.dL")
    if path.suffix != ".dL":
        raise UsageError(f"{path} is no deployment: name the file mission.dL of the program to test")
    if not path.exists():
        hint = "" if paths else "; name the deployment of the program, as in 'lfield test --from DIR FILE.dL'"
        raise InputFileError(str(path), f"it does not exist{hint}")
    return path


def _load(path: Path) -> Mission:
    from lfield.mission.loader import load_mission

    return load_mission(path, simulate=True)


def _as_data(
    recording: TeamRecording, recorded: CallLog, replayed: CallLog, difference: CallDifference | None
) -> dict[str, object]:
    first = None
    if difference is not None:
        first = {
            "agent": difference.agent,
            "call": difference.number,
            "time": difference.at,
            "recorded": _call_data(difference.recorded),
            "replayed": _call_data(difference.replayed),
        }
    return {
        "digests": recorded.count,
        "differences": int(difference is not None),
        "first": first,
        "calls": {"recorded": recorded.count, "replayed": replayed.count},
        "missing": list(recording.missing),
        "problems": list(recording.problems),
    }


def _call_data(call: LoggedCall | None) -> dict[str, object] | None:
    if call is None:
        return None
    return {"call": call.text, "host": call.host, "time": call.at, "place": call.place}


def _lines(
    recording: TeamRecording,
    path: Path,
    recorded: CallLog,
    replayed: CallLog,
    difference: CallDifference | None,
) -> list[str]:
    if difference is None:
        whole = ", which is incomplete" if recording.problems else ""
        return [f"{path}: the same {recorded.count} calls as in the recording{whole}"]
    at = utc_time(difference.at, 3)
    return [
        f"{path}: other calls than in the recording, from call {difference.number} of {difference.agent} on, "
        f"at {at} UTC",
        f"  recorded: {_call_text(difference.recorded)}",
        f"  now:      {_call_text(difference.replayed)}",
        f"{recorded.count} calls in the recording, {replayed.count} now",
    ]


def _call_text(call: LoggedCall | None) -> str:
    if call is None:
        return "no further call"
    return f"{call.text} at {call.place or 'an unknown line'}, on {call.host}"
