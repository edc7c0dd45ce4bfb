"""`lfield watch`: a web page that shows a running team, with an emergency stop; or a recording of a team."""

from __future__ import annotations

import argparse
import asyncio
import signal
import time
from collections.abc import Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import (
    add_running_mission,
    named_mission,
    selected_runs,
    selected_team,
    selected_teams,
)
from lfield.errors import KeysError, PluginError, UsageError
from lfield.text.suggestions import listed

if TYPE_CHECKING:
    from lfield.authority.web_ca.web_keys import WebKeys
    from lfield.mission.team import Team
    from lfield.operator.targets import TargetTeam
    from lfield.operator.web.page_site import PageSite
    from lfield.operator.web.tiles.background import PageBackground
    from lfield.replay.web.replay_session import ReplaySession


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument(
        "--port",
        metavar="N",
        type=_port,
        default=0,
        help="port of the page (default: any free port)",
    )
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        type=_address,
        help="address on a network at which to serve the page, with HTTPS",
    )
    parser.add_argument(
        "--page-keys",
        metavar="DIR",
        type=Path,
        help="directory with the keys of the page, from 'lfield keys page ADDRESS'",
    )
    parser.add_argument(
        "--tiles",
        metavar="FILE|ADDRESS",
        help="background of the map: an MBTiles or PMTiles file with pictures, or the address of a tile "
        "server with {z}, {x} and {y}",
    )
    parser.add_argument(
        "--draw",
        metavar="FILE",
        type=Path,
        nargs="+",
        default=[],
        help="mission and area files to draw on the map, in addition to those that the program names",
    )
    parser.add_argument(
        "--replay",
        metavar="PATH",
        type=Path,
        nargs="+",
        help="show recordings instead of a running team: directories as for 'lfield replay'",
    )
    parser.add_argument(
        "--bundle", metavar="FILE", type=Path, help="bundle of the mission, if the recording has none"
    )


def _port(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text[:9]) <= 65535:
        raise argparse.ArgumentTypeError(f"a port is a number from 1 to 65535, not '{text}'")
    return int(text)


def _address(text: str) -> str:
    from lfield.authority.web_ca.web_names import normalised

    try:
        return normalised(text)
    except KeysError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def run(args: argparse.Namespace) -> int:
    """Returns 130, after a Ctrl-C."""
    from lfield.text.nonblocking_output import nonblocking_output

    # The process that prints also sends the STOP of the page.
    with nonblocking_output("lfield: ", content="output"):
        return _run(args)


def _run(args: argparse.Namespace) -> int:
    from lfield.operator.dashboard.map_files import file_drawings
    from lfield.operator.targets import open_team, running_mission
    from lfield.operator.web.tiles.background import PageBackground, open_background

    _check_replay_options(args)
    page_keys = _page_keys(args)
    _need_nicegui()
    drawings = file_drawings(args.draw)
    with closing(open_background(args.tiles)) if args.tiles else nullcontext() as tiles:
        if args.listen is not None and tiles is not None and tiles.origin.startswith("http:"):
            raise UsageError("browsers request no http tiles for a page with HTTPS: give an https address")
        background = PageBackground(tiles, drawings)
        if args.replay is not None:
            return _run_replay(args, background, page_keys)
        path = named_mission(args) or running_mission(selected_runs(args))
        team = open_team(path)
        target = selected_team(args)
        try:
            asyncio.run(_serve_page(args, path, team, target, background, page_keys))
        except (KeyboardInterrupt, asyncio.CancelledError):
            print("stopped watching; the mission is unchanged")
            return exit_status.INTERRUPTED
    return exit_status.DONE


def _run_replay(args: argparse.Namespace, background: PageBackground, page_keys: WebKeys | None) -> int:
    from lfield.operator.dashboard.map_files import program_drawings
    from lfield.replay.recording_files import load_team
    from lfield.replay.web.replay_session import ReplaySession

    print(f"reading {listed([str(path) for path in args.replay])}", flush=True)
    recording = load_team(args.replay, args.bundle)
    title = f"{recording.incarnations[0].folder.absolute().parent.name}, recorded"
    with ReplaySession(title, recording) as session:
        try:
            drawings = [*program_drawings(recording.mission.program), *background.drawings]
            asyncio.run(
                _serve_replay(args, title, session, background._replace(drawings=drawings), page_keys)
            )
        except (KeyboardInterrupt, asyncio.CancelledError):
            return exit_status.INTERRUPTED
    return exit_status.DONE


async def _serve_replay(
    args: argparse.Namespace,
    title: str,
    session: ReplaySession,
    background: PageBackground,
    page_keys: WebKeys | None,
) -> None:
    from lfield.clock import SystemClock
    from lfield.operator.web.page_server import ServedPage, serve

    site = await _site(args, page_keys)
    _cancel_on_ctrl_c()
    served = ServedPage(title, session, None, SystemClock(), background, session)
    await serve(served, site, lambda link: _print_line(f"open this link: {link}"))


def _check_replay_options(args: argparse.Namespace) -> None:
    """Raises UsageError for options of a running team beside --replay, or --bundle without it."""
    if args.replay is None:
        if args.bundle is not None:
            raise UsageError("--bundle is for recordings: name them with --replay PATH")
        return
    options = {"--run": args.run, "--map": args.map, "--inventory": args.inventory, "--keys": args.keys}
    arguments = ["MISSION"] if named_mission(args) else []
    if arguments := [*arguments, *(name for name, value in options.items() if value)]:
        raise UsageError(f"--replay shows recordings, not a running team: leave out {listed(arguments)}")


def _print_line(line: str) -> None:
    print(line, flush=True)


async def _site(args: argparse.Namespace, page_keys: WebKeys | None) -> PageSite:
    from lfield.operator.web.page_site import local_site, network_site

    if page_keys is None:
        return await local_site(args.port, _print_line)
    return await network_site(args.listen, args.port, page_keys, _print_line)


def _page_keys(args: argparse.Namespace) -> WebKeys | None:
    """Certificate and keys of a page on a network, else None. Raises UsageError, KeysError."""
    if args.listen is None:
        if args.page_keys is not None:
            raise UsageError("--page-keys is for a page on a network: say where with --listen ADDRESS")
        return None
    if args.page_keys is None:
        raise UsageError(
            "--listen needs --page-keys DIR: without TLS others on the network could press the buttons: "
            f"'lfield keys page {args.listen}' makes them"
        )
    from lfield.authority.web_ca.web_keys import read_web_keys

    keys = read_web_keys(args.page_keys)
    if refusal := keys.refusal(args.listen, time.time()):
        raise KeysError(refusal)
    return keys


def _need_nicegui() -> None:
    """Raises PluginError when nicegui is not installed."""
    from importlib.util import find_spec

    if find_spec("nicegui") is None:
        raise PluginError("'lfield watch' needs nicegui on this computer: pip install 'lfield[watch]'")


def _cancel_on_ctrl_c() -> None:
    """Ctrl-C cancels the running task once: a second one would interrupt the shutdown."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    # A shell ignores the signal for background processes.
    if task is None or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return

    def end() -> None:
        loop.add_signal_handler(signal.SIGINT, lambda: None)
        task.cancel()

    loop.add_signal_handler(signal.SIGINT, end)


async def _serve_page(
    args: argparse.Namespace,
    path: Path,
    team: Team,
    target: TargetTeam,
    background: PageBackground,
    page_keys: WebKeys | None,
) -> None:
    from lfield.client.team_watch import watch_team
    from lfield.clock import SystemClock
    from lfield.operator.web.page_server import ServedPage, serve

    def found() -> Sequence[TargetTeam]:
        return selected_teams(args, selected_runs(args))

    site = await _site(args, page_keys)
    _cancel_on_ctrl_c()
    if not target.runs:
        where = listed([f"{host} at {address}" for host, address in target.addresses.items()])
        _print_line(f"{path} is not running on this computer: the page waits for {where}")
    async with watch_team(path, team, target, found, args.keys) as watched:
        title = f"{path.absolute().parent.name}/{path.stem}"
        drawn = background._replace(drawings=[*watched.drawings, *background.drawings])
        served = ServedPage(title, watched, watched.actions, SystemClock(), drawn)
        await serve(served, site, lambda link: _print_line(f"open this link: {link}"))
