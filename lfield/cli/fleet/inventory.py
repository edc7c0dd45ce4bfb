"""`lfield inventory`: shows the hosts of the inventory, and checks which of their addresses answer."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import starmap
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.action_help import action_help
from lfield.cli.fleet.desk import (
    add_desk,
    find_own_keys,
    open_inventory,
    report_missing_files,
)
from lfield.cli.mission_argument import add_inventory
from lfield.client.service_desk import require_hosts
from lfield.errors import AddressError
from lfield.net.transport import split_address
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.inventory.inventory import Inventory, InventoryHost
    from lfield.operator.fleet.address_check import Endpoint, EndpointState, Purpose

#: The result of a check by endpoint.
States = Mapping["Endpoint", "EndpointState"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser(
        "check", **action_help("check which addresses answer, and which host answers there")
    )
    show = actions.add_parser("show", **action_help("show the hosts of the inventory"))
    for each in (check, show):
        each.add_argument("hosts", metavar="HOST", nargs="*", help="hosts (default: all of the inventory)")
    add_desk(check)
    add_inventory(show)
    show.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Returns 0; `check` returns 69 if a host answers at none of its addresses, or another host at one."""
    inventory = open_inventory(args)
    require_hosts(inventory, args.hosts)
    report_missing_files(inventory)
    hosts = [inventory.hosts[name] for name in dict.fromkeys(args.hosts or inventory.hosts)]
    if args.action == "show":
        return _show(inventory, hosts, as_json=args.json)
    return _check(hosts, find_own_keys(args), as_json=args.json)


# --- show -------------------------------------------------------------------------------------------------


def _show(inventory: Inventory, hosts: Sequence[InventoryHost], *, as_json: bool) -> int:
    if as_json:
        rows = {host.name: _host_data(host) for host in hosts}
        print(json.dumps({"inventory": str(inventory.path), "hosts": rows}))
        return exit_status.DONE
    from lfield.cli.views.team_state_view import add_row, new_table
    from lfield.cli.views.trees import plain_console

    table = new_table("HOST", "ADDRESSES", "SERVICE", "SSH", "ARCH", "PYTHON", "GROUPS", "DEVICES", "OPTIONS")
    for host in hosts:
        ssh = f"{host.user}@" * bool(host.user) + host.ssh_hosts[0]
        ssh += f" port {host.ssh_port}" if host.ssh_port else ""
        cells = (", ".join(host.addresses), str(host.service_port), ssh, host.arch, host.python)
        devices = "" if host.devices is None else str(host.devices)
        add_row(table, host.name, *cells, ", ".join(host.groups), devices, " ".join(host.options))
    console = plain_console()
    console.print(escape_line(str(inventory.path)))
    console.print(table)
    return exit_status.DONE


def _host_data(host: InventoryHost) -> dict[str, object]:
    """A host as JSON data."""
    return {
        "addresses": host.addresses,
        "service_addresses": host.service_addresses,
        "user": host.user,
        "ssh_hosts": host.ssh_hosts,
        "ssh_port": host.ssh_port or None,
        "arch": host.arch,
        "python": host.python,
        "groups": host.groups,
        "devices": None if host.devices is None else str(host.devices),
        "options": host.options,
    }


# --- check ------------------------------------------------------------------------------------------------


def _check(hosts: Sequence[InventoryHost], keys: Keys | None, *, as_json: bool) -> int:
    from lfield.operator.fleet.address_check import endpoints_of, is_reached

    states = asyncio.run(_states([each for host in hosts for each in endpoints_of(host)], keys))
    states_by_host = {
        host.name: {e: state for e, state in states.items() if e.host == host.name} for host in hosts
    }
    reached = {host: is_reached(each.values()) for host, each in states_by_host.items()}
    if as_json:
        data = {
            host: {"reached": reached[host], "addresses": [_state_data(*each) for each in own.items()]}
            for host, own in states_by_host.items()
        }
        print(json.dumps(data))
    else:
        _print_states(states, has_keys=keys is not None)
        for line in _summary(
            {host: list(each.values()) for host, each in states_by_host.items() if not reached[host]}
        ):
            print(escape_line(f"lfield: {line}"), file=sys.stderr)
    return exit_status.DONE if all(reached.values()) else exit_status.UNAVAILABLE


async def _states(endpoints: Sequence[Endpoint], keys: Keys | None) -> dict[Endpoint, EndpointState]:
    from lfield.operator.client import observer_transport, presented_crl
    from lfield.operator.fleet.address_check import TIMEOUT, check_endpoints

    transport = None if keys is None else observer_transport(keys, connect_timeout=TIMEOUT)
    return await check_endpoints(endpoints, transport, presented_crl(keys))


def _state_data(endpoint: Endpoint, state: EndpointState) -> dict[str, object]:
    """An address as JSON data."""
    error = {} if state.error is None else state.error.as_data()
    return {
        "for": endpoint.purpose,
        "address": endpoint.address,
        "state": state.outcome,
        "certificate": state.name,
        **error,
    }


def _print_states(states: States, *, has_keys: bool) -> None:
    """A row for each address, then a line for each that is not in its expected state."""
    from lfield.cli.views.team_state_view import add_row, new_table
    from lfield.cli.views.trees import plain_console

    rows: dict[tuple[str, str], dict[Purpose, str]] = {}
    for endpoint, state in states.items():
        cells = rows.setdefault((endpoint.host, split_address(endpoint.address)[0]), {})
        port = split_address(endpoint.address)[1]
        text = f"is {state.name}" if state.outcome == "other-host" else state.outcome
        cells[endpoint.purpose] = f"{port} {text}"
    table = new_table("HOST", "ADDRESS", "SERVICE", "MISSION", "SSH")
    for (host, address), cells in rows.items():
        add_row(table, host, address, *(cells.get(each, "") for each in ("service", "mission", "ssh")))
    console = plain_console()
    console.print(table)
    for line in dict.fromkeys(filter(None, starmap(_finding, states.items()))):
        console.print(escape_line(line))
    if not has_keys:
        print("lfield: certificates were not checked: no keys of yours on this computer", file=sys.stderr)


def _summary(hosts: Mapping[str, Sequence[EndpointState]]) -> Iterator[str]:
    """Sentences about the hosts that do not answer: another one does, they refuse, or there is no answer."""
    refused, missing = [], []
    for host, states in hosts.items():
        others = dict.fromkeys(state.name for state in states if state.outcome == "other-host")
        for other in others:
            yield f"{other} answered at an address of {host}"
        if any(state.outcome == "refused" for state in states):
            refused.append(host)
        elif not others:
            missing.append(host)
    if refused:
        yield f"refused: {listed(refused)}"
    if missing:
        yield f"not reached: {listed(missing)}"


def _finding(endpoint: Endpoint, state: EndpointState) -> str:
    """The line about an address that is not in its expected state; one for all unreachable ports."""
    if state.outcome == "other-host":
        return f"{endpoint.host}: {endpoint.address} is an address of {state.name}: correct the inventory"
    if state.outcome == "closed" and "%" in endpoint.address:
        zone = split_address(endpoint.address)[0].partition("%")[2]
        return (
            f"{endpoint.host}: {endpoint.address}: the zone {zone} is an interface of this computer; the "
            "robot listens there only if its own interface has the same name"
        )
    if state.outcome == "unreachable" and isinstance(state.error, AddressError):
        return f"{endpoint.host}: {split_address(endpoint.address)[0]}: {state.error.reason}"
    return f"{endpoint.host}: {endpoint.address}: {state.error}" if state.outcome == "refused" else ""
