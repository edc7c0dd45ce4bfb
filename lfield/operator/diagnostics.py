"""Diagnoses of `lfield doctor`: problems between a computer and its devices, with remedies.

Passive: the diagnosis reads files, queries the system and measures scheduling delays; only `endpoints` opens
devices, as a mission would.
"""

from __future__ import annotations

import ctypes
import grp
import importlib
import importlib.metadata
import os
import pwd
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Literal

from msgspec import Struct

from lfield import event_loop
from lfield.clock import Clock
from lfield.compiler.program_builder import compile_program
from lfield.devices.device_guards import DeviceGuards
from lfield.devices.jitter_measurement import measure_jitter
from lfield.devices.scheduling_jitter import JitterLimit
from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import DriverLookup
from lfield.driver.plugin import load_plugin
from lfield.driver.plugins import Plugins
from lfield.errors import DevicesError, EngineUnavailable
from lfield.guard.sandbox import describe_sandbox
from lfield.lang.frontend import check_text
from lfield.net.peer_credentials import GROUP, shared_group_id
from lfield.vm.wasm.engine_selection import has_wasm, wasm_engine

#: Serial ports that robots have: USB adapters, boards with native USB, the pins of a Raspberry Pi or Jetson.
PORTS = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*", "serial0")
#: Milliseconds that a USB adapter may hold bytes back; the usual 16 delay every answer.
SERIAL_LATENCY = 1
_REINSTALL = "pip install 'lfield[wasm]' again, for this processor, and see 'ulimit -v'"
#: The program to test an engine with: its code needs every feature that a version of wasmtime may lack.
_TRIAL_PROGRAM = """
resource Tried {
  init(string[] arg) {
    int k = arg.length();
    while (k < 1000) k = k * 2 + 1;
    print(f2s(sin(k / 2.0)) + arg[k]);
  }
}
"""
#: The subjects of the diagnoses of `lfield doctor`, by code.
DIAGNOSES = {
    "python": "version of Python, number of processors",
    "engine": "engine that runs programs",
    "driver": "an installed driver and what it lacks",
    "driver-broken": "a driver that cannot be used",
    "serial-port": "permission to use a serial port",
    "serial-latency": "latency of a USB serial adapter",
    "can-interface": "state of a CAN interface",
    "clock-sync": "synchronisation of the clock",
    "timer-priority": "real-time priority of guards",
    "confinement": "confinement of guards by the kernel",
    "shared-runs": "users who may observe and stop missions",
    "scheduling-lateness": "scheduling delays, compared with `silence`",
    "keys": "validity of keys on this computer",
    "page-keys": "validity of the keys of `lfield watch`",
    "endpoint": "device at an endpoint of the mission",
}
#: adjtimex's state of an unsynchronised clock.
_TIME_ERROR = 5


class DiagnosticFinding(Struct, frozen=True):
    """One diagnosis; `code` is that of `DIAGNOSES`, `details` are lines, `cure` is the remedy of a problem.

    The level `note` is for a fact that this mission does not need.
    """

    code: str
    state: Literal["ok", "note", "warning", "problem"]
    what: str
    cure: str = ""
    details: Sequence[str] = ()

    def as_data(self) -> dict[str, object]:
        """The finding as JSON data."""
        return {
            "code": self.code,
            "state": self.state,
            "message": self.what,
            "hint": self.cure or None,
            "details": list(self.details),
        }


def system(plugins: Plugins, root: Path = Path("/")) -> Iterator[DiagnosticFinding]:
    """All diagnoses that need no mission. `root` holds /dev and /sys, for tests."""
    yield DiagnosticFinding("python", "ok", f"Python {sys.version.split()[0]}, {os.cpu_count()} processors")
    yield engine()
    for problem in plugins.problems:
        yield DiagnosticFinding(
            "driver-broken", "problem", problem, "install that driver again, or uninstall it"
        )
    yield from _serial(root)
    yield from _can(root)
    yield _clock()
    yield _promptness()
    yield confinement()
    yield shared_runs()


def shared_runs() -> DiagnosticFinding:
    """Whether the group may see and stop the runs that this user starts."""
    if shared_group_id() is not None:
        return DiagnosticFinding(
            "shared-runs",
            "ok",
            f"members of the group {GROUP} may observe and stop the missions of this user",
        )
    join = "" if os.geteuid() == 0 else f" && sudo usermod -aG {GROUP} $USER, then log in again"
    return DiagnosticFinding(
        "shared-runs",
        "note",
        "only this user and root may observe and stop what this user starts",
        f"for a group that may: sudo groupadd --force {GROUP}{join}",
    )


def engine() -> DiagnosticFinding:
    """Whether wasmtime can run programs."""
    if not has_wasm():
        message = "the reference engine runs programs: wasmtime is not installed"
        return DiagnosticFinding(
            "engine",
            "note",
            message,
            "pip install 'lfield[wasm]': loops and calls run a hundred times as fast",
        )
    try:
        with wasm_engine() as wasm:
            wasm.WasmEngine(compile_program(check_text(_TRIAL_PROGRAM, "tried.L").or_raise()), float)
    except EngineUnavailable as unusable:
        message = f"the reference engine runs programs: {unusable}"
        return DiagnosticFinding("engine", "warning", message, _REINSTALL)
    return DiagnosticFinding(
        "engine", "ok", f"wasmtime {importlib.metadata.version('wasmtime')} runs programs"
    )


def drivers(plugins: Plugins, used: Collection[str] = ()) -> Iterator[DiagnosticFinding]:
    """The installed drivers. A missing dependency is a problem only for a driver that a mission has
    `used`.
    """
    for name, installed in sorted(plugins.by_driver.items()):
        if missing := installed.plugin.missing:
            lacks = f"driver {name}: not installed: {', '.join(missing)}"
            yield DiagnosticFinding(
                "driver", "problem" if name in used else "note", lacks, installed.plugin.to_install
            )
        else:
            yield DiagnosticFinding(
                "driver", "ok", f"driver {name}: {', '.join(sorted(installed.manifests))}"
            )


def _serial(root: Path) -> Iterator[DiagnosticFinding]:
    ports = [port for pattern in PORTS for port in sorted((root / "dev").glob(pattern))]
    if not ports:
        yield DiagnosticFinding("serial-port", "ok", "no serial ports")
    for port in ports:
        yield _port(port)
    for timer in sorted((root / "sys/bus/usb-serial/devices").glob("*/latency_timer")):
        yield _latency(timer)


def _port(port: Path) -> DiagnosticFinding:
    if os.access(port, os.R_OK | os.W_OK):
        return DiagnosticFinding("serial-port", "ok", f"{port}: may be used")
    group = grp.getgrgid(port.stat().st_gid).gr_name
    user = pwd.getpwuid(os.getuid()).pw_name
    return DiagnosticFinding(
        "serial-port",
        "problem",
        f"{port}: {user} may not use it",
        f"sudo usermod -aG {group} {user}, then log in again",
    )


def _latency(timer: Path) -> DiagnosticFinding:
    port, text = timer.parent.name, timer.read_text(encoding="ascii", errors="replace").strip()
    if text.isdecimal() and int(text) <= SERIAL_LATENCY:
        return DiagnosticFinding("serial-latency", "ok", f"{port}: holds bytes back for {text} ms at most")
    rule = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
    return DiagnosticFinding(
        "serial-latency",
        "warning",
        f"{port}: holds bytes back for up to {text} ms, which every answer of a servo waits for",
        f"echo 1 | sudo tee {timer}; permanently: the udev rule {rule}",
    )


def _can(root: Path) -> Iterator[DiagnosticFinding]:
    for interface in sorted((root / "sys/class/net").glob("*can[0-9]*")):
        name = interface.name
        state = (interface / "operstate").read_text(encoding="ascii", errors="replace").strip()
        if state in ("up", "unknown"):
            yield DiagnosticFinding("can-interface", "ok", f"{name}: {'up' if state == 'up' else 'there'}")
        else:
            yield DiagnosticFinding(
                "can-interface",
                "problem",
                f"{name}: {state}",
                f"sudo ip link set {name} up type can bitrate 500000 restart-ms 100",
            )


def _clock() -> DiagnosticFinding:
    """Whether the clock is synchronised; logs of a team are compared by it."""
    libc = ctypes.CDLL(None, use_errno=True)
    # struct timex is 208 bytes on 64-bit Linux; modes 0 only reads.
    state = libc.adjtimex(ctypes.create_string_buffer(256))
    if state == _TIME_ERROR:
        return DiagnosticFinding(
            "clock-sync",
            "warning",
            "the clock is not synchronised: times in the logs of different hosts cannot be compared",
            "run chrony or systemd-timesyncd; without a network, a GPS receiver with gpsd",
        )
    return DiagnosticFinding(
        "clock-sync",
        "ok",
        "the clock is synchronised" if state >= 0 else "the state of the clock cannot be read",
    )


def _promptness() -> DiagnosticFinding:
    """Whether guards get real-time priority; see lfield.guard.process."""
    if event_loop.may_raise_timer_priority():
        return DiagnosticFinding("timer-priority", "ok", "guards run with real-time priority")
    return DiagnosticFinding(
        "timer-priority",
        "warning",
        "guards may not have real-time priority: on a busy computer their timers can be late",
        "LimitRTPRIO=1 in the service's unit, or '@dialout - rtprio 1' in /etc/security/limits.conf",
    )


def confinement() -> DiagnosticFinding:
    """Whether this kernel can confine guards to their devices; see lfield.guard.sandbox."""
    confined, missing = describe_sandbox()
    if not confined:
        return DiagnosticFinding("confinement", "note", f"guards have all rights of their user: {missing}")
    if missing:
        return DiagnosticFinding(
            "confinement",
            "note",
            f"guards are confined to their devices ({confined}); the kernel cannot confine {missing}",
        )
    return DiagnosticFinding("confinement", "ok", f"guards are confined to their devices ({confined})")


async def scheduling_lateness(silence: float, clock: Clock, *, bound: bool) -> DiagnosticFinding:
    """Whether this computer, under its present load, supports a `silence` in seconds; takes about 1 s.

    If bindings of hardware require that silence (`bound`), an excess is a problem: a host would not start.
    """
    limit = JitterLimit(silence, event_loop.may_raise_timer_priority())
    late = await measure_jitter(limit, clock)
    if late <= limit.max_jitter:
        return DiagnosticFinding("scheduling-lateness", "ok", limit.report(late))
    return DiagnosticFinding(
        "scheduling-lateness", "problem" if bound else "warning", limit.report(late), limit.remedy(late)
    )


async def endpoints(
    drivers: DriverLookup,
    devices: list[DeviceBinding],
    clock: Clock,
    on_finding: Callable[[DiagnosticFinding], None],
    setup: str = "lfield setup",
) -> None:
    """Identifies the device at each bound endpoint; no device is moved or written.

    `setup` is the command that sets up devices that are not set up.
    """
    for device in devices:
        plugin = load_plugin(drivers.by_driver[device.driver].reference)
        if plugin.missing:
            on_finding(
                DiagnosticFinding(
                    "endpoint", "problem", f"{device.name}: not tried without its driver", plugin.to_install
                )
            )
            continue
        notes: list[str] = []
        guards = DeviceGuards(drivers, clock, notes.append)
        try:
            await guards.open([device])
        except DevicesError as error:
            for problem in error.problems:
                on_finding(_not_open(device, problem, setup if problem in error.not_set_up else "", notes))
        else:
            identity = guards.guard_of(device.name).identities[device.name]
            on_finding(DiagnosticFinding("endpoint", "ok", f"{device.name}: {identity} at {device.endpoint}"))
        finally:
            await guards.close()


def _not_open(device: DeviceBinding, problem: str, setup: str, notes: Sequence[str]) -> DiagnosticFinding:
    if not setup:
        # Some problems contain the command that solves them.
        hint = "" if "'sudo " in problem else "check power, cable, endpoint and ids"
        return DiagnosticFinding("endpoint", "problem", problem, hint)
    details = [note.removeprefix(device.name).lstrip(": ") for note in notes]
    return DiagnosticFinding("endpoint", "problem", problem, f"{setup} (with a confirmation)", details)
