"""Options of `lfield up` for the flight recorder: its folder and limit, or no recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.text.number_arguments import whole_between

if TYPE_CHECKING:
    from lfield.host.recording.recording_target import RecordingDirectory
    from lfield.mission.mission import Mission

#: The smallest and the largest limit of a recording, in MB.
LIMITS = 1, 1 << 20
#: The folder of the recordings in the state directory.
FOLDER = "recordings"


def add_record_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--record",
        metavar="DIR",
        type=Path,
        help="record each host in a new directory in DIR, for 'lfield replay' and 'lfield debug' "
        "(default: the state directory; a run on simulated devices is not recorded)",
    )
    where.add_argument("--no-record", action="store_true", help="do not record")
    parser.add_argument(
        "--record-limit",
        metavar="MB",
        type=whole_between(*LIMITS),
        default=64,
        help="maximum size of the recording of a host, whose oldest parts are deleted (default: 64)",
    )


def recording_target(mission: Mission, args: argparse.Namespace) -> RecordingDirectory | None:
    """The folder and limit of a host's recording; None without a recording. Raises NoHomeFolder."""
    from lfield.host.recording.recording_target import RecordingDirectory
    from lfield.text.user_dirs import state_dir

    if args.no_record or (args.record is None and mission.world != "hardware"):
        return None
    parent = args.record if args.record is not None else (args.state or state_dir()) / FOLDER
    return RecordingDirectory(parent, args.record_limit << 20)


def passed_on(args: argparse.Namespace) -> list[str]:
    """The options for the process of one host."""
    found = [f"--record={args.record}"] if args.record is not None else []
    found += ["--no-record"] if args.no_record else []
    return [*found, f"--record-limit={args.record_limit}"]
