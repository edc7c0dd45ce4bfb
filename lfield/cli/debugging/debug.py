"""`lfield debug PATH...`: time-travel debugger for recordings, or for a mission in virtual time."""

from __future__ import annotations

import argparse
import socket
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfield import exit_status
from lfield.errors import AddressError, LfieldError, UsageError
from lfield.text.number_arguments import real_above_0, whole_between

if TYPE_CHECKING:
    from lfield.cli.debugging.command_line import DebuggerCommands
    from lfield.cli.debugging.dap.dap_session import OpenedDebugger

#: The suffix of a deployment: such a mission runs in virtual time first.
DEPLOYMENT = ".dL"
#: Default length of a run in virtual time, in seconds.
DEFAULT_SECONDS = 600.0
PROMPT = "(lfield) "


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "paths",
        metavar="PATH",
        type=Path,
        nargs="*",
        help="directories of recordings, as for `lfield replay`; or a deployment (mission.dL), which first "
        "runs in virtual time with simulated devices; with --dap, the editor can name them instead",
    )
    parser.add_argument(
        "--bundle", metavar="FILE", type=Path, help="bundle of the mission, if the recording has none"
    )
    parser.add_argument(
        "--seconds",
        type=real_above_0(1e6, "seconds"),
        default=DEFAULT_SECONDS,
        metavar="S",
        help="longest run of a deployment in virtual time (default: 600)",
    )
    parser.add_argument(
        "--seed",
        type=whole_between(0, 1 << 62),
        default=0,
        metavar="N",
        help="seed of that run (default: 0)",
    )
    parser.add_argument(
        "--dap", action="store_true", help="serve an editor by the Debug Adapter Protocol on stdin and stdout"
    )
    parser.add_argument(
        "--port",
        type=whole_between(0, 65535),
        metavar="N",
        help="with --dap: listen on this port of the loopback interface",
    )
    parser.add_argument(
        "-c",
        "--command",
        dest="commands",
        action="append",
        default=[],
        metavar="TEXT",
        help="execute this debugger command; exit after the last -c; the command `help` lists all commands",
    )
    parser.add_argument("--plain", action="store_true", help="read commands line by line, without windows")


def run(args: argparse.Namespace) -> int:
    """Debug in the terminal, or serve an editor. Raises LfieldError."""
    if args.dap:
        return _serve(args)
    if args.port is not None:
        raise UsageError("--port needs --dap")
    if not args.paths:
        raise UsageError("name recordings or a deployment")
    from lfield.cli.debugging.command_line import DebuggerCommands

    debugger = open_debugger(args.paths, args.bundle, args.seconds, args.seed).debugger
    commands = DebuggerCommands(debugger)
    debugger.enter()
    if args.commands:
        return _execute(commands, args.commands)
    if args.plain or not (sys.stdin.isatty() and sys.stdout.isatty()):
        return _read_commands(commands)
    try:
        from lfield.cli.debugging.debug_screen import DebugScreen
    except ImportError:
        print("lfield: windows need prompt_toolkit: pip install 'lfield[desk]'", file=sys.stderr)
        return _read_commands(commands)
    DebugScreen(commands).run()
    return exit_status.DONE


def open_debugger(
    paths: Sequence[Path], bundle: Path | None = None, seconds: float = DEFAULT_SECONDS, seed: int = 0
) -> OpenedDebugger:
    """A debugger at the start of recordings, or of the run of a deployment. Raises LfieldError."""
    from lfield.cli.debugging.dap.dap_session import OpenedDebugger
    from lfield.replay.debugger.debugger import Debugger
    from lfield.replay.debugger.team_timeline import TeamTimeline
    from lfield.replay.device_events import with_device_events
    from lfield.replay.recording_files import load_team

    if paths and paths[0].suffix == DEPLOYMENT:
        if len(paths) > 1:
            raise UsageError("a deployment is debugged alone, without other paths")
        # The simulator of teams is above the commands: it is loaded by name, as the plugin of `lfield test`.
        record = import_module("lfield.testing.recorded_run").record_mission
        recordings, mission = record(paths[0], seconds, seed)
        return OpenedDebugger(Debugger(TeamTimeline(recordings, mission)), paths[0].resolve().parent)
    team = with_device_events(load_team(paths, bundle))
    for problem in (*team.problems, *(f"no recording of {host}" for host in team.missing)):
        print(f"incomplete: {problem}", file=sys.stderr)
    parts = [part for each in team.incarnations for part in each.parts]
    return OpenedDebugger(Debugger(TeamTimeline(parts, team.mission)), None)


# --- the terminal -----------------------------------------------------------------------------------------


def _execute(commands: DebuggerCommands, texts: Sequence[str]) -> int:
    for text in texts:
        for line in commands.execute(text):
            print(line)
    return exit_status.DONE


def _read_commands(commands: DebuggerCommands) -> int:
    """Commands from stdin, line by line; a mistake in one is reported and the next one is read."""
    from lfield.cli.debugging.search_watch import interruptible, show_on_terminal
    from lfield.replay.debugger.host_timeline import SearchCancelled

    is_terminal = sys.stdin.isatty()
    for line in commands.execute("where"):
        print(line)
    while not commands.is_done:
        if is_terminal:
            print(PROMPT, end="", flush=True)
        text = sys.stdin.readline()
        if not text:
            break
        try:
            with interruptible(commands.debugger.team, show_on_terminal):
                lines = commands.execute(text)
            for line in lines:
                print(line)
        except LfieldError as error:
            print(f"lfield: {error}", file=sys.stderr)
        except (SearchCancelled, KeyboardInterrupt):
            # A search may last long. The position is still unchanged.
            print("interrupted", file=sys.stderr)
    return exit_status.DONE


# --- editors ----------------------------------------------------------------------------------------------


def _serve(args: argparse.Namespace) -> int:
    from lfield.cli.debugging.dap.dap_session import DapSession
    from lfield.cli.debugging.dap.dap_wire import DapStream

    def opened(arguments: Mapping[str, Any]) -> OpenedDebugger:
        named = arguments.get("paths") or arguments.get("program") or []
        paths = [Path(each) for each in ([named] if isinstance(named, str) else named)] or args.paths
        if not paths:
            raise UsageError("'launch' needs 'paths': recordings or a deployment")
        return open_debugger(
            paths,
            args.bundle,
            float(arguments.get("seconds", args.seconds)),
            int(arguments.get("seed", args.seed)),
        )

    if args.port is None:
        # The streams of Python escape characters.
        with open(0, "rb", closefd=False) as source, open(1, "wb", closefd=False) as sink:
            DapSession(DapStream(source, sink), opened).serve()
        return exit_status.DONE
    try:
        listener = socket.create_server(("127.0.0.1", args.port))
    except OSError as error:
        raise AddressError(f"127.0.0.1:{args.port}", error.strerror or str(error)) from None
    with listener:
        print(f"debug adapter on 127.0.0.1:{listener.getsockname()[1]}", file=sys.stderr, flush=True)
        client, _ = listener.accept()
        with client, client.makefile("rb") as source, client.makefile("wb") as sink:
            DapSession(DapStream(source, sink), opened).serve()
    return exit_status.DONE
