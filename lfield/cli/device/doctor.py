"""`lfield doctor`: problems between this computer and its devices, each with a remedy."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import add_bindings, add_mission, mission_path, named_mission, setup_command

if TYPE_CHECKING:
    from lfield.driver.plugins import Plugins
    from lfield.operator.diagnostics import DiagnosticFinding

_MARKS = {"ok": "ok      ", "note": "note    ", "warning": "warning ", "problem": "PROBLEM "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_mission(parser, "check this computer, without the devices of a mission")
    add_bindings(parser)
    parser.add_argument("--host", metavar="NAME", help="only the devices of this host")
    parser.add_argument("--json", action="store_true", help="print one JSON object per finding")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when there is no problem (notes and warnings are none), 69 otherwise."""
    from lfield import event_loop
    from lfield.driver.plugins import discover
    from lfield.operator.diagnostics import system
    from lfield.operator.key_health import local_keys_health

    findings: list[DiagnosticFinding] = []

    def report(finding: DiagnosticFinding) -> None:
        findings.append(finding)
        if args.json:
            print(json.dumps(finding.as_data()), flush=True)
        else:
            _print_finding(finding)

    plugins = discover()
    for finding in (*system(plugins), *local_keys_health(os.environ, time.time())):
        report(finding)
    # On the loop of a host, whose lateness is measured.
    event_loop.run(
        _check_system(plugins, report)
        if named_mission(args) is None
        else _check_devices(args, plugins, report)
    )
    return (
        exit_status.UNAVAILABLE
        if any(finding.state == "problem" for finding in findings)
        else exit_status.DONE
    )


async def _check_system(plugins: Plugins, on_finding: Callable[[DiagnosticFinding], None]) -> None:
    """Measure against the default silence of bindings."""
    from lfield.clock import SystemClock
    from lfield.mission.bindings import Bindings
    from lfield.operator.diagnostics import drivers, scheduling_lateness

    for finding in drivers(plugins):
        on_finding(finding)
    on_finding(await scheduling_lateness(Bindings().silence, SystemClock(), bound=False))


async def _check_devices(
    args: argparse.Namespace, plugins: Plugins, on_finding: Callable[[DiagnosticFinding], None]
) -> None:
    from lfield.clock import SystemClock
    from lfield.driver.driver_index import installed_drivers
    from lfield.mission.loader import open_mission
    from lfield.operator.diagnostics import drivers, endpoints, scheduling_lateness

    path = mission_path(args)
    mission = open_mission(path, devices=args.devices)
    team = mission.team
    hosts = [team.number(name) for name in ([team.find_host(args.host)] if args.host else team.hosts)]
    devices = mission.bindings.of([member.id for host in hosts for member in team.members_on(host)])
    used = {device.driver for device in devices}
    for finding in drivers(plugins, used):
        on_finding(finding)
    used_drivers = installed_drivers(mission.drivers, used)
    on_finding(
        await scheduling_lateness(mission.bindings.silence, SystemClock(), bound=mission.world == "hardware")
    )
    setup = setup_command(path, args.host or "", args.devices)
    await endpoints(used_drivers, devices, SystemClock(), on_finding, setup)


def _print_finding(finding: DiagnosticFinding) -> None:
    print(f"{_MARKS[finding.state]}{finding.what}")
    for detail in finding.details:
        print(f"        {detail}")
    if finding.cure:
        print(f"        -> {finding.cure}")
