"""A CAN bus of 250 kbit/s at full load with 40 devices by DBC file: each receives a command and sends a
status every 40 ms, with counter and CRC. The driver runs in this process, the simulated bus in another.

The time of a command ends when another client of the bus has received its frame.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT, RATE
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

from lfield import event_loop
from lfield.clock import SystemClock
from lfield.driver import Device
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.testing.kept_reports import KeptReports
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame

BITRATE, SECONDS_OF_A_ROUND, COMMANDS = 250_000, 3.0, 100
#: Bits of a frame of eight bytes with the interframe space, without stuff bits.
BITS = 111
DBC = """VERSION ""
BU_: Host Device
BO_ {command} Command{n}: 8 Host
 SG_ Check : 0|8@1+ (1,0) [0|255] "" Device
 SG_ Counter : 8|4@1+ (1,0) [0|14] "" Device
 SG_ Enable : 12|1@1+ (1,0) [0|1] "" Device
 SG_ TargetAngle : 16|16@1- (0.001,0) [0|0] "rad" Device
BO_ {status} Status{n}: 8 Device
 SG_ Check : 0|8@1+ (1,0) [0|255] "" Host
 SG_ Counter : 8|4@1+ (1,0) [0|14] "" Host
 SG_ Enable : 12|1@1+ (1,0) [0|1] "" Host
 SG_ Angle : 16|16@1- (0.001,0) [0|0] "rad" Host
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_ "GenMsgCycleTime" BO_ {command} 40;
BA_ "GenMsgCycleTime" BO_ {status} 40;
"""
PER_SECOND, LOAD = "bytes of data a second", "load of the bus in percent"
PROCESSOR, FIRST, MISSED = (
    "a second: processor of the driver",
    "command to first frame",
    "missed cycles a second",
)


def devices(count: int) -> Opener:
    """Open a bus with `count` devices."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        folder = Path(tempfile.mkdtemp(prefix="can-load-"))
        files = [folder / f"device{n}.dbc" for n in range(count)]
        arguments = ["--bitrate", str(BITRATE)]
        for n, file in enumerate(files):
            file.write_text(DBC.format(n=n, command=0x100 + n, status=0x200 + n))
            arguments += ["--device", f"dbc:{file},commands=Command{n},cycles=Command{n},{_protected(n)}"]
        endpoint = checkout.fake(processes, "can", *arguments)
        return lambda: event_loop.run(_round(endpoint, files))

    return opener


def _protected(n: int) -> str:
    both = f"Command{n}", f"Status{n}"
    counters = "+".join(f"{name}.Counter:15" for name in both)
    return f"counters={counters},checksums={'+'.join(f'{name}.Check:e2e_1/0x2A7' for name in both)}"


def _binding(n: int, file: Path, endpoint: str, defaults: dict[str, object]) -> DeviceBinding:
    both = f"Command{n}", f"Status{n}"
    own = {
        "dbc": str(file),
        "commands": [f"Command{n}"],
        "safe": [f"Command{n}.Enable=0", f"Command{n}.TargetAngle=0"],
        "confirm": [f"Status{n}.Enable=0"],
        "cyclic": [f"Command{n}"],
        "counters": [f"{name}.Counter=15" for name in both],
        "checksums": [f"{name}.Check=e2e_1 0x2A7" for name in both],
    }
    return DeviceBinding(
        agent=f"d{n}", field="device", type="CanSignals", driver="can", endpoint=endpoint, ttl=10.0,
        safe_state="safe_messages", options={**defaults, **own}, waivers=["device_watchdog"],
    )  # fmt: skip


async def _round(endpoint: str, files: Sequence[Path]) -> Round:
    plugins = Plugins()
    plugins.add("lfield_can:PLUGIN")
    installed = plugins.by_driver["can"]
    options = installed.manifests["CanSignals"].options
    defaults = {option.name: option.default for option in options if option.default is not None}
    bindings = [_binding(n, file, endpoint, defaults) for n, file in enumerate(files)]
    reports = KeptReports(*(binding.name for binding in bindings))
    driver = installed.plugin.load()(bindings, installed.manifests, SystemClock(), reports)
    await driver.open()
    observed = Observed()
    observer = Bus(endpoint, observed.on_frame, lambda note: None)
    try:
        for device in driver.devices.values():
            await device.open()
        for n, device in enumerate(driver.devices.values()):
            await device.execute("set", [f"Command{n}.Enable", 1.0])
        await asyncio.sleep(1.0)
        missed = _missed(reports)
        started, used = time.perf_counter(), time.process_time()
        await asyncio.sleep(SECONDS_OF_A_ROUND)
        elapsed, used = time.perf_counter() - started, time.process_time() - used
        found = {PROCESSOR: [used / elapsed], MISSED: [(_missed(reports) - missed) / elapsed]}
        await observer.open()
        return {**found, **await _measured(list(driver.devices.values()), observed)}
    finally:
        await observer.close()
        await driver.close()


def _missed(reports: KeptReports) -> float:
    return sum(values.get("overruns", 0) for values in reports.reported.values())


class Observed:
    """The frames that another client of the bus receives."""

    def __init__(self) -> None:
        self.count = 0
        self._awaited: tuple[int, bytes, asyncio.Future[None]] | None = None

    def on_frame(self, frame: Frame) -> None:
        """Count a frame, and complete the future that waits for it."""
        self.count += 1
        if self._awaited is not None and self._awaited[:2] == (frame.id, frame.data[2:4]):
            self._awaited[2].set_result(None)
            self._awaited = None

    def expected(self, identifier: int, angle: bytes) -> asyncio.Future[None]:
        """A future that completes with the first frame of this angle."""
        future = asyncio.get_running_loop().create_future()
        self._awaited = identifier, angle, future
        return future


async def _measured(made: Sequence[Device], observed: Observed) -> Round:
    await asyncio.sleep(0.5)
    before, started = observed.count, time.perf_counter()
    await asyncio.sleep(SECONDS_OF_A_ROUND)
    rate = (observed.count - before) / (time.perf_counter() - started)
    found = {PER_SECOND: [8.0 * rate / 1000.0], LOAD: [round(100.0 * rate * BITS / BITRATE, 1)]}
    return {**found, FIRST: [await _first_frame(made[n % len(made)], n, observed) for n in range(COMMANDS)]}


async def _first_frame(device: Device, n: int, observed: Observed) -> float:
    """Seconds until a new angle is on the bus."""
    number = int(device.binding.agent[1:])
    first = observed.expected(0x100 + number, (n + 1).to_bytes(2, "little"))
    started = time.perf_counter()
    await device.execute("set", [f"Command{number}.TargetAngle", (n + 1) / 1000.0])
    await first
    elapsed = time.perf_counter() - started
    await asyncio.sleep(0.003)
    return elapsed


FIGURE = Figure(
    "A CAN bus of 250 kbit/s with cyclic commands and statuses every 40 ms",
    {f"{count} devices": devices(count) for count in (1, 10, 40)},
    rounds=3,
    units={PER_SECOND: RATE, LOAD: COUNT, MISSED: COUNT},
    sizes={f"{count} devices": count for count in (1, 10, 40)},
    notes=("counter and CRC of every frame are set and checked",),
)
