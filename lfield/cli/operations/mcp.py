"""`lfield mcp`: serves an AI assistant by the Model Context Protocol on stdin and stdout."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, team_selection
from lfield.errors import OutputFileError, PluginError
from lfield.text.log_messages import LogLine
from lfield.text.terminal_escape import escape_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument(
        "--log",
        metavar="FILE",
        type=Path,
        help="also append every tool call, with its caller, to this file",
    )


def run(args: argparse.Namespace) -> int:
    """Serve until the assistant ends the session. Raises PluginError where mcp is not installed."""
    try:
        from lfield.client.assistants.assistant_server import serve_assistant
    except ImportError:
        raise PluginError("'lfield mcp' needs mcp: pip install 'lfield[mcp]'") from None
    selection = team_selection(args)
    with ExitStack() as files:
        outputs = [sys.stderr]
        if args.log is not None:
            try:
                outputs.append(files.enter_context(args.log.open("a", encoding="utf-8")))
            except OSError as error:
                raise OutputFileError(str(args.log), error.strerror or str(error)) from None

        def log(line: LogLine) -> None:
            text = escape_line(f"{datetime.now().astimezone().isoformat(timespec='milliseconds')} {line}")
            for output in outputs:
                try:
                    print(text, file=output, flush=True)
                except OSError as error:
                    raise OutputFileError(output.name, error.strerror or str(error)) from None

        serve_assistant(selection, _own_name(args.keys), log)
    return exit_status.DONE


def _own_name(folder: Path | None) -> str:
    """The owner of the keys, else the user of this computer. Raises KeysError."""
    from lfield.authority.certificate_reader import verify_keys
    from lfield.client.service_desk import find_person_keys
    from lfield.net.peer_credentials import own_process_identity

    keys = find_person_keys(folder)
    return str(own_process_identity(os.geteuid()) if keys is None else verify_keys(keys))
