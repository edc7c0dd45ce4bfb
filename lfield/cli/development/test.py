"""`lfield test`: run the tests of missions in virtual time and draw the tracks; or check a program against a
recording."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from lfield import exit_status
from lfield.errors import PluginError, UsageError
from lfield.text.terminal_escape import unescaped_stream

#: The exit statuses of pytest as our statuses: passed, failed, interrupted, broken, misused, no tests found.
_STATUSES = (
    exit_status.DONE, exit_status.FAILED, exit_status.INTERRUPTED, exit_status.SOFTWARE, exit_status.USAGE,
    exit_status.NO_INPUT,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the tests to run, and the folder of pictures."""
    parser.add_argument("paths", nargs="*", metavar="PATH", help="test files or directories (default: .)")
    parser.add_argument(
        "--from",
        dest="recording",
        metavar="RECORDING",
        type=Path,
        help="test whether the program of a deployment (PATH; default: the one in this directory with the "
        "name of the recorded mission) still makes the recorded portal and device calls, with the recorded "
        "answers of devices",
    )
    parser.add_argument(
        "-k", default="", metavar="WORDS", help="run only tests whose names match, as in pytest"
    )
    parser.add_argument("-x", action="store_true", help="stop after the first failure")
    parser.add_argument("-q", action="store_true", help="print less")
    parser.add_argument("-v", action="store_true", help="print the name of each test")
    parser.add_argument("-s", action="store_true", help="show the output of tests")
    parser.add_argument(
        "--tracks",
        type=Path,
        default=Path("tracks"),
        metavar="DIR",
        help="directory for the pictures (default: tracks)",
    )


def run(args: argparse.Namespace) -> int:
    """Run pytest with `lfield.testing.plugin`. Raises PluginError where pytest is not installed."""
    if args.recording is not None:
        return _run_on_recording(args)
    try:
        from lfield.cli.development.pytest_run import run_pytest
    except ImportError:
        raise PluginError("'lfield test' needs pytest: pip install 'lfield[desk]'") from None
    # A plugin that the project's configuration names too is loaded once.
    options = ["-p", "lfield.testing.plugin", "--tracks", os.path.abspath(args.tracks)]
    options += [flag for flag in ("-x", "-q", "-v", "-s") if getattr(args, flag[1:])]
    options += ["-k", args.k] if args.k else []
    # Pytest has colours of its own.
    sys.stdout, sys.stderr = unescaped_stream(sys.stdout), unescaped_stream(sys.stderr)
    return _STATUSES[run_pytest([*options, *args.paths])]


def _run_on_recording(args: argparse.Namespace) -> int:
    """Check the program of a deployment against a recording."""
    from lfield.cli.recordings.program_check import check_program, named_mission_file
    from lfield.cli.recordings.replay import named_engine
    from lfield.replay.recording_files import load_team

    if args.k or args.x or args.v or args.s:
        raise UsageError("-k, -x, -v and -s are for test files: --from tests one program")
    recording = load_team([args.recording])
    path = named_mission_file(recording, args.paths)
    return check_program(recording, path, named_engine("reference"), as_json=False, quiet=args.q)
