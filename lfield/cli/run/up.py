"""`lfield up`: runs one host of a mission here, or all of them as processes of this machine.

A host always runs a bundle: the named one, or one that is built in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import (
    add_addresses,
    add_bindings,
    add_mission,
    add_program,
    mission_path,
    setup_command,
)
from lfield.cli.run.record_options import add_record_options, recording_target
from lfield.client.team_selection import TeamSelection
from lfield.errors import DevicesError, LfieldError, OutputFileError, UsageError
from lfield.text.number_arguments import real_above_0, whole_between

#: Default of --lasts (s).
DAY = 86400.0
#: Maximum of --lasts (s): no keys last longer.
MAX_SECONDS = 36500 * DAY
#: The type of a time-out option.
_SECONDS = real_above_0(1e6, "seconds")
_DESCRIPTOR = whole_between(0, 1 << 20)

if TYPE_CHECKING:
    from lfield.host.process.credentials import HostCredentials
    from lfield.journal.journal import Journal
    from lfield.journal.journal_loader import JournalOwner
    from lfield.mission.mission import Mission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_mission(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--host", metavar="NAME", help="host to run (default: the host with this computer's name or address)"
    )
    where.add_argument(
        "--all", action="store_true", help="run all hosts on this computer, each in its own process"
    )
    add_program(parser)
    add_bindings(parser)
    parser.add_argument(
        "--files",
        metavar="DIR",
        type=Path,
        help="directory of the files that the devices of a bundle need (default: the bundle's directory)",
    )
    parser.add_argument(
        "--sim", action="store_true", help="start a simulated device in place of each real one"
    )
    add_addresses(parser)
    parser.add_argument("--until-done", action="store_true", help="exit when all coordinators have ended")
    parser.add_argument(
        "--dump",
        metavar="DIR",
        type=Path,
        help="directory for a dump of each agent that fails; 'lfield inspect' prints it",
    )
    parser.add_argument(
        "--unreachable-after",
        metavar="SECONDS",
        type=_SECONDS,
        help="how long a portal call tries to reach an unreachable host before it fails (default: 10)",
    )
    parser.add_argument(
        "--lost-after",
        metavar="SECONDS",
        type=_SECONDS,
        default=15.0,
        help="with --until-done: exit with status 4 when a host has been unreachable for this long "
        "(default: 15; with --all: at most 3)",
    )
    _add_journal_options(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per log line")
    parser.add_argument(
        "--engine",
        choices=("auto", "wasm", "reference"),
        default="",
        help="engine that runs the program; auto is the fastest available (default: as in the devices file)",
    )
    _add_key_options(parser)
    add_record_options(parser)
    _add_hidden(parser)


def _add_key_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--keys",
        metavar="DIR",
        type=Path,
        help="directory with the keys of this host, or with one subdirectory for each host",
    )
    parser.add_argument(
        "--lasts",
        metavar="SECONDS",
        type=real_above_0(MAX_SECONDS, "seconds"),
        default=DAY,
        help="maximum duration of the mission: do not start if the keys expire sooner (default: one day)",
    )


def _add_journal_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--state",
        metavar="DIR",
        type=Path,
        help="directory for the journal; with --sim, there is a journal only if this is given",
    )
    parser.add_argument(
        "--volatile",
        action="store_true",
        help="run without a journal: coordinators are lost when the host stops",
    )
    parser.add_argument(
        "--fresh", action="store_true", help="discard the journal of this host, after confirmation"
    )
    parser.add_argument("--yes", action="store_true", help="with --fresh: do not ask for confirmation")
    parser.add_argument(
        "--first-start",
        action="store_true",
        help="this host has never run this mission: start its coordinators without asking the other hosts",
    )


def _add_hidden(parser: argparse.ArgumentParser) -> None:
    # For the processes that `--all` starts: the inherited listening socket, keys and pipe for the result, the
    # control socket, the pipe whose end stops them, and the command that sets up their devices. The second
    # spellings are those of 0.3 and go with 0.5.
    parser.add_argument("--listen-fd", type=_DESCRIPTOR, help=argparse.SUPPRESS)
    parser.add_argument("--keys-fd", type=_DESCRIPTOR, help=argparse.SUPPRESS)
    parser.add_argument("--result-fd", type=_DESCRIPTOR, help=argparse.SUPPRESS)
    parser.add_argument("--control-socket", "--door", default="", help=argparse.SUPPRESS)
    parser.add_argument("--parent-pipe", "--leash", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--setup", default="", help=argparse.SUPPRESS)
    # From the service, so that its host reads no YAML: addresses of the inventory, NAME=ADDR:PORT.
    parser.add_argument("--address", action="append", default=[], help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Run until done or stopped; returns the exit status, 0 if all ended normally."""
    from lfield.text.nonblocking_output import nonblocking_output

    with nonblocking_output("lfield: " if args.all else ""), _refusal_reported(args):
        return _run_mission(mission_path(args), args)


def _run_mission(path: Path, args: argparse.Namespace) -> int:
    from lfield.mission import bundle

    if path.suffix in (".L", ".lb"):
        raise UsageError(f"{path} is a program: name its deployment, {path.with_suffix('.dL')}")
    if path.suffix not in (".dL", bundle.SUFFIX) and path.is_file():
        raise UsageError(f"{path} is neither a deployment (.dL) nor a bundle (.lfm)")
    if path.suffix != bundle.SUFFIX:
        return _run_built(path, args)
    if args.program is not None:
        raise UsageError(f"{path} is a bundle, which has its program: --program is for a deployment")
    return _run(path, args) if args.devices is None else _run_built(path, args)


def _run_built(path: Path, args: argparse.Namespace) -> int:
    """Run a mission from files: its bundle is built, or taken from the build cache."""
    from lfield.mission.build_cache import BuildFailed, BuildRequest, cached_bundle

    try:
        request = BuildRequest(path, args.program, args.devices, simulate=args.sim, as_json=args.json)
        with cached_bundle(request) as file:
            return _run(file, args, built=True)
    except BuildFailed as error:
        return error.status


def _run(file: Path, args: argparse.Namespace, *, built: bool = False) -> int:
    from lfield.mission import bundle
    from lfield.mission.team import parse_maps

    mission = bundle.read(file, args.files)
    # The processes of --all are on loopback, each with the addresses of the others.
    stated = {} if args.all or args.parent_pipe else _stated_addresses(args)
    team = mission.team.at({**stated, **parse_maps(args.map, mission.team)})
    printed = () if built else mission.warnings
    mission = (mission.on_fakes() if args.sim else mission).at(team)
    if not args.parent_pipe:
        for warning in mission.warnings[len(printed) :]:
            print(warning, file=sys.stderr)
    if args.dump is not None and not args.parent_pipe:
        _check_dump_folder(args.dump)
    if args.volatile and args.state is not None:
        raise UsageError(
            "--volatile runs without a journal, and --state names its directory: leave one of them out"
        )
    if args.all:
        if args.first_start:
            raise UsageError("--first-start is for a single host: with --all the hosts query each other")
        if args.fresh:
            raise UsageError("--fresh is for a host on its own: with --all name a new folder with --state")
        from lfield.cli.run.up_all import run_all

        return run_all(mission, file, args, print_line)
    return _run_one(mission, args, stated, built=built)


def _stated_addresses(args: argparse.Namespace) -> Mapping[str, str]:
    """The addresses of hosts, also of other missions: from the service, or from the inventory."""
    if args.address:
        return {name: address for name, _, address in (each.partition("=") for each in args.address)}
    return TeamSelection(inventory=args.inventory).inventory_addresses()


def _check_dump_folder(folder: Path) -> None:
    """Check that the directory for dumps is writable, before any device moves. Raises OutputFileError."""
    from lfield.text.secure_files import private_folder

    if not os.access(private_folder(folder), os.W_OK | os.X_OK):
        raise OutputFileError(str(folder), "nothing may be written there")


def _run_one(mission: Mission, args: argparse.Namespace, stated: Mapping[str, str], *, built: bool) -> int:
    from lfield import event_loop
    from lfield.cli.run.host_keys import built_here, load_credentials
    from lfield.guard.messages import JSON_LOG_HOST
    from lfield.host.process.host_process import run_host
    from lfield.host.process.parent_pipe import set_cloexec_on_all
    from lfield.mission.mission import with_installed_drivers
    from lfield.net.local_addresses import own_host
    from lfield.net.zenoh.config import NETWORK, SECTION_VARIABLE

    set_cloexec_on_all()
    name = mission.team.find_host(args.host) if args.host else own_host(mission.team.hosts, stated)
    NETWORK.select(name, os.environ.pop(SECTION_VARIABLE, ""))
    proof = load_credentials(name, args)
    if proof is not None and built:
        mission = built_here(mission, mission_path(args), args)
    _check_start(mission, name, proof, args)
    if args.json or args.parent_pipe:
        # Inherited by the guards, which log on their own after the end of the host.
        os.environ[JSON_LOG_HOST] = name
    if not _may_start(mission, name, args):
        return exit_status.FAILED
    with (
        _control_socket(mission, name, args) as socket,
        _setup_named(args, name),
        _journal(mission, name, args) as journal,
    ):
        return event_loop.run(
            run_host(
                with_installed_drivers(mission, name),
                name,
                listen=f"fd:{args.listen_fd}" if args.listen_fd is not None else "",
                control_socket=socket,
                dump=args.dump,
                unreachable_after=args.unreachable_after,
                lost_after=args.lost_after if args.until_done else None,
                credentials=proof,
                parent_pipe=args.parent_pipe,
                result_fd=args.result_fd,
                journal=journal,
                first_start=args.first_start,
                engine=args.engine,
                as_json=args.json,
                record=recording_target(mission, args),
            )
        )


@contextmanager
def _refusal_reported(args: argparse.Namespace) -> Iterator[None]:
    """Reports to `--all`, or to the service, the reason why this host cannot start."""
    from lfield.host.process.run_result import RunResult, refusal_reason

    try:
        yield
    except LfieldError as error:
        if args.result_fd is not None:
            RunResult(reason=refusal_reason(error), status=error.exit_status).write(args.result_fd)
        raise


@contextmanager
def _setup_named(args: argparse.Namespace, host: str) -> Iterator[None]:
    """Adds the `lfield setup` command to errors of devices that are not set up."""
    try:
        yield
    except DevicesError as error:
        command = args.setup or setup_command(mission_path(args), host, args.devices)
        raise error.cured_by(command) from None


@contextmanager
def _control_socket(mission: Mission, host: str, args: argparse.Namespace) -> Iterator[str]:
    """The control socket of the host: in its own run, or in that of `--all`.

    Raises OutputFileError if no command would find the run.
    """
    from lfield.operator.runs import publish_run, run_manifest

    if args.parent_pipe:
        yield args.control_socket
        return

    with publish_run(run_manifest(mission, mission_path(args), [host]), print_line) as sockets:
        yield sockets.addresses[host]


def print_line(text: str) -> None:
    """Print a line of the command itself."""
    print(f"lfield: {text}", file=sys.stderr)


@contextmanager
def _journal(mission: Mission, host: str, args: argparse.Namespace) -> Iterator[Journal | None]:
    """The journal of the host; None for --volatile, and for a trial without --state.

    A trial runs on simulated devices, or is `--all` without devices.
    """
    from lfield.clock import SystemClock
    from lfield.journal.file_journal import FileJournal

    if not _keeps_journal(mission, args):
        yield None
        return
    journal = FileJournal(*_journal_place(mission, host, args), print_line, SystemClock())
    try:
        yield journal
    finally:
        journal.close()


def _check_start(
    mission: Mission, host: str, proof: HostCredentials | None, args: argparse.Namespace
) -> None:
    """Check that a host may start before its journal is created or discarded.

    Also check that no host runs here whose folder was moved away: no new journal may replace it. The lock of
    a host with its folder keeps others out. Raises LfieldError.
    """
    from lfield.clock import SystemClock
    from lfield.host.process.credentials import validate_startup
    from lfield.net.local_addresses import require_port_free

    if not _keeps_journal(mission, args):
        return
    is_there = os.path.exists(_journal_place(mission, host, args)[0])
    if args.fresh or not is_there:
        validate_startup(mission, host, proof, SystemClock())
    if proof is not None and args.listen_fd is None and not is_there:
        require_port_free(mission.team.addresses[mission.team.number(host)])


def _keeps_journal(mission: Mission, args: argparse.Namespace) -> bool:
    trial = args.sim or mission.world == "fakes" or (args.parent_pipe and mission.world != "hardware")
    return not (args.volatile or (trial and args.state is None))


def _journal_place(mission: Mission, host: str, args: argparse.Namespace) -> tuple[Path, JournalOwner]:
    from lfield.journal.journal import journal_file
    from lfield.journal.journal_loader import JournalOwner
    from lfield.journal.journal_lock import machine_id

    return journal_file(args.state, mission.name, host), JournalOwner(mission.name, host, machine_id())


def _may_start(mission: Mission, host: str, args: argparse.Namespace) -> bool:
    """Whether the host may start: with --fresh, after its journal was reset. Raises LfieldError."""
    from lfield.cli.run.host_keys import observer_keys
    from lfield.cli.run.journal_reset_prompt import reset_journal

    if args.yes and not args.fresh:
        raise UsageError("--yes is an answer to --fresh")
    if not args.fresh:
        return True
    if not _keeps_journal(mission, args):
        raise UsageError("--fresh is for a host with a journal: this one has none")
    others = {name: address for name, address in mission.team.addresses_by_host.items() if name != host}
    return reset_journal(
        *_journal_place(mission, host, args), others, print_line, observer_keys(host, args), yes=args.yes
    )
