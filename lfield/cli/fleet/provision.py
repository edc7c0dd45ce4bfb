"""`lfield provision`: install lfield on the robots of the inventory, over ssh."""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.fleet.desk import open_inventory
from lfield.client.service_desk import require_hosts
from lfield.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from lfield.cli.views.provision_view import ProvisionView
    from lfield.inventory.inventory import Inventory, InventoryHost
    from lfield.provision.host_provisioning import Robot
    from lfield.provision.installation import RobotFile
    from lfield.provision.wheel_cache import WheelCache


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "hosts", metavar="HOST", nargs="*", help="hosts of the inventory (default: all of them)"
    )
    parser.add_argument(
        "--inventory",
        metavar="FILE",
        type=Path,
        help="hosts and their addresses (default: $LFIELD_INVENTORY, ~/.config/lfield/inventory.yaml)",
    )
    parser.add_argument(
        "--prepare",
        action="store_true",
        help="only collect on this computer what the robots need; provision then needs no internet access",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="print the steps that would be executed, and change no robot"
    )
    parser.add_argument(
        "--wheels",
        metavar="DIR",
        type=Path,
        help="wheels made by hand, which the package index does not have",
    )
    parser.add_argument(
        "--authority",
        metavar="DIR",
        type=Path,
        help="directory of the authority (default: $LFIELD_AUTHORITY, or ~/.config/lfield/authority)",
    )
    parser.add_argument(
        "--replace-keys",
        action="store_true",
        help="also provision robots with keys of another authority or of another host; replaces them",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per step")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when all hosts are provisioned and doctor has found no problem there, 69 otherwise."""
    from lfield import event_loop
    from lfield.cli.views.provision_view import ProvisionView, print_summary
    from lfield.provision.wheel_cache import WheelCache
    from lfield.text.user_dirs import cache_dir

    inventory = open_inventory(args)
    require_hosts(inventory, args.hosts)
    names = list(dict.fromkeys(args.hosts or inventory.hosts))
    keys = _keys(args, names)
    started = time.monotonic()
    has_zenoh = inventory.zenoh is not None or bool(inventory.own_sections)
    cache = WheelCache(cache_dir(), args.wheels, has_zenoh=has_zenoh)
    try:
        with ProvisionView(names, as_json=args.json) as view:
            robots = [_robot(inventory, inventory.hosts[name]) for name in names]
            results = event_loop.run(_provision_all(args, cache, robots, keys, view, str(inventory.path)))
    finally:
        cache.close()
    provisioned = [name for name, is_done in zip(names, results, strict=True) if is_done]
    if not args.json:
        print_summary(names, provisioned, time.monotonic() - started, is_dry=args.dry_run)
    return exit_status.DONE if len(provisioned) == len(names) else exit_status.UNAVAILABLE


async def _provision_all(
    args: argparse.Namespace,
    cache: WheelCache,
    robots: Sequence[Robot],
    keys: Mapping[str, tuple[RobotFile, ...]],
    view: ProvisionView,
    inventory: str,
) -> list[bool]:
    """Provision all hosts in parallel; returns whether each is provisioned."""
    from lfield.provision.host_provisioning import HostProvisioning, ProvisionRun, UpdateGate

    with tempfile.TemporaryDirectory(dir=_socket_parent()) as sockets:
        shared = ProvisionRun(
            cache,
            keys,
            Path(sockets),
            inventory,
            view.on_report,
            replaces_keys=None if args.dry_run else _replacement(args),
            is_dry=args.dry_run,
            only_prepares=args.prepare,
            takes_over=args.replace_keys,
            gate=UpdateGate(robot.name for robot in robots),
        )
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(HostProvisioning(shared, robot, number).provision())
                for number, robot in enumerate(robots)
            ]
        return [task.result() for task in tasks]


def _socket_parent() -> Path:
    """The parent of a folder with sockets of ssh, whose paths may have 90 bytes."""
    from lfield.text.user_dirs import SHARED, private_runtime_dir

    found = private_runtime_dir("ssh")
    return found if len(os.fsencode(found)) <= _MAX_SOCKET_PARENT else SHARED


def _robot(inventory: Inventory, host: InventoryHost) -> Robot:
    from lfield.provision.host_provisioning import Robot
    from lfield.provision.ssh_errors import SshDestination
    from lfield.text.input_files import read_bytes

    destinations = tuple(SshDestination(place, host.user, host.ssh_port) for place in host.ssh_hosts)
    settings = {"inventory.yaml": read_bytes(inventory.path, _MAX_FILE)}
    if host.devices is not None:
        if host.devices.parent != inventory.path.parent.absolute():
            raise UsageError(f"{host.name}: {host.devices} must be in the folder of {inventory.path}")
        settings[host.devices.name] = read_bytes(host.devices, _MAX_FILE)
    files = {file.name: read_bytes(file, _MAX_FILE) for file in host.files}
    return Robot(host.name, destinations, host.arch, host.python, frozenset(host.groups), settings, files)


#: The longest folder below which the paths of sockets fit, in bytes.
_MAX_SOCKET_PARENT = 60
#: An inventory or devices file has fewer bytes.
_MAX_FILE = 4 << 20


def _replacement(args: argparse.Namespace) -> Callable[[str], tuple[RobotFile, ...]]:
    from lfield.provision.team_keys import replaced_keys

    return lambda name: replaced_keys(_authority(args), name, time.time())


def _authority(args: argparse.Namespace) -> Path:
    from lfield.authority.keystore import authority_folder

    return args.authority or authority_folder(os.environ)


def _keys(args: argparse.Namespace, names: Sequence[str]) -> Mapping[str, tuple[RobotFile, ...]]:
    """The keys of the hosts; none if the authority is on another computer. A dry run makes none."""
    from lfield.provision.team_keys import has_authority, planned_keys, team_keys

    folder = _authority(args)
    if args.prepare or not has_authority(folder):
        return {}
    return planned_keys(folder, names) if args.dry_run else team_keys(folder, names, time.time())
