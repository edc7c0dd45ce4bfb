"""`lfield doctor`: what stands between this computer and its devices, each with its cure."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfield.operator.doctor import Finding

_MARKS = {"ok": "ok      ", "warning": "warning ", "problem": "PROBLEM "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "--deploy", metavar="MISSION", type=Path, help="also try every device of this deployment or bundle"
    )
    parser.add_argument(
        "--devices", metavar="FILE", type=Path, help="the bindings, if not beside the deployment"
    )
    parser.add_argument("--host", metavar="NAME", help="only the devices of this host of the deployment")


def run(args: argparse.Namespace) -> int:
    """0 when nothing is a problem (warnings are none), 69 otherwise."""
    from lfield.driver.plugins import discover
    from lfield.operator.doctor import system

    plugins = discover()
    findings = []
    for finding in system(plugins):
        findings.append(finding)
        _tell(finding)
    if args.deploy is not None:
        findings += asyncio.run(_try_devices(args))
    return 69 if any(finding.state == "problem" for finding in findings) else 0


async def _try_devices(args: argparse.Namespace) -> list[Finding]:
    from lfield.clock import SystemClock
    from lfield.driver.known import installed_here
    from lfield.mission.load import open_mission
    from lfield.operator.doctor import endpoints

    mission = open_mission(args.deploy, devices=args.devices)
    team = mission.team
    hosts = [team.number(name) for name in ([team.lookup(args.host)] if args.host else team.hosts)]
    devices = mission.bindings.of([member.id for host in hosts for member in team.on(host)])
    drivers = installed_here(mission.drivers, {device.driver for device in devices})
    findings: list[Finding] = []

    def told(finding: Finding) -> None:
        findings.append(finding)
        _tell(finding)

    await endpoints(drivers, devices, SystemClock(), told)
    return findings


def _tell(finding: Finding) -> None:
    print(f"{_MARKS[finding.state]}{finding.what}")
    if finding.cure:
        print(f"        -> {finding.cure}")
