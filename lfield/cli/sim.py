"""`lfield sim KIND ...`: a stand-alone fake that speaks a device's real protocol."""

from __future__ import annotations

import argparse
import sys

from lfield.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Every installed fake is a subcommand with its own options."""
    from lfield.driver.sims import discover_sims

    kinds = parser.add_subparsers(dest="kind_of_sim", metavar="KIND")
    for name, sim in sorted(discover_sims().items()):
        sim.add_arguments(kinds.add_parser(name, help=f"a fake for the driver '{name}'"))


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM, SIGINT or the end that the fake's options name."""
    from lfield.driver.sims import discover_sims

    sims = discover_sims()
    if args.kind_of_sim is None:
        raise UsageError(f"which fake? installed: {', '.join(sorted(sims)) or 'none'}")
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # stdout is a text stream here
    return sims[args.kind_of_sim].run(args)
