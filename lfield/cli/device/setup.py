"""`lfield setup`: writes the settings that bindings need to their devices, after a confirmation.

The command causes no motion. The old values are in a file before new ones are written; `--apply FILE`
restores them. With a parameter file of a ground station, `--apply` writes its values instead.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.confirmation import confirm
from lfield.cli.device.device_argument import add_devices, named_devices, named_driver
from lfield.errors import DevicesError, UsageError

if TYPE_CHECKING:
    from lfield.devices.device_setup import FoundDevice
    from lfield.devices.parameter_backup import BackupEntry
    from lfield.driver.binding import DeviceBinding
    from lfield.driver.driver_index import DriverLookup
    from lfield.driver.plugins import Plugins


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "driver",
        metavar="DRIVER",
        nargs="?",
        default="",
        help="driver of the device, to set up one device without a mission",
    )
    parser.add_argument(
        "--deploy", metavar="MISSION", type=Path, help="set up the devices of this deployment or bundle"
    )
    parser.add_argument("--host", metavar="NAME", help="only the devices of this host")
    add_devices(parser)
    parser.add_argument("--sim", action="store_true", help="use simulated devices")
    parser.add_argument("--yes", action="store_true", help="do not ask for confirmation")
    parser.add_argument(
        "--apply",
        metavar="FILE",
        type=Path,
        help="restore the old parameters from this file, or write a parameter file of a ground station "
        "(.param, .params) into the one device that is named",
    )
    # The newest file: the option of lfield 0.3.
    parser.add_argument("--back", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(
        "--state", metavar="DIR", type=Path, help="directory in which the old parameters are saved"
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0 when the parameters are as required, 1 without confirmation."""
    from lfield import event_loop
    from lfield.devices.parameter_backup import backup_folder, newest_backup, read_backup
    from lfield.driver.plugins import discover

    if bool(args.driver) and args.deploy is not None:
        raise UsageError("name a mission by --deploy, or a driver; not both")
    plugins, file = discover(), args.apply
    if args.back and file is None:
        file = newest_backup(backup_folder(args.state))
        if file is None:
            print(f"nothing to restore: {backup_folder(args.state)} has no file of 'lfield setup'")
            return exit_status.DONE
    if file is not None and _is_parameter_file(file):
        return event_loop.run(_write_file(args, plugins, file))
    if file is not None:
        return event_loop.run(_restore(args, plugins, read_backup(file)))
    if not args.driver and args.deploy is None:
        raise UsageError("no devices given: give --deploy MISSION, or DRIVER --endpoint E")
    drivers, devices = _selected(args, plugins)
    return event_loop.run(_set_up(args, drivers, devices, backup_folder(args.state)))


def _selected(args: argparse.Namespace, plugins: Plugins) -> tuple[DriverLookup, list[DeviceBinding]]:
    """The named devices, and the drivers to reach them by."""
    from lfield.driver.driver_index import installed_drivers
    from lfield.mission.loader import open_mission

    if args.driver:
        if args.sim or args.host:
            raise UsageError("--sim and --host are for the devices of a mission: name it by --deploy")
        return plugins, named_devices(args, named_driver(args.driver, plugins), plugins)
    if args.endpoint or args.type or args.settings:
        raise UsageError("--endpoint, --type and --set are for one device: name its driver")
    mission = open_mission(args.deploy, devices=args.devices)
    mission = mission.on_fakes() if args.sim else mission
    hosts = [mission.team.find_host(args.host)] if args.host else mission.team.hosts
    devices = [device for host in hosts for device in mission.devices_of(host)]
    return installed_drivers(mission.drivers, {device.driver for device in devices}), devices


async def _set_up(
    args: argparse.Namespace, drivers: DriverLookup, devices: Sequence[DeviceBinding], folder: Path
) -> int:
    from lfield.clock import SystemClock
    from lfield.devices.device_setup import open_devices, write_settings

    async with (
        _reachable_devices(devices) as placed,
        open_devices(drivers, placed, SystemClock(), _print) as found_devices,
    ):
        if not any(each.mismatched for each in found_devices):
            print("nothing to do: every device keeps what its binding needs")
            return exit_status.DONE
        _show(found_devices)
        if args.sim:
            print("nothing was written: a simulated device forgets it when it ends")
            return exit_status.FAILED
        if not (args.yes or _confirmed()):
            print("nothing was written")
            return exit_status.FAILED
        await write_settings(found_devices, folder, _now(), _print)
        print("done: every device keeps what its binding needs")
    return exit_status.DONE


async def _restore(args: argparse.Namespace, plugins: Plugins, entries: list[BackupEntry]) -> int:
    from lfield.clock import SystemClock
    from lfield.devices.device_setup import open_devices
    from lfield.devices.parameter_application import stored_values
    from lfield.devices.parameter_restore import apply_restore, plan_restore
    from lfield.driver.binding import by_bus

    if args.driver or args.deploy is not None:
        named = {device.bus for device in _selected(args, plugins)[1]}
        entries = [entry for entry in entries if entry.binding.bus in named]
    for driver in {entry.binding.driver for entry in entries}:
        named_driver(driver, plugins)
    by_name, found, problems = {entry.binding.name: entry for entry in entries}, [], list[str]()
    async with AsyncExitStack() as stack:
        for bus in by_bus([entry.binding for entry in entries]).values():
            try:
                found += await stack.enter_async_context(open_devices(plugins, bus, SystemClock(), _print))
            except DevicesError as error:
                problems += error.problems
        plans = []
        for device in found:
            entry = by_name[device.name]
            try:
                present = await stored_values(device, [change.name for change in entry.changes])
            except DevicesError as error:
                problems += error.problems
            else:
                plans.append(plan_restore(entry, device, present))
        for plan in plans:
            print(*plan.lines(), sep="\n")
        if any(plan.writes for plan in plans) and not (args.yes or _confirmed()):
            print("nothing was written")
            return exit_status.FAILED
        for plan in plans:
            problems += await apply_restore(plan, _print)
    if problems:
        raise DevicesError(problems)
    print("done: all settings are as before")
    return exit_status.DONE


def _is_parameter_file(file: Path) -> bool:
    """Whether a file is none of the JSON files that `lfield setup` writes."""
    from lfield.text.input_files import read_head

    try:
        return not read_head(file, 64).lstrip().startswith(b"{")
    except (OSError, ValueError):
        return False


async def _write_file(args: argparse.Namespace, plugins: Plugins, file: Path) -> int:
    from lfield.clock import SystemClock
    from lfield.devices.device_setup import open_devices
    from lfield.devices.parameter_application import check_permitted, plan_file, write_file
    from lfield.devices.parameter_backup import backup_folder
    from lfield.text.input_files import MAX_TEXT, read_bytes

    if not args.driver and args.deploy is None:
        raise UsageError(
            f"{file} is not of 'lfield setup': name the device by DRIVER --endpoint E, or --deploy"
        )
    drivers, devices = _selected(args, plugins)
    if len(devices) != 1:
        names = ", ".join(device.name for device in devices) or "none"
        raise UsageError(f"{file} is for one device, and these are named: {names}; name one, or its --host")
    data = read_bytes(file, MAX_TEXT)
    async with (
        _reachable_devices(devices) as placed,
        open_devices(drivers, placed, SystemClock(), _print) as found,
    ):
        plan = await plan_file(found[0], str(file), data)
        print(*plan.lines(), sep="\n")
        check_permitted(plan, _print)
        if not plan.comparison.changes:
            return exit_status.DONE
        if args.sim or not (args.yes or _confirmed()):
            print(
                "nothing was written" + (": a simulated device forgets it when it ends" if args.sim else "")
            )
            return exit_status.FAILED
        await write_file(plan, backup_folder(args.state), _now(), _print)
    print("done: every value of the file is written")
    return exit_status.DONE


def _now() -> str:
    return datetime.now().astimezone().isoformat(" ", "seconds")


@asynccontextmanager
async def _reachable_devices(devices: Sequence[DeviceBinding]) -> AsyncIterator[list[DeviceBinding]]:
    """The devices, simulated in a simulated mission, for the duration of the block."""
    from lfield.devices.fake_processes import FakeProcess, bind_to_fakes

    running, problems = list[FakeProcess](), list[str]()
    try:
        placed = await bind_to_fakes(devices, running, problems)
        if problems:
            raise DevicesError(problems)
        yield placed
    finally:
        for fake in running:
            await fake.stop()


def _show(found: Sequence[FoundDevice]) -> None:
    from rich.table import Table

    from lfield.cli.views.trees import plain_console

    table = Table(box=None, pad_edge=False)
    for column in ("DEVICE", "SETTING", "IS", "MUST BE", "WHY"):
        table.add_column(column, overflow="fold")
    for each in found:
        for setting in each.mismatched:
            values = (f"{setting.present:.9g}", f"{setting.wanted:.9g}")
            table.add_row(each.name, setting.name, *values, setting.why)
    plain_console().print(table)


def _confirmed() -> bool:
    """Ask for confirmation. Raises UsageError without a terminal."""
    if not sys.stdin.isatty():
        raise UsageError("nothing was written: no terminal to confirm on; confirm with --yes")
    return confirm("Type 'yes' to write that: ")


def _print(line: str) -> None:
    print(line, flush=True)
