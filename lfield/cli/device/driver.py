"""`lfield driver`: lists installed drivers, and makes the skeleton of a new one."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from lfield.cli.action_help import action_help
from lfield.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    installed = actions.add_parser("list", **action_help("list the installed drivers and their device types"))
    installed.add_argument("--json", action="store_true", help="print the list as JSON")
    new = actions.add_parser(
        "new",
        **action_help("create a driver project with a simulated device; it passes the conformance checks"),
    )
    new.add_argument("name", metavar="NAME", help="name of the driver: lower-case letters and digits")
    new.add_argument("--sensor", action="store_true", help="for a sensor, which needs no safe state")
    new.add_argument(
        "--serial", action="store_true", help="for a device on a serial port (default: on a TCP port)"
    )
    new.add_argument("--into", metavar="DIR", type=Path, help="directory to create (default: lfield_NAME)")


def run(args: argparse.Namespace) -> int:
    """List or create drivers; returns 0."""
    if args.action == "list":
        return _list(as_json=args.json)
    folder = args.into or Path(f"lfield_{args.name}")
    return _new(args.name, folder, sensor=args.sensor, serial=args.serial)


def _list(*, as_json: bool) -> int:
    from lfield.driver.plugins import discover

    plugins = discover()
    if as_json:
        drivers = {
            name: {
                "package": installed.distribution,
                "missing": list(installed.plugin.missing),
                "device_types": {
                    type_name: manifest.device.meaning
                    for type_name, manifest in sorted(installed.manifests.items())
                },
            }
            for name, installed in sorted(plugins.by_driver.items())
        }
        print(json.dumps({"drivers": drivers, "problems": plugins.problems}, indent=2))
        return 0
    for name, installed in sorted(plugins.by_driver.items()):
        for device_type, manifest in sorted(installed.manifests.items()):
            print(f"{name}: {device_type}: {manifest.device.meaning}")
    for problem in plugins.problems:
        print(problem)
    return 0


def _new(name: str, folder: Path, *, sensor: bool, serial: bool) -> int:
    from lfield.driver.plugins import discover
    from lfield.driver.skeleton import write

    if not re.fullmatch(r"[a-z][a-z0-9]{0,30}", name):
        raise UsageError(f"'{name}' cannot be a driver's name; use small letters and digits, as in winch")
    if name in discover().by_driver:
        raise UsageError(f"a driver '{name}' is installed already")
    if folder.exists():
        raise UsageError(f"{folder} exists already; nothing was written")
    for path in write(name, folder, sensor=sensor, serial=serial):
        print(path)
    print(f"\nnext: pip install -e {folder}, then follow {folder}/README.md")
    return 0
