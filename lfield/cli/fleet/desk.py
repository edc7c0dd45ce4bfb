"""The common parts of the commands of a desk: inventory, keys of the user, requests to all services."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import add_inventory
from lfield.client.service_desk import (
    FleetDesk,
    find_person_keys,
    find_required_inventory,
    is_refusal,
    open_service_desk,
)
from lfield.errors import LfieldError
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.inventory.inventory import Inventory

#: The activity that robots continue after Ctrl-C during a push or a rollback.
VOTE_GOES_ON = "the robots keep what was sent, and complete a vote that has begun within 40 s"


def add_desk(parser: argparse.ArgumentParser) -> None:
    """Declare the inventory, the keys, and --json."""
    add_inventory(parser)
    parser.add_argument(
        "--keys",
        metavar="DIR",
        type=Path,
        help="directory with your keys (default: $LFIELD_KEYS, or ~/.config/lfield/keys/me)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_without(parser: argparse.ArgumentParser, effect: str) -> None:
    """Declare the hosts that a command leaves out."""
    parser.add_argument(
        "--without", metavar="HOST", action="append", default=[], help=f"{effect} (repeatable)"
    )


def open_inventory(args: argparse.Namespace) -> Inventory:
    """The inventory of a command. Raises UsageError without one, ProgramError, InputFileError."""
    return find_required_inventory(args.inventory)


def report_missing_files(inventory: Inventory) -> None:
    """A line on stderr for each file of the inventory that does not exist; on a robot only for its own."""
    from lfield.inventory.location import SYSTEM

    if inventory.path == SYSTEM:
        return
    for host in inventory.hosts.values():
        for file in (*([host.devices] if host.devices else []), *host.files):
            if not file.is_file():
                text = f"{inventory.path} names {file} for {host.name}, which does not exist"
                print(escape_line(f"lfield: {text}"), file=sys.stderr)


def find_own_keys(args: argparse.Namespace) -> Keys | None:
    """The keys of the user, None without any. Raises KeysError."""
    return find_person_keys(args.keys)


def open_desk(args: argparse.Namespace) -> FleetDesk:
    """The desk of a command. Raises UsageError without an inventory, KeysError without keys."""
    report_missing_files(open_inventory(args))
    return open_service_desk(args.inventory, args.keys)


@contextmanager
def explained_interrupt(text: str) -> Iterator[None]:
    """After Ctrl-C, print the activity that the robots continue."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"interrupted: {text}; 'lfield status' shows it", file=sys.stderr)
        raise


def failure_status(errors: Mapping[str, LfieldError]) -> int:
    """The exit status for hosts that have not carried out a request: 69 if one was not reached.

    Else 1 if one has refused it: the same request would be refused again. 0 without errors.
    """
    if not errors:
        return exit_status.DONE
    is_refused = all(map(is_refusal, errors.values()))
    return exit_status.FAILED if is_refused else exit_status.UNAVAILABLE


def report_unreached(errors: Mapping[str, LfieldError], consequence: str) -> None:
    """A line on stderr for each host that did not answer, or has refused the request."""
    for host, error in errors.items():
        outcome = "REFUSED" if is_refusal(error) else "NOT REACHED"
        print(escape_line(f"{host}: {outcome}{consequence}: {error}"), file=sys.stderr)
