"""`lfield sim KIND ...`: a stand-alone simulated device; `lfield sim fault ...`: makes it go wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfield.cli.action_help import action_help
from lfield.errors import AddressError, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Every installed simulated device is a subcommand with its own options; `fault` sets faults of running
    ones."""
    from lfield.driver.sims import discover_sims

    kinds = parser.add_subparsers(dest="kind_of_sim", metavar="KIND")
    for name, sim in sorted(discover_sims().items()):
        sim.add_arguments(
            kinds.add_parser(name, **action_help(f"run a simulated device for the driver '{name}'"))
        )
    fault = kinds.add_parser(
        "fault", **action_help("show the faults of running simulated devices, or inject some")
    )
    fault.add_argument(
        "target",
        nargs="?",
        default="",
        metavar="TARGET",
        help="endpoint, kind or name (alpha.fc) of a simulated device (default: show the faults of all)",
    )
    fault.add_argument("settings", nargs="*", metavar="NAME[@DEVICE]=VALUE", help="fault to inject")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM, SIGINT or the end that the simulated device's options name; or set faults."""
    from lfield.driver.sims import discover_sims

    sims = discover_sims()
    if args.kind_of_sim is None:
        raise UsageError(f"no simulated device given; installed: {', '.join(sorted(sims)) or 'none'}")
    if args.kind_of_sim == "fault":
        return _fault(args.target, args.settings)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # stdout is a text stream here
    return sims[args.kind_of_sim].run(args)


def _fault(target: str, settings: list[str]) -> int:
    from lfield.net.fault_client import send_fault_command

    running = _running()
    if not target:
        for fake in running.values():
            _show(fake)
        if not running:
            print("no simulated device runs")
        return 0
    path, device = _select_fake(target, running)
    answer = send_fault_command(path, [_setting_for(setting, device) for setting in settings])
    if "error" in answer:
        raise UsageError(answer["error"])
    _show(answer)
    return 0


def _running() -> dict[Path, dict[str, Any]]:
    """Every simulated device of this user that answers, by its socket. Sockets of killed ones are removed."""
    from lfield.driver.sims import control_sockets
    from lfield.net.fault_client import is_stale_socket, send_fault_command

    running = {}
    for path in control_sockets():
        try:
            running[path] = send_fault_command(path, [])
        except AddressError:
            # The socket of a device that is only slow is kept.
            if is_stale_socket(path):
                path.unlink(missing_ok=True)
    return running


def _select_fake(target: str, running: Mapping[Path, Mapping[str, Any]]) -> tuple[Path, str]:
    """The simulated device with that name, and the device on it, '' for all. Raises UsageError."""
    matches = []
    for path, fake in running.items():
        device = target if target in fake["devices"].values() else ""
        if device or target in (fake["kind"], fake["endpoint"]):
            matches.append((path, device))
    if len(matches) == 1:
        return matches[0]
    names = [
        name for fake in running.values() for name in (fake["endpoint"], *fake["devices"].values()) if name
    ]
    problem = (
        f"{len(matches)} simulated devices are '{target}'"
        if matches
        else f"no running simulated device is '{target}'"
    )
    raise UsageError(f"{problem}; running: {', '.join(names) or 'none'}")


def _setting_for(setting: str, device: str) -> str:
    """The setting for a device, unless it already names one."""
    name, equals, value = setting.partition("=")
    return f"{name}@{device}{equals}{value}" if device and "@" not in name else setting


def _show(fake: Mapping[str, Any]) -> None:
    devices = ", ".join(f"{d} ({name})" if name else d for d, name in fake["devices"].items())
    print(f"{fake['kind']} at {fake['endpoint']}: {devices}")
    for name, setting in fake["faults"].items():
        print(f"  {name} = {setting}")
