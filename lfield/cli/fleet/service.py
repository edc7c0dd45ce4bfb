"""`lfield service`: the permanent service of one robot, started by its systemd unit."""

from __future__ import annotations

import argparse
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import __version__, exit_status
from lfield.errors import KeysError, UsageError
from lfield.text.suggestions import did_you_mean, listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.inventory.inventory import Inventory, InventoryHost

#: Options of `lfield up` for the mission's host: it ends with the mission, and waits for hosts that restart.
UP_OPTIONS = ("--until-done", "--lost-after", "300")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--host", metavar="NAME", required=True, help="name of this robot in the inventory")
    parser.add_argument(
        "--inventory",
        metavar="FILE",
        type=Path,
        help="hosts and their addresses (default: $LFIELD_INVENTORY, /etc/lfield/inventory.yaml)",
    )
    parser.add_argument("--keys", metavar="DIR", type=Path, help="directory with the keys of this host")
    parser.add_argument(
        "--state",
        metavar="DIR",
        type=Path,
        help="directory for bundles and journals (default: $STATE_DIRECTORY, which systemd sets)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per log line")
    parser.add_argument(
        "--check",
        action="store_true",
        help="only print the reasons against an update of lfield: unfinished coordinators, an open vote",
    )
    parser.add_argument(
        "--up-options",
        metavar="OPTIONS",
        default=os.environ.get("LFIELD_UP_OPTIONS", ""),
        help="further options of 'lfield up' for the mission's host, as one argument: --up-options='--sim' "
        f"(default: $LFIELD_UP_OPTIONS; always: {' '.join(UP_OPTIONS)})",
    )


def run(args: argparse.Namespace) -> int:
    """Run until stopped; returns 0, or 69 when it cannot listen. With --check 1 when an update is
    forbidden.
    """
    from lfield import event_loop
    from lfield.authority import keystore
    from lfield.host.process.credentials import HostCredentials
    from lfield.inventory.location import find_inventory
    from lfield.net.zenoh.config import NETWORK, SECTION_VARIABLE
    from lfield.service.service_process import ServiceOptions, run_service
    from lfield.service.version_state import versioned_state
    from lfield.text.user_dirs import state_dir

    if args.check:
        return _check(args)
    inventory = find_inventory(args.inventory, os.environ)
    if inventory is None:
        raise UsageError("no inventory: 'lfield provision' puts it to /etc/lfield/inventory.yaml")
    host = _own_entry(inventory, args.host)
    keys_folder = keystore.find_keys("host", args.host, args.keys, os.environ)
    if keys_folder is None:
        raise KeysError(
            f"{args.host} has no keys: 'lfield provision {args.host}' makes and copies them, or name their "
            "directory with --keys"
        )
    NETWORK.select(args.host)
    if NETWORK.config is not None:
        os.environ[SECTION_VARIABLE] = NETWORK.config.encode()
    # The next service finds a running host by the path in the command line of the host.
    state = versioned_state(args.state or state_dir(), __version__).absolute()
    folders = [keys_folder, state / "keys" / keystore.entry_name(args.host)]
    peers = {name: each.service_address for name, each in inventory.hosts.items() if name != args.host}
    files = inventory.path.absolute().parent
    up_options = _up_options(args, inventory, state)
    options = ServiceOptions(args.host, state, files, host.service_address, peers, up_options, args.json)
    credentials = HostCredentials(keystore.read_keys(keys_folder, "host"), folders)
    return event_loop.run(run_service(options, credentials))


def _check(args: argparse.Namespace) -> int:
    """Print the reasons against an update of lfield; returns the exit status."""
    import asyncio

    from lfield.clock import SystemClock
    from lfield.service.bundle_store import BundleStore
    from lfield.service.mission_probe import LocalProbe
    from lfield.service.version_state import versioned_state
    from lfield.text.user_dirs import state_dir

    state = versioned_state(args.state or state_dir(), __version__)
    bound = BundleStore(state / "service").load().activation.open_ballot
    if bound is not None:
        missing = listed(bound.missing)
        print(escape_line(f"an activation has no result yet: the votes of {missing} are unknown"))
    probe = LocalProbe(args.host, state, lambda: 0, list, SystemClock())
    unfinished = asyncio.run(probe.unfinished())
    for coordinator in unfinished:
        print(
            escape_line(
                f"coordinator {coordinator.agent} of {coordinator.mission} has not ended: {coordinator.state}"
            )
        )
    return exit_status.FAILED if unfinished or bound is not None else exit_status.DONE


def _own_entry(inventory: Inventory, host: str) -> InventoryHost:
    """The entry of this robot. Raises UsageError."""
    if host not in inventory.hosts:
        hint = did_you_mean(host, inventory.hosts) or f"it has {listed(list(inventory.hosts))}"
        raise UsageError(f"the inventory {inventory.path} has no host '{host}': {hint}")
    return inventory.hosts[host]


def _up_options(args: argparse.Namespace, inventory: Inventory, state: Path) -> list[str]:
    """The options of the mission's host: the addresses of the others, its keys, and its own devices file."""
    found = [*UP_OPTIONS, f"--state={state}", f"--files={inventory.path.absolute().parent}"]
    # A host does not read YAML.
    found += [f"--address={name}={host.address}" for name, host in inventory.hosts.items()]
    if args.keys is not None:
        found.append(f"--keys={args.keys}")
    devices = inventory.hosts[args.host].devices
    if devices is not None:
        found.append(f"--devices={devices}")
    return [*found, *inventory.hosts[args.host].options, *shlex.split(args.up_options)]
