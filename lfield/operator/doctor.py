"""Looks at a computer as `lfield doctor` does: what stands between it and its devices, and the cure.

Passive: it reads files, asks the system and measures how late the computer is; only `endpoints` opens
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
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lfield import loop
from lfield.clock import Clock
from lfield.compiler.build import compile_program
from lfield.devices.guards import Guards
from lfield.devices.lateness import Limit
from lfield.devices.measuring import measured
from lfield.driver.binding import DeviceBinding
from lfield.driver.known import Drivers
from lfield.driver.plugin import load_plugin
from lfield.driver.plugins import Plugins
from lfield.errors import DevicesError, NoEngine
from lfield.guard.confine import strength
from lfield.lang.frontend import check_text
from lfield.net.door import GROUP, sharing
from lfield.vm.wasm.choice import has_wasm, wasm_engine

#: Serial ports that robots have: USB adapters, boards with native USB, the pins of a Raspberry Pi or Jetson.
PORTS = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*", "serial0")
#: Milliseconds that a USB adapter may hold bytes back; the usual 16 costs that for every answer.
LATENCY = 1
_AGAIN = "pip install 'lfield[wasm]' again, for this processor, and see 'ulimit -v'"
#: What is tried of an engine: whatever a version of wasmtime may lack is in the code of any such program.
_TRIED = """
resource Tried {
  init(string[] arg) {
    int k = arg.length();
    while (k < 1000) k = k * 2 + 1;
    print(f2s(sin(k / 2.0)) + arg[k]);
  }
}
"""
#: adjtimex's word for a clock that nothing disciplines.
_TIME_ERROR = 5


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at; `details` are a line each, `cure` says what to do when it is not well.

    A note is what nothing here needs now.
    """

    state: Literal["ok", "note", "warning", "problem"]
    what: str
    cure: str = ""
    details: Sequence[str] = ()


def system(plugins: Plugins, root: Path = Path("/")) -> Iterator[Finding]:
    """Everything that can be seen without a mission. `root` is where /dev and /sys are, for tests."""
    yield Finding("ok", f"Python {sys.version.split()[0]}, {os.cpu_count()} processors")
    yield engine()
    for problem in plugins.problems:
        yield Finding("problem", problem, "install that driver again, or uninstall it")
    yield from _serial(root)
    yield from _can(root)
    yield _clock()
    yield _promptness()
    yield confinement()
    yield shared_runs()


def shared_runs() -> Finding:
    """Whether the group may see and stop what this user starts."""
    if sharing() is not None:
        return Finding("ok", f"members of the group {GROUP} may look at what this user starts, and stop it")
    join = "" if os.geteuid() == 0 else f" && sudo usermod -aG {GROUP} $USER, then log in again"
    return Finding(
        "note",
        "nobody but this user and root may look at what this user starts, and stop it",
        f"for a group that may: sudo groupadd --force {GROUP}{join}",
    )


def engine() -> Finding:
    """Whether programs can be run as WebAssembly here."""
    if not has_wasm():
        what = "the reference engine runs programs: wasmtime is not installed"
        return Finding(
            "note", what, "pip install 'lfield[wasm]': loops and calls run a hundred times as fast"
        )
    try:
        with wasm_engine() as wasm:
            wasm.Engine(compile_program(check_text(_TRIED, "tried.L").or_raise()), float)
    except NoEngine as unusable:
        what = f"the reference engine runs programs: {unusable}"
        return Finding("warning", what, _AGAIN)
    return Finding("ok", f"wasmtime {importlib.metadata.version('wasmtime')} runs programs")


def drivers(plugins: Plugins, used: Collection[str] = ()) -> Iterator[Finding]:
    """The installed drivers. What one of them lacks is a problem only where a mission has `used` it."""
    for name, installed in sorted(plugins.by_driver.items()):
        if missing := installed.plugin.missing:
            lacks = f"driver {name}: not installed: {', '.join(missing)}"
            yield Finding("problem" if name in used else "note", lacks, installed.plugin.to_install)
        else:
            yield Finding("ok", f"driver {name}: {', '.join(sorted(installed.manifests))}")


def _serial(root: Path) -> Iterator[Finding]:
    ports = [port for pattern in PORTS for port in sorted((root / "dev").glob(pattern))]
    if not ports:
        yield Finding("ok", "no serial ports")
    for port in ports:
        yield _port(port)
    for timer in sorted((root / "sys/bus/usb-serial/devices").glob("*/latency_timer")):
        yield _latency(timer)


def _port(port: Path) -> Finding:
    if os.access(port, os.R_OK | os.W_OK):
        return Finding("ok", f"{port}: may be used")
    group = grp.getgrgid(port.stat().st_gid).gr_name
    user = pwd.getpwuid(os.getuid()).pw_name
    return Finding(
        "problem", f"{port}: {user} may not use it", f"sudo usermod -aG {group} {user}, then log in again"
    )


def _latency(timer: Path) -> Finding:
    port, text = timer.parent.name, timer.read_text(encoding="ascii", errors="replace").strip()
    if text.isdecimal() and int(text) <= LATENCY:
        return Finding("ok", f"{port}: holds bytes back for {text} ms at most")
    rule = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
    return Finding(
        "warning",
        f"{port}: holds bytes back for up to {text} ms, which every answer of a servo waits for",
        f"echo 1 | sudo tee {timer}; for ever: the udev rule {rule}",
    )


def _can(root: Path) -> Iterator[Finding]:
    for interface in sorted((root / "sys/class/net").glob("*can[0-9]*")):
        name = interface.name
        state = (interface / "operstate").read_text(encoding="ascii", errors="replace").strip()
        if state in ("up", "unknown"):
            yield Finding("ok", f"{name}: {'up' if state == 'up' else 'there'}")
        else:
            yield Finding(
                "problem",
                f"{name}: {state}",
                f"sudo ip link set {name} up type can bitrate 500000 restart-ms 100",
            )


def _clock() -> Finding:
    """Whether anything keeps this computer's time; logs of a team are compared by it."""
    libc = ctypes.CDLL(None, use_errno=True)
    # struct timex is 208 bytes on 64-bit Linux; modes 0 only asks.
    state = libc.adjtimex(ctypes.create_string_buffer(256))
    if state == _TIME_ERROR:
        return Finding(
            "warning",
            "the clock is not synchronised: the logs of the hosts will not fit together",
            "run chrony or systemd-timesyncd; without a network, a GPS receiver with gpsd",
        )
    return Finding("ok", "the clock is synchronised" if state >= 0 else "the clock cannot be asked")


def _promptness() -> Finding:
    """Whether a guard may run before everything else; see lfield.guard.process."""
    if loop.may_be_prompt():
        return Finding("ok", "guards run with real-time priority")
    return Finding(
        "warning",
        "guards may not have real-time priority: on a busy computer their timers can be late",
        "LimitRTPRIO=1 in the service's unit, or '@dialout - rtprio 1' in /etc/security/limits.conf",
    )


def confinement() -> Finding:
    """What of this kernel keeps guards to their devices; see lfield.guard.confine."""
    kept, missing = strength()
    if not kept:
        return Finding("note", f"guards have all rights of their user: {missing}")
    if missing:
        return Finding("note", f"guards are kept to their devices ({kept}); this kernel cannot for {missing}")
    return Finding("ok", f"guards are kept to their devices ({kept})")


async def lateness(silence: float, clock: Clock, *, bound: bool) -> Finding:
    """Whether this computer, as busy as it is now, keeps a silence of so many seconds; takes about one.

    Not to keep what the bindings of hardware say is a problem (`bound`): a host would not start.
    """
    limit = Limit(silence, loop.may_be_prompt())
    late = await measured(limit, clock)
    if late <= limit.allowed:
        return Finding("ok", limit.told(late))
    return Finding("problem" if bound else "warning", limit.told(late), limit.cure(late))


async def endpoints(
    drivers: Drivers,
    devices: list[DeviceBinding],
    clock: Clock,
    told: Callable[[Finding], None],
    setup: str = "lfield setup",
) -> None:
    """What answers at every bound endpoint. Devices are opened one by one, and nothing is moved or written.

    `setup` is the command that sets up those that are not.
    """
    for device in devices:
        plugin = load_plugin(drivers.by_driver[device.driver].reference)
        if plugin.missing:
            told(Finding("problem", f"{device.name}: not tried without its driver", plugin.to_install))
            continue
        notes: list[str] = []
        guards = Guards(drivers, clock, notes.append)
        try:
            await guards.open([device])
        except DevicesError as error:
            for problem in error.problems:
                told(_not_open(device, problem, setup if problem in error.not_set_up else "", notes))
        else:
            identity = guards.guard_of(device.name).identities[device.name]
            told(Finding("ok", f"{device.name}: {identity} at {device.endpoint}"))
        finally:
            await guards.close()


def _not_open(device: DeviceBinding, problem: str, setup: str, notes: Sequence[str]) -> Finding:
    if not setup:
        return Finding("problem", problem, "check power, cable, endpoint and ids")
    details = [note.removeprefix(f"{device.name}: ") for note in notes]
    return Finding("problem", problem, f"{setup} (it asks first)", details)
