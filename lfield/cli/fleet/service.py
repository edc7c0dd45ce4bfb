"""`lfield service`: the permanent service of one robot, started by its systemd unit."""

from __future__ import annotations

import argparse
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import __version__
from lfield.errors import KeysError, UsageError

if TYPE_CHECKING:
    from lfield.inventory.inventory import Inventory

#: Options of `lfield up` for the mission's host: it ends with the mission, and waits for hosts that restart.
UP_OPTIONS = ("--until-done", "--lost-after", "300")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("--host", metavar="NAME", required=True, help="name of this robot in the inventory")
    parser.add_argument(
        "--inventory",
        metavar="FILE",
        type=Path,
        help="hosts and their addresses (default: $LFIELD_INVENTORY, /etc/lfield/inventory.yaml)",
    )
    parser.add_argument("--keys", metavar="DIR", type=Path, help="directory with the keys of this host")
    parser.add_argument(
        "--state", metavar="DIR", type=Path, help="directory for bundles and journals (default: the unit's)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per log line")
    parser.add_argument(
        "--up-options",
        metavar="OPTIONS",
        default=os.environ.get("LFIELD_UP_OPTIONS", ""),
        help="further options of 'lfield up' for the mission's host, as one text (default: "
        f"$LFIELD_UP_OPTIONS; always: {' '.join(UP_OPTIONS)})",
    )


def run(args: argparse.Namespace) -> int:
    """Run until it is stopped; 0, or 69 when it cannot listen."""
    from lfield import event_loop
    from lfield.authority import keystore
    from lfield.host.process.credentials import HostCredentials
    from lfield.inventory.inventory_file import find_inventory
    from lfield.service.service_process import ServiceOptions, run_service
    from lfield.service.version_state import versioned_state
    from lfield.text.user_dirs import state_dir

    inventory = find_inventory(args.inventory, os.environ)
    if inventory is None:
        raise UsageError("no inventory: 'lfield provision' puts it to /etc/lfield/inventory.yaml")
    host = inventory.host(args.host)
    found = keystore.find_keys("host", args.host, args.keys, os.environ)
    if found is None:
        raise KeysError(
            f"{args.host} has no keys: 'lfield provision {args.host}' makes and copies them, or name their "
            "directory with --keys"
        )
    state = versioned_state(args.state or state_dir(), __version__)
    folders = [found, state / "keys" / keystore.entry_name(args.host)]
    peers = {name: each.service_address for name, each in inventory.hosts.items() if name != args.host}
    options = ServiceOptions(
        args.host, state, host.service_address, peers, _up_options(args, inventory, state), args.json
    )
    credentials = HostCredentials(keystore.read_keys(found, "host"), folders)
    return event_loop.run(run_service(options, credentials))


def _up_options(args: argparse.Namespace, inventory: Inventory, state: Path) -> list[str]:
    """The options of the mission's host: where the others are, its keys, and its own devices file."""
    found = [*UP_OPTIONS, f"--state={state}", f"--inventory={inventory.path.absolute()}"]
    if args.keys is not None:
        found.append(f"--keys={args.keys}")
    devices = inventory.hosts[args.host].devices
    if devices is not None:
        found.append(f"--devices={devices}")
    return [*found, *shlex.split(args.up_options)]
