"""`lfield doctor`: what stands between this computer and its devices, each with its cure."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_bindings, setup_command

if TYPE_CHECKING:
    from lfield.driver.plugins import Plugins
    from lfield.operator.doctor import Finding

_MARKS = {"ok": "ok      ", "note": "note    ", "warning": "warning ", "problem": "PROBLEM "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "--deploy",
        metavar="MISSION",
        type=Path,
        help="also test every device of this deployment or bundle",
    )
    add_bindings(parser)
    parser.add_argument("--host", metavar="NAME", help="only the devices of this host")


def run(args: argparse.Namespace) -> int:
    """0 when nothing is a problem (notes and warnings are none), 69 otherwise."""
    from lfield import loop
    from lfield.driver.plugins import discover
    from lfield.operator.doctor import system
    from lfield.operator.keys_health import keys_here

    findings: list[Finding] = []

    def told(finding: Finding) -> None:
        findings.append(finding)
        _tell(finding)

    plugins = discover()
    for finding in (*system(plugins), *keys_here(os.environ, time.time())):
        told(finding)
    # On the loop of a host: it is its lateness that is measured.
    loop.run(_look(plugins, told) if args.deploy is None else _try_devices(args, plugins, told))
    return exits.UNAVAILABLE if any(finding.state == "problem" for finding in findings) else exits.DONE


async def _look(plugins: Plugins, told: Callable[[Finding], None]) -> None:
    """Measure against what bindings say by default."""
    from lfield.clock import SystemClock
    from lfield.mission.bindings import Bindings
    from lfield.operator.doctor import drivers, lateness

    for finding in drivers(plugins):
        told(finding)
    told(await lateness(Bindings().silence, SystemClock(), bound=False))


async def _try_devices(args: argparse.Namespace, plugins: Plugins, told: Callable[[Finding], None]) -> None:
    from lfield.clock import SystemClock
    from lfield.driver.known import installed_here
    from lfield.mission.load import open_mission
    from lfield.operator.doctor import drivers, endpoints, lateness

    mission = open_mission(args.deploy, devices=args.devices)
    team = mission.team
    hosts = [team.number(name) for name in ([team.lookup(args.host)] if args.host else team.hosts)]
    devices = mission.bindings.of([member.id for host in hosts for member in team.on(host)])
    used = {device.driver for device in devices}
    for finding in drivers(plugins, used):
        told(finding)
    here = installed_here(mission.drivers, used)
    told(await lateness(mission.bindings.silence, SystemClock(), bound=mission.world == "hardware"))
    setup = setup_command(args.deploy, args.host or "", args.devices)
    await endpoints(here, devices, SystemClock(), told, setup)


def _tell(finding: Finding) -> None:
    print(f"{_MARKS[finding.state]}{finding.what}")
    for detail in finding.details:
        print(f"        {detail}")
    if finding.cure:
        print(f"        -> {finding.cure}")
