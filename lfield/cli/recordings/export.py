"""`lfield export PATH...`: a recording as MCAP for Foxglove, or as CSV tables."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from lfield import exit_status
from lfield.cli.recordings.program_check import gap_lines
from lfield.cli.recordings.replay import add_recordings, replay_progress
from lfield.errors import OutputFileError, UsageError

if TYPE_CHECKING:
    from lfield.export.export_input import MissionInfo, StreamItem


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_recordings(parser)
    parser.add_argument(
        "--mcap",
        metavar="FILE",
        type=Path,
        help="write a new MCAP file with Foxglove's schemas; FILE must not exist",
    )
    parser.add_argument(
        "--csv",
        metavar="DIR",
        type=Path,
        help="write CSV tables into a directory, which must be new or empty",
    )


def run(args: argparse.Namespace) -> int:
    """Replay the recording, and write its events and telemetry."""
    from lfield.export.export_input import StreamNotice, mission_info
    from lfield.replay.event_stream import event_stream
    from lfield.replay.recording_files import load_team

    if args.mcap is None and args.csv is None:
        raise UsageError("name what to write: --mcap FILE, --csv DIR, or both")
    recording = load_team(args.paths, args.bundle)
    if args.csv is not None:
        _create_folder(args.csv)
    for line in gap_lines(recording):
        print(f"lfield: {line}", file=sys.stderr)
    turns = sum(part.turns for each in recording.incarnations for part in each.parts)
    with replay_progress(turns, quiet=False) as on_progress:
        items = event_stream(recording, on_progress)
    known = {problem for each in recording.incarnations for problem in each.problems}
    for item in items:
        if isinstance(item, StreamNotice) and item.text not in known:
            print(f"lfield: incomplete: {item.host}: {item.text}", file=sys.stderr)
    info = mission_info(recording.mission.name, recording.mission)
    if args.mcap is not None:
        _write_mcap(items, info, args.mcap)
    if args.csv is not None:
        _write_csv(items, info, args.csv)
    return exit_status.DONE


def _write_mcap(items: list[StreamItem], info: MissionInfo, path: Path) -> None:
    from lfield.cli.output_files import RecordingFile
    from lfield.export.mcap_writer import END_WITHOUT_SUMMARY, export_mcap, require_mcap

    require_mcap()
    file = RecordingFile(path, END_WITHOUT_SUMMARY)
    try:
        summary = export_mcap(items, info, out=file)
        file.finish()
    except OutputFileError:
        # As of a full disk: a part of an export is of no use.
        if path.is_file():
            path.unlink()
        raise
    finally:
        file.close()
    print(f"{path}: {summary.messages} messages in {summary.channels} channels, {summary.size} bytes")


def _create_folder(folder: Path) -> None:
    """Create the directory of the tables. Raises OutputFileError if it cannot be used."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_used = any(folder.iterdir())
    except OSError as error:
        raise OutputFileError(str(folder), error.strerror or str(error)) from None
    if is_used:
        raise OutputFileError(str(folder), "the directory is not empty: name another one")


def _write_csv(items: list[StreamItem], info: MissionInfo, folder: Path) -> None:
    from lfield.export.tables.csv_tables import export_csv

    written: list[Path] = []
    try:
        with ExitStack() as opened:

            def open_table(name: str) -> TextIO:
                table = opened.enter_context((folder / name).open("x", encoding="utf-8", newline=""))
                written.append(folder / name)
                return table

            names = export_csv(items, info, open_table=open_table)
    except OSError as error:
        # As of a full disk: a part of an export is of no use.
        for path in written:
            path.unlink(missing_ok=True)
        raise OutputFileError(str(folder), error.strerror or str(error)) from None
    print(f"{folder}: {', '.join(names)}")
