"""`lfield up`: runs one host of a mission here, or all of them as processes of this machine.

It always runs a bundle: the one that is named, or one that is built for it in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_bindings, add_mission, add_program, mission_path, setup_command
from lfield.errors import DevicesError, OutputFileError, UsageError
from lfield.text.numbers import real_above_0, whole_between

#: Seconds that a mission may take that nobody says more of.
DAY = 86400.0
#: The most that anybody may say: no keys last longer.
LONGEST = 36500 * DAY
#: A time to wait for somebody.
_SECONDS = real_above_0(1e6, "seconds")
_DESCRIPTOR = whole_between(0, 1 << 20)

if TYPE_CHECKING:
    from lfield.host.process.proving import Proof
    from lfield.journal.journal import Journal
    from lfield.journal.opening import Owner
    from lfield.mission.mission import Mission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_mission(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--host", metavar="NAME", help="host to run (default: the one named like this computer)"
    )
    where.add_argument("--all", action="store_true", help="run every host on this computer, one process each")
    add_program(parser)
    add_bindings(parser)
    parser.add_argument(
        "--sim", action="store_true", help="bind every device to a simulated one, and start these"
    )
    parser.add_argument(
        "--map",
        metavar="NAME=ADDR:PORT",
        action="append",
        default=[],
        help="address of a host",
    )
    parser.add_argument("--until-done", action="store_true", help="exit when all coordinators have ended")
    parser.add_argument(
        "--dump", metavar="DIR", type=Path, help="write a dump of each agent that fails, for 'lfield inspect'"
    )
    parser.add_argument(
        "--unreachable-after",
        metavar="SECONDS",
        type=_SECONDS,
        help="time-out of a portal call (default: 10)",
    )
    parser.add_argument(
        "--lost-after",
        metavar="SECONDS",
        type=_SECONDS,
        default=15.0,
        help="with --until-done: exit when a host was unreachable for this long (default: 15)",
    )
    _add_kept(parser)
    parser.add_argument(
        "--engine",
        choices=("auto", "wasm", "reference"),
        default="",
        help="engine that runs the program (default: as in the devices file; auto: the fastest available)",
    )
    parser.add_argument(
        "--keys", metavar="DIR", type=Path, help="directory with the keys of this host, or of several hosts"
    )
    parser.add_argument(
        "--lasts",
        metavar="SECONDS",
        type=real_above_0(LONGEST, "seconds"),
        default=DAY,
        help="maximum duration of the mission; keys that expire earlier are refused (default: one day)",
    )
    _add_hidden(parser)


def _add_kept(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--state", metavar="DIR", type=Path, help="directory for the journal; also enables it with --sim"
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
        help="first start ever of this host: start its coordinators without asking the other hosts first",
    )


def _add_hidden(parser: argparse.ArgumentParser) -> None:
    # For processes that `--all` starts: the listening socket and the keys they inherit, the address where
    # commands find them, to end with their parent, and the command that sets up their devices.
    parser.add_argument("--listen-fd", type=_DESCRIPTOR, help=argparse.SUPPRESS)
    parser.add_argument("--keys-fd", type=_DESCRIPTOR, help=argparse.SUPPRESS)
    parser.add_argument("--door", default="", help=argparse.SUPPRESS)
    parser.add_argument("--leash", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--setup", default="", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Run until done or stopped; the status is of exits.py: 0 if all ended normally."""
    from lfield.text.outlet import never_waiting

    with never_waiting("lfield: " if args.all else ""):
        return _run_mission(mission_path(args), args)


def _run_mission(path: Path, args: argparse.Namespace) -> int:
    from lfield.mission import bundle

    if path.suffix in (".L", ".lb"):
        raise UsageError(f"{path} is a program: name its deployment, {path.with_suffix('.dL')}")
    if path.suffix != bundle.SUFFIX:
        return _run_built(path, args)
    if args.program is not None:
        raise UsageError(f"{path} is a bundle, which has its program: --program is for a deployment")
    return _run(path, args) if args.devices is None else _run_built(path, args)


def _run_built(path: Path, args: argparse.Namespace) -> int:
    """Run what is built from files, in a process of its own or before."""
    from lfield.mission.cache import NotBuilt, Order, prepared

    try:
        with prepared(Order(path, args.program, args.devices, simulate=args.sim)) as file:
            return _run(file, args, built=True)
    except NotBuilt as error:
        return error.status


def _run(file: Path, args: argparse.Namespace, *, built: bool = False) -> int:
    from lfield.mission import bundle
    from lfield.mission.team import parse_maps

    mission = bundle.read(file)
    team = mission.team.at(parse_maps(args.map, mission.team))
    told = () if built else mission.warnings
    mission = (mission.on_fakes() if args.sim else mission).at(team)
    if not args.leash:
        for warning in mission.warnings[len(told) :]:
            print(warning, file=sys.stderr)
    if args.dump is not None and not args.leash:
        _look_at_dumps(args.dump)
    if args.volatile and args.state is not None:
        raise UsageError("--volatile keeps nothing, and --state says where: leave one of them out")
    if args.all:
        if args.first_start:
            raise UsageError("--first-start is for a host on its own: with --all every host is heard first")
        if args.fresh:
            raise UsageError("--fresh is for a host on its own: with --all name a new folder with --state")
        from lfield.cli.run.up_all import run_all

        return run_all(mission, file, args, tell)
    return _run_one(mission, args, built=built)


def _look_at_dumps(folder: Path) -> None:
    """See that agents that die can be dumped there, before anything moves. Raises OutputFileError."""
    from lfield.text.private import private_folder

    if not os.access(private_folder(folder), os.W_OK | os.X_OK):
        raise OutputFileError(str(folder), "nothing may be written there")


def _run_one(mission: Mission, args: argparse.Namespace, *, built: bool) -> int:
    from lfield import loop
    from lfield.cli.run.own_keys import built_here, proof_of
    from lfield.host.process.leash import keep_for_oneself
    from lfield.host.process.run import run_host
    from lfield.net.local import own_host

    keep_for_oneself()
    name = mission.team.lookup(args.host) if args.host else own_host(mission.team.hosts)
    proof = proof_of(name, args)
    if proof is not None and built:
        mission = built_here(mission, mission_path(args), args)
    _look_first(mission, name, proof, args)
    if not _ready(mission, name, args):
        return exits.FAILED
    with (
        _door(mission, name, args) as door,
        _setup_named(args, name),
        _journal(mission, name, args) as journal,
    ):
        return loop.run(
            run_host(
                _with_own_drivers(mission, name),
                name,
                listen=f"fd:{args.listen_fd}" if args.listen_fd is not None else "",
                door=door,
                dump=args.dump,
                unreachable_after=args.unreachable_after,
                lost_after=args.lost_after if args.until_done else None,
                proof=proof,
                leash=args.leash,
                journal=journal,
                first_start=args.first_start,
                engine=args.engine,
            )
        )


@contextmanager
def _setup_named(args: argparse.Namespace, host: str) -> Iterator[None]:
    """Devices that are not set up are told with the command that does it."""
    try:
        yield
    except DevicesError as error:
        command = args.setup or setup_command(mission_path(args), host, args.devices)
        raise error.cured_by(command) from None


@contextmanager
def _door(mission: Mission, host: str, args: argparse.Namespace) -> Iterator[str]:
    """Where commands of this computer find the host: in its own run, or in that of `--all`.

    Raises OutputFileError where they would not.
    """
    from lfield.operator.runs import begun, running

    if args.leash:
        yield args.door
        return

    with running(begun(mission, mission_path(args), [host]), tell) as doors:
        yield doors.addresses[host]


def tell(text: str) -> None:
    """A line of the command itself."""
    print(f"lfield: {text}", file=sys.stderr)


@contextmanager
def _journal(mission: Mission, host: str, args: argparse.Namespace) -> Iterator[Journal | None]:
    """Where the host keeps its coordinators; None for --volatile, and where no folder is named for a trial.

    A trial is on fakes, or with --all where nothing is driven.
    """
    from lfield.clock import SystemClock
    from lfield.journal.file import FileJournal

    if not _keeps(mission, args):
        yield None
        return
    journal = FileJournal(*_place(mission, host, args), tell, SystemClock())
    try:
        yield journal
    finally:
        journal.close()


def _look_first(mission: Mission, host: str, proof: Proof | None, args: argparse.Namespace) -> None:
    """See that a host may begin before a journal of it is, or is thrown away: what is refused leaves none.

    And that no host runs here whose folder was moved away: in its place no new journal may be put. One that
    has its folder keeps others out by its lock. Raises LfieldError.
    """
    from lfield.clock import SystemClock
    from lfield.host.process.proving import insist_on_all
    from lfield.net.local import insist_on_free

    if not _keeps(mission, args):
        return
    is_there = os.path.exists(_place(mission, host, args)[0])
    if args.fresh or not is_there:
        insist_on_all(mission, host, proof, SystemClock())
    if proof is not None and args.listen_fd is None and not is_there:
        insist_on_free(mission.team.addresses[mission.team.number(host)])


def _keeps(mission: Mission, args: argparse.Namespace) -> bool:
    trial = args.sim or mission.world == "fakes" or (args.leash and mission.world != "hardware")
    return not (args.volatile or (trial and args.state is None))


def _place(mission: Mission, host: str, args: argparse.Namespace) -> tuple[Path, Owner]:
    """The journal of a host, and whose it is."""
    from lfield.journal.journal import journal_file
    from lfield.journal.opening import Owner
    from lfield.journal.owner import machine_identity

    return journal_file(args.state, mission.name, host), Owner(mission.name, host, machine_identity())


def _ready(mission: Mission, host: str, args: argparse.Namespace) -> bool:
    """Whether the host may start: with --fresh, when what it keeps was thrown away. Raises LfieldError."""
    from lfield.cli.run.fresh import begun_anew
    from lfield.cli.run.own_keys import keys_for_asking

    if args.yes and not args.fresh:
        raise UsageError("--yes is an answer to --fresh")
    if not args.fresh:
        return True
    if not _keeps(mission, args):
        raise UsageError("--fresh is for a host that keeps its coordinators: this one keeps nothing")
    others = {name: address for name, address in mission.team.reached.items() if name != host}
    return begun_anew(*_place(mission, host, args), others, tell, keys_for_asking(host, args), yes=args.yes)


def _with_own_drivers(mission: Mission, host: str) -> Mission:
    """The mission with the drivers of this host's devices as they are installed here."""
    from dataclasses import replace

    from lfield.driver.known import installed_here

    names = {device.driver for device in mission.devices_of(host)}
    return replace(mission, drivers=installed_here(mission.drivers, names))
