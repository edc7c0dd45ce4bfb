"""Fakes: the other end of the wire, found by the entry-point group `lfield.sims.v1`.

`python -m lfield.driver.sims package.module:SIM ...` runs one, as the host does for `--sim`.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from lfield import exits
from lfield.driver.binding import DeviceBinding
from lfield.errors import LfieldError, PluginError
from lfield.text.outlet import never_waiting
from lfield.text.own_folders import own_place, own_places

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "lfield.sims.v1"
_DOORS = "lfield-sims"


@runtime_checkable
class Sim(Protocol):
    """One kind of fake. Importing its module must not import a vendor library."""

    name: str
    help: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add its options to a command line; they include `--listen` and `--until-stdin-closes`."""

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The options that make it the bus with these devices, on a free port.

        They name each device as its binding does, so that its faults can be set by that name.
        """

    def run(self, args: argparse.Namespace) -> int:
        """Serve until SIGINT, SIGTERM or, if asked, the end of stdin and nothing less; the exit status.

        Prints one line when ready: `ready ENDPOINT words...`, ENDPOINT as a binding would have it.
        """


@runtime_checkable
class SimOnLoop(Sim, Protocol):
    """A fake that can serve on a loop that runs already: so it can stand in a mission's test too."""

    async def serve(self, args: argparse.Namespace) -> None:
        """As `run`, with the loop's time only: no thread, no clock and no file of the computer."""


class Sims(dict[str, Sim]):
    """The fakes that are installed, by driver name.

    `references` are how another process imports them; `problems` has a sentence for each broken one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.references: dict[str, str] = {}
        self.problems: list[str] = []

    def add(self, reference: str) -> None:
        """Take a fake in, or note why it cannot be. Raises PluginError on a duplicate name."""
        try:
            sim = load_sim(reference)
        except PluginError as error:
            self.problems.append(str(error))
            return
        if sim.name in self:
            rival = self.references[sim.name]
            raise PluginError(
                f"{rival} and {reference} are both the fake '{sim.name}'; uninstall one of them"
            )
        self[sim.name], self.references[sim.name] = sim, reference


def discover_sims(entries: Iterable[EntryPoint] | None = None) -> Sims:
    """Every installed fake. Raises PluginError on duplicate names."""
    sims = Sims()
    for reference in sorted({entry.value for entry in (installed() if entries is None else entries)}):
        sims.add(reference)
    return sims


def installed() -> list[EntryPoint]:
    """How the installed fakes announce themselves."""
    # Here, since a host without fakes has no use for it, and it takes a while to load.
    from importlib.metadata import entry_points

    return list(entry_points(group=GROUP))


def sims_of(drivers: Collection[str]) -> Sims:
    """The fakes of some drivers, the others not even imported. Raises PluginError on duplicate names.

    Fakes are announced under the names of their drivers; where one is not, all are looked at.
    """
    entries = installed()
    sims = discover_sims(entry for entry in entries if entry.name in drivers)
    return sims if sims.keys() >= set(drivers) else discover_sims(entries)


def control_folder() -> Path:
    """Where a running fake has the socket at which its faults are set; made on demand.

    Raises OutputFileError when there is none where others could not put theirs.
    """
    return own_place(_DOORS)


def control_doors() -> list[Path]:
    """The sockets of this user's fakes, also of those that were killed."""
    return sorted(door for folder in own_places(_DOORS) for door in folder.glob("*.sock"))


def load_sim(reference: str) -> Sim:
    """The fake at `package.module:NAME`. Raises PluginError."""
    module, _, name = reference.partition(":")
    try:
        sim = getattr(importlib.import_module(module), name)
    except Exception as error:  # a plugin is foreign code: whatever it raises on import is its fault
        raise PluginError(f"the fake '{reference}' cannot be imported: {error}") from error
    if not isinstance(sim, Sim):
        raise PluginError(f"the fake '{reference}' is not a lfield.driver.sims.Sim")
    return sim


def main(arguments: Sequence[str]) -> int:
    """Run the fake named by the first argument with the options that follow."""
    if not arguments:
        print("usage: python -m lfield.driver.sims package.module:SIM [options]", file=sys.stderr)
        return exits.USAGE
    with never_waiting():
        try:
            sim = load_sim(arguments[0])
            parser = argparse.ArgumentParser(prog=f"lfield sim {sim.name}", description=sim.help)
            sim.add_arguments(parser)
            args = parser.parse_args(arguments[1:])
            if args.until_stdin_closes:
                # A service manager signals all processes of a service; hardware would not hear it.
                for number in (signal.SIGTERM, signal.SIGHUP):
                    signal.signal(number, signal.SIG_IGN)
            return sim.run(args)
        except LfieldError as error:
            print(error, file=sys.stderr)
            return error.exit_status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
