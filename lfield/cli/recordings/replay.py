"""`lfield replay PATH...`: replays recordings on the real cores and reports the first difference."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lfield import exit_status
from lfield.cli.recordings.program_check import check_program, gap_lines, utc_time

if TYPE_CHECKING:
    from lfield.replay.recording_files import TeamRecording
    from lfield.replay.team_check import FirstDifference, OnProgress, ReplaySummary
    from lfield.vm.engine_interface import Engines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_recordings(parser)
    parser.add_argument(
        "--engine",
        choices=("reference", "wasm"),
        default="reference",
        help="engine that runs the program; the results are the same (default: reference)",
    )
    parser.add_argument(
        "--program",
        metavar="MISSION.dL",
        type=Path,
        help="run the program of another version of the mission on the recorded readings and answers, and "
        "show where its portal and device calls begin to differ",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Declare the argument that names recordings."""
    parser.add_argument(
        "paths",
        metavar="PATH",
        type=Path,
        nargs="+",
        help="directory of one recording, or of several: all recordings of the newest run are used together",
    )
    parser.add_argument(
        "--bundle",
        metavar="FILE",
        type=Path,
        help="bundle of the mission, if the recording has none",
    )


def run(args: argparse.Namespace) -> int:
    """Replay and report; returns 0 if all turns are equal, 1 at a difference."""
    from lfield.replay.recording_files import load_team
    from lfield.replay.team_check import ReplaySummary, check_guards, check_team

    recording = load_team(args.paths, args.bundle)
    if args.program is not None:
        return check_program(recording, args.program, named_engine(args.engine), as_json=args.json)
    turns = sum(part.turns for each in recording.incarnations for part in each.parts)
    with replay_progress(turns, quiet=args.json) as on_progress:
        result = check_team(recording, named_engine(args.engine), on_progress)
    guards, problems = check_guards(recording)
    result = ReplaySummary([*result.parts, *guards])
    # Reading a guard's ring finds the problems that loading it has found, and more.
    recording = replace(recording, problems=tuple(dict.fromkeys((*recording.problems, *problems))))
    if args.json:
        print(json.dumps(_as_data(recording, result)))
    else:
        _print(recording, result)
    return exit_status.FAILED if result.differences else exit_status.DONE


def named_engine(name: str) -> Engines:
    """The engine with that name. Raises UsageError if it is not installed."""
    from lfield.host.engine_provider import select_engine

    return select_engine(name, lambda line: None, float)


@contextmanager
def replay_progress(turns: int, *, quiet: bool) -> Iterator[OnProgress]:
    """A progress bar over so many turns, on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as progress:
        task = progress.add_task("replaying", total=turns)
        yield lambda done: progress.advance(task, done)


def _as_data(recording: TeamRecording, result: ReplaySummary) -> dict[str, object]:
    from lfield.replay.device_events import safety_stops

    first, release = result.first, recording.incarnations[-1].parts[0].start.release
    return {
        "digests": result.digests,
        "differences": result.differences,
        "first": None if first is None else first.as_data(),
        "hosts": [
            {
                "host": part.host,
                "incarnation": f"{part.incarnation:x}",
                "turns": part.turns,
                "digests": part.digests,
                "seconds": part.seconds,
                "differences": part.differences,
            }
            for part in result.parts
            if not part.guard
        ],
        "guards": [
            {
                "host": part.host,
                "device": part.guard,
                "digests": part.digests,
                "differences": part.differences,
            }
            for part in result.parts
            if part.guard
        ],
        "missing": list(recording.missing),
        "problems": list(recording.problems),
        "run": recording.incarnations[-1].run,
        "bundle": {"digest": release.digest.hex(), "by": release.by},
        "stops": [
            {"host": stop.host, "time": stop.at, "device": stop.device, "by": stop.by, "reason": stop.reason}
            for stop in safety_stops(recording)
        ],
    }


def _print(recording: TeamRecording, result: ReplaySummary) -> None:
    from lfield.replay.device_events import safety_stops
    from lfield.text.terminal_escape import escape_line

    for part in result.parts:
        state = "differs" if part.differences else "equal" if part.digests else "nothing to compare"
        if part.guard:
            print(f"{part.host}: guard of {part.guard}: {part.digests} decisions: {state}")
            continue
        print(f"{part.host}: {part.turns} turns, {part.seconds:.1f} s, {part.digests} digests: {state}")
    for stop in safety_stops(recording):
        print(f"{stop.host}: {utc_time(stop.at, 3)} UTC: {escape_line(stop.line)}")
    for line in gap_lines(recording):
        print(line)
    if result.first is not None:
        print("\n".join(difference_lines(result.first)))


def difference_lines(first: FirstDifference) -> list[str]:
    """The lines that show a difference."""
    from lfield.replay.team_check import plain

    at = utc_time(first.at, 6)
    agent = f", {first.agent} at {first.place}" if first.place else ""
    return [
        f"first difference: {first.host} at {at} UTC, turn {first.turn}{agent}: {first.subject}",
        f"  recorded: {json.dumps(plain(first.recorded))}",
        f"  replayed: {json.dumps(plain(first.replayed))}",
    ]
