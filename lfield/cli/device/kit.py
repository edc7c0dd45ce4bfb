"""`lfield kit DRIVER --endpoint E`: runs the conformance checks on a real or simulated device."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.confirmation import confirm
from lfield.cli.device.device_argument import add_devices, named_devices, named_driver, setup_command
from lfield.errors import DevicesError
from lfield.text.number_arguments import real_between

if TYPE_CHECKING:
    from lfield.driver.binding import DeviceBinding
    from lfield.driver.kit import Check, Finding

_MARKS = {"passed": "ok     ", "failed": "FAILED ", "not run": "not run"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("driver", metavar="DRIVER", help="driver: mavlink, can, dynamixel, ...")
    add_devices(parser)
    parser.add_argument(
        "--silence",
        type=real_between(0.1, 10.0, "seconds"),
        default=0.2,
        metavar="S",
        help="seconds without a message from the host until the device goes to its safe state (default: 0.2; "
        "use more on a busy computer)",
    )
    parser.add_argument(
        "--yes",
        action="store_true",
        help="do not ask for confirmation before the checks that move the device",
    )
    parser.add_argument(
        "--json", action="store_true", help="print each finding as a JSON object on a separate line"
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0 when no check failed, 1 when one did, 3 when a device was not left safe and at rest."""
    from lfield.clock import SystemClock
    from lfield.devices.conformance_run import END_CHECK, conformance_checks, run_conformance
    from lfield.driver.plugins import discover

    plugins = discover()
    installed = named_driver(args.driver, plugins)
    devices = named_devices(args, installed, plugins)
    checks = conformance_checks(installed)
    may_move = args.yes or _confirmed(checks, devices)
    show = _printer(args.json)
    trying = run_conformance(
        plugins, devices, checks, may_move, show, clock=SystemClock(), silence=args.silence
    )
    try:
        findings = asyncio.run(trying)
    except DevicesError as error:
        raise error.cured_by(setup_command(args)) from None
    if not args.json:
        counts = {outcome: sum(f.outcome == outcome for f in findings) for outcome in _MARKS}
        print(", ".join(f"{count} {outcome}" for outcome, count in counts.items()))
    if any(finding.check == END_CHECK for finding in findings):
        return exit_status.UNSAFE
    return (
        exit_status.FAILED if any(finding.outcome == "failed" for finding in findings) else exit_status.DONE
    )


def _confirmed(checks: Iterable[Check], devices: Iterable[DeviceBinding]) -> bool:
    """Ask for confirmation before a device is opened, except for sensors; without a terminal the answer is
    no.
    """
    names = ", ".join(device.name for device in devices if not device.is_sensor)
    if not (names and sys.stdin.isatty()):
        return not names
    print(f"These checks MOVE {names}: {'; '.join(check.name for check in checks if check.moves)}.")
    return confirm("Type 'yes' if everybody is at a safe distance: ")


def _printer(as_json: bool) -> Callable[[Finding], None]:
    def show(finding: Finding) -> None:
        if as_json:
            fields = {name: getattr(finding, name) for name in ("device", "check", "outcome", "seen")}
            print(json.dumps(fields), flush=True)
        else:
            print(f"{_MARKS[finding.outcome]} {finding.device}: {finding.check}: {finding.seen}", flush=True)

    return show
