"""The MAVLink driver against pymavlink's own connection, on the same fake.

Telemetry: four vehicles on one link, 200 messages a second each, heard by both at the same time: what one
second costs of a processor. Commands: from the call to the acknowledgement, in turns; the driver's with the
way through the guard's pipe.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from harness import Child, Children, Figure, Row, in_turns, median, microseconds, percentile, times

from lfield import loop
from lfield.clock import SystemClock
from lfield.devices.guards import Guards
from lfield.devices.try_out import LiveBench
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.testing.reports import KeptReports

SYSTEMS, RATE, SECONDS = (1, 2, 3, 4), 200, 5.0
ROUNDS, COMMANDS = 15, 200
TARGET = 0.9
#: REQUEST_MESSAGE for AUTOPILOT_VERSION: asks, and moves nothing.
REQUEST, VERSION = 512, 148.0

_RAW = str(Path(__file__).parent / "mavlink_raw.py")


def figure() -> Figure:
    """Processor time and latency."""
    with Children() as children:
        vehicles = [word for system in SYSTEMS for word in ("--vehicle", str(system))]
        fake = children.start(
            sys.executable, "-m", "lfield_sim", "mavlink", "--listen", "udp:127.0.0.1:0", *vehicles
        )
        port = fake.line().split()[1].rpartition(":")[2]
        rows = [*_telemetry(children, port), *_commands(port)]
    notes = (
        f"{len(SYSTEMS)} vehicles, {RATE} messages/s each, for {SECONDS:g} s",
        f"{ROUNDS} rounds of {COMMANDS} commands",
        "the ratio is what the raw library takes over what the driver takes",
    )
    return Figure("The MAVLink driver; ratio to pymavlink's mavutil", rows, notes)


def _plugins() -> Plugins:
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    return plugins


def _bindings(port: str, systems: Iterable[int]) -> list[DeviceBinding]:
    manifest = _plugins().by_driver["mavlink"].manifests["Mavlink"]
    options = {option.name: option.default for option in manifest.options if option.default is not None}
    return [
        DeviceBinding(
            agent=f"v{system}",
            field="fc",
            type="Mavlink",
            driver="mavlink",
            endpoint=f"udp:127.0.0.1:{port}",
            safe_state="land",
            options=options | {"system": system},
            waivers=["device_watchdog"],
        )
        for system in systems
    ]


def _telemetry(children: Children, port: str) -> Iterable[Row]:
    own, raw, count = asyncio.run(_hear(children, port))
    case = f"telemetry, {count / SECONDS:.0f} messages/s"
    yield Row(case, "pymavlink", f"{100 * raw / SECONDS:.1f} % CPU", "", times(1.0))
    yield Row(
        "",
        "lfield_mavlink's guard",
        f"{100 * own / SECONDS:.1f} % CPU",
        "",
        times(raw / own),
        f"{TARGET:.2f}x",
    )


async def _hear(children: Children, port: str) -> tuple[float, float, int]:
    """CPU seconds of the guard and of pymavlink over the same seconds, and how many messages there were."""
    guards = Guards(_plugins(), SystemClock(), lambda line: None)
    await guards.open(_bindings(port, SYSTEMS))
    try:
        raw = children.start(
            sys.executable, _RAW, "listen", port, str(RATE), str(SECONDS), *map(str, SYSTEMS)
        )
        await asyncio.to_thread(raw.line)
        before = _cpu(guards)
        used, count = (await asyncio.to_thread(raw.line)).split()
        return _cpu(guards) - before, float(used), int(count)
    finally:
        await guards.close()


def _cpu(guards: Guards) -> float:
    """Processor seconds that the guard's process has used."""
    return time.clock_gettime(_cpu_clock(guards.guard_of("v1.fc").pid))


def _cpu_clock(pid: int) -> int:
    """What clock_getcpuclockid(3) gives, which Python has not; /proc counts in steps of 10 ms."""
    return ~pid << 3 | 2


def _commands(port: str) -> Iterable[Row]:
    names = {
        "pymavlink": lambda: _raw_commands(port),
        "driver": lambda: loop.run(_driver_commands(port)),
        "guard": lambda: asyncio.run(_guard_commands(port)),
    }
    samples = in_turns(names, ROUNDS)
    against = median(samples["pymavlink"])
    for name, words in (
        ("pymavlink", "pymavlink"),
        ("driver", "lfield_mavlink, the driver alone"),
        ("guard", "the same through its guard's pipe"),
    ):
        own = samples[name]
        yield Row(
            "command to acknowledgement" if name == "pymavlink" else "",
            words,
            microseconds(median(own)),
            microseconds(percentile(own, 99)),
            times(against / median(own)),
            f"{TARGET:.2f}x" if name == "driver" else "",
        )


def _raw_commands(port: str) -> list[float]:
    child = Child((sys.executable, _RAW, "command", port, str(COMMANDS)))
    samples = [float(word) for word in child.line().split()]
    child.wait()
    return samples


async def _driver_commands(port: str) -> list[float]:
    installed = _plugins().by_driver["mavlink"]
    driver = installed.plugin.load()(_bindings(port, (1,)), installed.manifests, SystemClock(), KeptReports())
    await driver.open()
    try:
        device = driver.devices["v1.fc"]
        await device.open()
        samples = []
        for _ in range(COMMANDS):
            start = time.perf_counter()
            await device.execute("command", [REQUEST, [VERSION]])
            samples.append(time.perf_counter() - start)
        return samples
    finally:
        await driver.close()


async def _guard_commands(port: str) -> list[float]:
    guards = Guards(_plugins(), SystemClock(), lambda line: None)
    (binding,) = _bindings(port, (1,))
    await guards.open([binding])
    try:
        bench = LiveBench(guards, binding, _plugins().by_driver["mavlink"].manifests["Mavlink"], [])
        samples = []
        for _ in range(COMMANDS):
            start = time.perf_counter()
            await bench.call("command", REQUEST, [VERSION])
            samples.append(time.perf_counter() - start)
        return samples
    finally:
        await guards.close()
