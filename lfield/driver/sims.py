"""Simulated devices ("fakes" in names of code), found by the entry-point group `lfield.sims.v1`.

`python -m lfield.driver.sims package.module:SIM ...` runs a simulated device, as the host does for `--sim`.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from lfield import exit_status
from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import entry_points
from lfield.errors import LfieldError, PluginError
from lfield.text.nonblocking_output import nonblocking_output
from lfield.text.secure_files import open_private_folder
from lfield.text.user_dirs import private_runtime_dir, runtime_dir

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "lfield.sims.v1"
_SOCKET_DIR = "sims"


@runtime_checkable
class Sim(Protocol):
    """One kind of simulated device. Importing its module must not import a vendor library."""

    name: str
    help: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the options of the simulated device to a command line; they include `--listen` and
        `--until-stdin-closes`.
        """

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The options that simulate a bus with these devices, on a free port.

        Devices are named as their bindings are, so that faults can be set by this name.
        """

    def run(self, args: argparse.Namespace) -> int:
        """Serves until SIGINT, SIGTERM or, if requested, the end of stdin; returns the exit status.

        Prints one line when ready: `ready ENDPOINT words...`, ENDPOINT as in a binding.
        """


@runtime_checkable
class SimOnLoop(Sim, Protocol):
    """A simulated device that can run on an existing event loop, for tests of missions."""

    async def serve(self, args: argparse.Namespace) -> None:
        """Serves as `run` does, but only on the loop's time: without a thread, clock or file."""


class Sims(dict[str, Sim]):
    """The installed simulated devices by driver name.

    `references` are their import paths; `problems` has a sentence for each broken one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.references: dict[str, str] = {}
        self.problems: list[str] = []

    def add(self, reference: str) -> None:
        """Adds a simulated device, or records the reason why it is unusable. Raises PluginError on a
        duplicate name.
        """
        try:
            sim = load_sim(reference)
        except PluginError as error:
            self.problems.append(str(error))
            return
        if sim.name in self:
            first = self.references[sim.name]
            raise PluginError(
                f"{first} and {reference} are both the simulated device '{sim.name}'; uninstall one of them"
            )
        self[sim.name], self.references[sim.name] = sim, reference


def discover_sims(entries: Iterable[EntryPoint] | None = None) -> Sims:
    """Every installed simulated device. Raises PluginError on duplicate names."""
    sims = Sims()
    for reference in sorted({entry.value for entry in (entry_points(GROUP) if entries is None else entries)}):
        sims.add(reference)
    return sims


def sims_of(drivers: Collection[str]) -> Sims:
    """The simulated devices of some drivers; others are not imported. Raises PluginError on duplicate names.

    Simulated devices are registered under the names of their drivers; if a driver has none, all are examined.
    """
    entries = entry_points(GROUP)
    sims = discover_sims(entry for entry in entries if entry.name in drivers)
    return sims if sims.keys() >= set(drivers) else discover_sims(entries)


def control_folder() -> Path:
    """The folder for the fault-injection sockets of running simulated devices; created on demand.

    Raises OutputFileError if no folder is protected from other users.
    """
    return private_runtime_dir(_SOCKET_DIR)


def control_sockets() -> list[Path]:
    """The sockets of this user's simulated devices, including those of killed devices."""
    base = runtime_dir()
    with suppress(OSError), open_private_folder(base), open_private_folder(base / _SOCKET_DIR):
        return sorted((base / _SOCKET_DIR).glob("*.sock"))
    return []


def load_sim(reference: str) -> Sim:
    """The simulated device at `package.module:NAME`. Raises PluginError."""
    module, _, name = reference.partition(":")
    try:
        sim = getattr(importlib.import_module(module), name)
    except Exception as error:  # third-party code: an import may raise any exception
        raise PluginError(f"the simulated device '{reference}' cannot be imported: {error}") from error
    if not isinstance(sim, Sim):
        raise PluginError(f"the simulated device '{reference}' is not an lfield.driver.sims.Sim")
    return sim


def main(arguments: Sequence[str]) -> int:
    """Runs the simulated device named by the first argument with the options that follow."""
    if not arguments:
        print("usage: python -m lfield.driver.sims package.module:SIM [options]", file=sys.stderr)
        return exit_status.USAGE
    with nonblocking_output():
        try:
            sim = load_sim(arguments[0])
            parser = argparse.ArgumentParser(prog=f"lfield sim {sim.name}", description=sim.help)
            sim.add_arguments(parser)
            args = parser.parse_args(arguments[1:])
            if args.until_stdin_closes:
                # A service manager signals all processes of a service; hardware would not react.
                for number in (signal.SIGTERM, signal.SIGHUP):
                    signal.signal(number, signal.SIG_IGN)
            return sim.run(args)
        except LfieldError as error:
            print(error, file=sys.stderr)
            return error.exit_status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
