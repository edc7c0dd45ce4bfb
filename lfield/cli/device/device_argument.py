"""The devices of one driver that a command is about: one at an endpoint, or those of a devices file."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import UsageError

if TYPE_CHECKING:
    from lfield.driver.binding import DeviceBinding
    from lfield.driver.plugins import InstalledPlugin, Plugins


def add_devices(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that name devices."""
    parser.add_argument(
        "--endpoint", metavar="E", default="", help="endpoint of the device, as in a devices file"
    )
    parser.add_argument(
        "--devices", metavar="FILE", type=Path, help="devices file with ids, limits and waivers"
    )
    parser.add_argument("--type", default="", help="device type in L, if the driver has several")
    parser.add_argument(
        "--set",
        dest="settings",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="key of the binding, as in --set id=3 or --set 'limits={speed: 1}' (repeatable)",
    )


def named_driver(name: str, plugins: Plugins) -> InstalledPlugin:
    """The driver of this name. Raises UsageError."""
    installed = plugins.by_driver.get(name)
    if installed is None:
        known = ", ".join(sorted(plugins.by_driver)) or "none"
        raise UsageError("; ".join([f"there is no driver '{name}' (installed: {known})", *plugins.problems]))
    return installed


def named_devices(
    args: argparse.Namespace, installed: InstalledPlugin, plugins: Plugins
) -> list[DeviceBinding]:
    """The named devices. Raises UsageError, BindingError, InputFileError."""
    from lfield.mission.device_selection import devices_in_file, one_device

    if args.devices is not None:
        if args.settings or args.type:
            raise UsageError("--set and --type are for one device without --devices")
        return devices_in_file(args.devices, installed, plugins, args.endpoint)
    if not args.endpoint:
        raise UsageError("no endpoint: give --endpoint, or --devices with a devices file")
    return one_device(installed, plugins, args.endpoint, args.type, args.settings)


def setup_command(args: argparse.Namespace) -> str:
    """The command that sets up the named devices."""
    command = ["lfield", "setup", args.driver]
    for option, value in (("--endpoint", args.endpoint), ("--devices", args.devices), ("--type", args.type)):
        command += [option, str(value)] if value else []
    return shlex.join([*command, *(argument for setting in args.settings for argument in ("--set", setting))])
