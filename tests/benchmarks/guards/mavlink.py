"""Time from a MAVLink command to its acknowledgement with the same fake: from L through host and guard,
with the driver alone, and with pymavlink's own connection."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from guards.copters import bindings, fake_copters
from harness.checkout import Checkout, paced_mission
from harness.figure import Figure
from harness.paced import Paced, Round
from harness.processes import Processes
from harness.samples import Contender

from lfield import event_loop
from lfield.clock import SystemClock
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.testing.kept_reports import KeptReports

COMMANDS = 200
RAW = str(Path(__file__).with_name("mavlink_raw.py"))


def pymavlink(checkout: Checkout, processes: Processes) -> Contender:
    """Run mavlink_raw.py."""
    port = fake_copters(checkout, processes)
    return Paced([checkout.run(processes, RAW, port, str(COMMANDS))])


def driver(checkout: Checkout, processes: Processes) -> Contender:
    """Run the driver in this process, without a guard."""
    port = fake_copters(checkout, processes)
    return lambda: event_loop.run(_driver_commands(port))


def whole(checkout: Checkout, processes: Processes) -> Contender:
    """Run the pilot of device.L, with a fake copter behind a guard."""
    devices = bindings([(fake_copters(checkout, processes), 1)])
    program = Path(__file__).with_name("device.L")
    return paced_mission(checkout, processes, program, [f"//Pilot:v0@here?{COMMANDS}"], devices)


async def _driver_commands(port: str) -> Round:
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    installed = plugins.by_driver["mavlink"]
    options = {o.name: o.default for o in installed.manifests["Mavlink"].options if o.default is not None}
    binding = DeviceBinding(
        agent="v0", field="fc", type="Mavlink", driver="mavlink", endpoint=f"udp:127.0.0.1:{port}",
        safe_state="land", options=options, waivers=["device_watchdog"],
    )  # fmt: skip
    driver = installed.plugin.load()([binding], installed.manifests, SystemClock(), KeptReports())
    await driver.open()
    try:
        device, samples = driver.devices["v0.fc"], []
        await device.open()
        for _ in range(COMMANDS):
            start = time.perf_counter()
            await device.execute("command", [512, [148.0]])
            samples.append(time.perf_counter() - start)
        return {"command to acknowledgement": samples}
    finally:
        await driver.close()
        await asyncio.sleep(0)


FIGURE = Figure(
    "A MAVLink command; ratio to pymavlink's mavutil",
    {"pymavlink": pymavlink, "the driver alone": driver, "L, host and guard": whole},
    base=("pymavlink",),
    one_size="one command",
    targets={"the driver alone": "1.11x"},
    notes=(f"rounds of {COMMANDS} commands that move nothing",),
    between=("L, host and guard",),
)
