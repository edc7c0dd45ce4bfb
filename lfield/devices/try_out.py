"""Tries devices by their driver's conformance kit: opens them behind guards, runs the checks, closes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from lfield.clock import SystemClock
from lfield.devices.bench import LiveBench
from lfield.devices.guards import Guards
from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import Check, Finding, run_kit
from lfield.driver.kit_checks import KIT
from lfield.driver.plugins import Installed, Plugins
from lfield.guard.core import SILENCE


def checks_of(installed: Installed) -> list[Check]:
    """What every driver must pass, then the driver's own checks. Raises PluginError."""
    own: Any = installed.plugin.load_kit() if installed.plugin.kit else None
    return [*KIT.checks, *(own.checks if own is not None else ())]


async def try_devices(
    plugins: Plugins,
    devices: Sequence[DeviceBinding],
    checks: Iterable[Check],
    may_move: bool,
    show: Callable[[Finding], None],
    *,
    silence: float = SILENCE,
) -> list[Finding]:
    """Run the checks on one device after the other, and show each finding as it is made.

    `silence` is how long this host may be silent, in seconds. Raises DevicesError when a device cannot be
    opened.
    """
    checks, notes, findings = list(checks), list[str](), list[Finding]()
    guards = Guards(plugins, SystemClock(), notes.append, silence=silence)
    await guards.open(devices)
    try:
        for device in devices:
            manifest = plugins.by_driver[device.driver].manifests[device.type]
            bench = LiveBench(guards, device, manifest, notes, silence=silence)
            async for finding in run_kit(bench, checks, may_move):
                findings.append(finding)
                show(finding)
    finally:
        await guards.close()
    return findings
