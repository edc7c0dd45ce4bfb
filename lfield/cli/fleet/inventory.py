"""`lfield inventory`: shows the hosts of the inventory, and checks which of their addresses answer."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.action_help import action_help
from lfield.cli.fleet.desk import add_desk, open_inventory
from lfield.cli.mission_argument import add_inventory
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.inventory.inventory import Inventory, InventoryHost
    from lfield.net.transport import Transport
    from lfield.operator.fleet.address_check import HostCheck, PortCheck

#: Seconds for an answer.
TIMEOUT = 3.0
#: The default port of ssh.
SSH_PORT = 22


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser(
        "check", **action_help("check which addresses answer, and whether the right host answers there")
    )
    check.add_argument("hosts", metavar="HOST", nargs="*", help="hosts (default: all of the inventory)")
    add_desk(check)
    show = actions.add_parser("show", **action_help("print the hosts with all addresses and defaults"))
    add_inventory(show)
    show.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """0; for check 69 when a host has no address that answers."""
    inventory = open_inventory(args)
    if args.action == "show":
        _show(inventory, as_json=args.json)
        return exit_status.DONE
    hosts = [inventory.host(name) for name in args.hosts or inventory.hosts]
    checks = asyncio.run(_check(hosts, args.keys))
    if args.json:
        print(
            json.dumps({name: {"answers": found.answers, **asdict(found)} for name, found in checks.items()})
        )
    else:
        _print_checks(checks)
    return exit_status.DONE if all(found.answers for found in checks.values()) else exit_status.UNAVAILABLE


async def _check(hosts: list[InventoryHost], keys: Path | None) -> Mapping[str, HostCheck]:
    from lfield.authority import keystore
    from lfield.operator.client import observer_transport

    folder = keystore.find_keys("person", keystore.OWN, keys, os.environ)
    own = keystore.read_keys(folder, "person") if folder is not None else None
    transport = observer_transport(own, connect_timeout=TIMEOUT)
    found = await asyncio.gather(*(_check_host(transport, host) for host in hosts))
    return {host.name: check for host, check in zip(hosts, found, strict=True)}


async def _check_host(transport: Transport, host: InventoryHost) -> HostCheck:
    from lfield.net.transport import join_address
    from lfield.operator.fleet.address_check import HostCheck, check_tcp, check_tls

    ssh = [join_address(name, host.ssh_port or SSH_PORT) for name in host.ssh_hosts]
    return HostCheck(
        *await asyncio.gather(
            check_tls(transport, host.addresses, host.name),
            check_tls(transport, host.service_addresses, host.name),
            check_tcp(ssh, TIMEOUT),
        )
    )


def _print_checks(checks: Mapping[str, HostCheck]) -> None:
    from lfield.cli.views.team_state_view import new_table
    from lfield.cli.views.trees import plain_console

    table = new_table("host", "port", "address", "state")
    for name, found in checks.items():
        for kind, ports in (("mission", found.mission), ("service", found.service), ("ssh", found.ssh)):
            for port in ports:
                table.add_row(*map(escape_line, (name, kind, port.address, _state(port))))
    console = plain_console()
    console.print(table)
    for name, found in checks.items():
        if not found.answers:
            console.print(escape_line(f"{name}: NO ADDRESS ANSWERS"))


def _state(port: PortCheck) -> str:
    if port.state == "unverified":
        return "answers; not verified, since there are no keys of yours here"
    return port.text or port.state


def _show(inventory: Inventory, *, as_json: bool) -> None:
    from lfield.cli.views.team_state_view import new_table
    from lfield.cli.views.trees import plain_console

    if as_json:
        hosts = {name: asdict(host) for name, host in inventory.hosts.items()}
        print(json.dumps({"file": str(inventory.path), "hosts": hosts}, default=str))
        return
    table = new_table("host", "mission", "service", "ssh", "arch", "python")
    for name, host in inventory.hosts.items():
        user = f"{host.user}@" if host.user else ""
        port = f" port {host.ssh_port}" if host.ssh_port else ""
        ssh = f"{user}{' '.join(host.ssh_hosts)}{port}"
        row = (name, " ".join(host.addresses), " ".join(host.service_addresses), ssh, host.arch, host.python)
        table.add_row(*map(escape_line, row))
    console = plain_console()
    console.print(escape_line(str(inventory.path)))
    console.print(table)
