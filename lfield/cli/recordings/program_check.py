"""What `lfield replay --program` and `lfield test --from` have in common: a program on a recorded world."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.errors import InputFileError, UsageError

if TYPE_CHECKING:
    from lfield.mission.mission import Mission
    from lfield.replay.call_log import CallDifference, CallLog, LoggedCall
    from lfield.replay.recording_files import TeamRecording
    from lfield.vm.engine_interface import Engines


def check_program(
    recording: TeamRecording, path: Path, engines: Engines, *, as_json: bool, quiet: bool = False
) -> int:
    """Run the program of a mission on a recording and report where its calls differ; returns 0 or 1.

    Raises ProgramError, RecordingError.
    """
    from lfield.replay.program_replay import mission_with, run_program
    from lfield.replay.team_order import TeamOrder

    mission = mission_with(recording, _load(path))
    order = TeamOrder([part for each in recording.incarnations for part in each.parts])
    recorded = run_program(recording, order, recording.mission, engines)
    replayed = run_program(recording, order, mission, engines)
    difference = recorded.first_difference(replayed)
    if as_json:
        print(json.dumps(_as_data(recording, recorded, replayed, difference)))
    elif not quiet or difference is not None:
        print("\n".join(_lines(path, recorded, replayed, difference)))
    return exit_status.DONE if difference is None else exit_status.FAILED


def named_mission_file(recording: TeamRecording, paths: list[str]) -> Path:
    """The mission to test: the one that is named, or that of the recording in the working directory.

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


def _lines(path: Path, recorded: CallLog, replayed: CallLog, difference: CallDifference | None) -> list[str]:
    if difference is None:
        return [f"{path}: the same {recorded.count} calls as in the recording"]
    at = time.strftime("%H:%M:%S", time.gmtime(difference.at)) + f"{difference.at % 1:.3f}"[1:]
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
