"""`lfield setup`: writes what devices must keep for their bindings, after a yes; `--back` puts back what was.

It commands no motion. What was there is on the disk before anything is written, and what is there now is read
before anything is put back.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.robot.device_argument import add_devices, named_devices, named_driver
from lfield.cli.yes import says_yes
from lfield.errors import DevicesError, UsageError

if TYPE_CHECKING:
    from lfield.devices.kept import Kept
    from lfield.devices.setup import Found
    from lfield.driver.binding import DeviceBinding
    from lfield.driver.known import Drivers
    from lfield.driver.plugins import Plugins


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "driver", metavar="DRIVER", nargs="?", default="", help="driver, to set up a single device"
    )
    parser.add_argument(
        "--deploy", metavar="MISSION", type=Path, help="set up the devices of this deployment or bundle"
    )
    parser.add_argument("--host", metavar="NAME", help="only the devices of this host")
    add_devices(parser)
    parser.add_argument(
        "--sim", action="store_true", help="use the simulated devices of the deployment, as a trial"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask for confirmation")
    parser.add_argument("--back", action="store_true", help="restore the old parameters")
    parser.add_argument("--state", metavar="DIR", type=Path, help="directory with the old parameters")


def run(args: argparse.Namespace) -> int:
    """0 when all is as it must be, 1 when nobody agreed to it."""
    from lfield import loop
    from lfield.devices.kept import Kept, kept_file
    from lfield.driver.plugins import discover

    if bool(args.driver) and args.deploy is not None:
        raise UsageError("name a mission by --deploy, or a driver; not both")
    plugins, kept = discover(), Kept(kept_file(args.state))
    if args.back:
        return loop.run(_back(args, plugins, kept))
    if not args.driver and args.deploy is None:
        raise UsageError("whose devices? give --deploy MISSION, or DRIVER --endpoint E")
    drivers, devices = _meant(args, plugins)
    return loop.run(_set_up(args, drivers, devices, kept))


def _meant(args: argparse.Namespace, plugins: Plugins) -> tuple[Drivers, list[DeviceBinding]]:
    """The devices that were named, and the drivers to reach them by."""
    from lfield.driver.known import installed_here
    from lfield.mission.load import open_mission

    if args.driver:
        if args.sim or args.host:
            raise UsageError("--sim and --host are for the devices of a mission: name it by --deploy")
        return plugins, named_devices(args, named_driver(args.driver, plugins), plugins)
    if args.endpoint or args.type or args.settings:
        raise UsageError("--endpoint, --type and --set are for one device: name its driver")
    mission = open_mission(args.deploy, devices=args.devices)
    mission = mission.on_fakes() if args.sim else mission
    hosts = [mission.team.lookup(args.host)] if args.host else mission.team.hosts
    devices = [device for host in hosts for device in mission.devices_of(host)]
    return installed_here(mission.drivers, {device.driver for device in devices}), devices


async def _set_up(
    args: argparse.Namespace, drivers: Drivers, devices: Sequence[DeviceBinding], kept: Kept
) -> int:
    from lfield.clock import SystemClock
    from lfield.devices.setup import reached, set_up

    async with _placed(devices) as placed, reached(drivers, placed, SystemClock(), _tell) as found:
        if not any(each.wrong for each in found):
            print("nothing to do: every device keeps what its binding needs")
            return exits.DONE
        _show(found)
        if args.sim:
            print("nothing was written: a fake forgets it when it ends")
            return exits.FAILED
        if not (args.yes or _agreed()):
            print("nothing was written")
            return exits.FAILED
        now = datetime.now().astimezone().isoformat(" ", "seconds")
        await set_up(found, kept, now, _tell)
        print("done: every device keeps what its binding needs")
    return exits.DONE


async def _back(args: argparse.Namespace, plugins: Plugins, kept: Kept) -> int:
    from lfield.clock import SystemClock
    from lfield.devices.back import look_back, put_back

    named = bool(args.driver) or args.deploy is not None
    meant = {(d.driver, d.endpoint) for d in _meant(args, plugins)[1]} if named else None
    entries = [entry for entry in kept.entries() if meant is None or entry.binding.bus in meant]
    if not entries:
        print(f"nothing to put back: {kept.path} has nothing of these devices")
        return exits.DONE
    for driver in {entry.binding.driver for entry in entries}:
        named_driver(driver, plugins)
    steps, problems = await look_back(entries, plugins, SystemClock(), _tell)
    for step in steps:
        print(*step.lines(), sep="\n")
    if any(step.needs_yes for step in steps) and not (args.yes or _agreed()):
        print("nothing was written")
        return exits.FAILED
    problems += await put_back(steps, kept, plugins, SystemClock(), _tell)
    if problems:
        raise DevicesError(problems)
    print("done: all is as it was before")
    return exits.DONE


@asynccontextmanager
async def _placed(devices: Sequence[DeviceBinding]) -> AsyncIterator[list[DeviceBinding]]:
    """The devices, those of a simulated mission on fakes that run as long as the block."""
    from lfield.devices.fakes import Fake, on_running_fakes

    running, problems = list[Fake](), list[str]()
    try:
        placed = await on_running_fakes(devices, running, problems)
        if problems:
            raise DevicesError(problems)
        yield placed
    finally:
        for fake in running:
            await fake.stop()


def _show(found: Sequence[Found]) -> None:
    from rich.table import Table

    from lfield.cli.views.trees import plain_console

    shown = Table(box=None, pad_edge=False)
    for column in ("DEVICE", "SETTING", "IS", "MUST BE", "WHY"):
        shown.add_column(column, overflow="fold")
    for each in found:
        for setting in each.wrong:
            values = (f"{setting.present:.9g}", f"{setting.wanted:.9g}")
            shown.add_row(each.name, setting.name, *values, setting.why)
    plain_console().print(shown)


def _agreed() -> bool:
    """Ask; whoever cannot be asked has not agreed. Raises UsageError then."""
    if not sys.stdin.isatty():
        raise UsageError("nothing was written: nobody can be asked here; add --yes if that is to be written")
    return says_yes("Type 'yes' to write that: ")


def _tell(line: str) -> None:
    print(line, flush=True)
