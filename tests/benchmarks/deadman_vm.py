"""The host's end of some guards, for `deadman`: flies one copter on each port with velocity setpoints.

    python deadman_vm.py TTL expire|last PORT...

Prints `up` when all fly, then `sent VEHICLE TIME NUMBER` for each setpoint, and `latched VEHICLE` when a safe
state is confirmed; then it releases the device and flies on. With `expire` each device gets a few setpoints
and then none until its time-to-live has ended it; with `last` setpoints go on until somebody ends or stops
this process.
"""

from __future__ import annotations

import asyncio
import itertools
import random
import sys
import time

from lfield.clock import SystemClock
from lfield.devices.guards import Guards
from lfield.devices.try_out import LiveBench
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import DeviceError

#: Seconds between two setpoints, and metres of height to fall safe from.
PACE, HEIGHT = 0.1, 80.0


def binding(number: int, port: int, ttl: float) -> DeviceBinding:
    """The copter behind a port."""
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    manifest = plugins.by_driver["mavlink"].manifests["Mavlink"]
    options = {option.name: option.default for option in manifest.options if option.default is not None}
    return DeviceBinding(
        agent=f"v{number}", field="fc", type="Mavlink", driver="mavlink", endpoint=f"udp:127.0.0.1:{port}",
        safe_state="land", ttl=ttl, options=options, waivers=["device_watchdog"],
    )  # fmt: skip


async def fly(number: int, bench: LiveBench, expire: bool, flying: asyncio.Barrier) -> None:
    """One copter, for ever."""
    await bench.call("release")
    await bench.call("arm")
    if bench.query("landed"):
        await bench.call("takeoff", HEIGHT)
    await flying.wait()
    dice = random.Random(number)
    numbers = itertools.count(1)
    while True:
        for _ in range(dice.randint(2, 6)) if expire else itertools.count():
            setpoint = next(numbers) % 1000
            try:
                # Told before it is sent: what is on the wire later than this plus its time is late.
                print(f"sent {number} {time.monotonic():.6f} {setpoint}", flush=True)
                await bench.call("setVelocity", setpoint / 1000.0, 0.0, 0.0)
            except DeviceError:
                break
            await asyncio.sleep(PACE)
        while not bench.confirmed:
            await asyncio.sleep(0.01)
        print(f"latched {number}", flush=True)
        await bench.call("release")


async def main() -> None:
    """Open everything, then fly."""
    ttl, way, ports = float(sys.argv[1]), sys.argv[2], [int(port) for port in sys.argv[3:]]
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    # Nobody reads a log here: a pipe that is full would be a machine that hangs, and not the one meant.
    guards = Guards(plugins, SystemClock(), lambda line: None)
    devices = [binding(number, port, ttl) for number, port in enumerate(ports)]
    await guards.open(devices)
    manifest = plugins.by_driver["mavlink"].manifests["Mavlink"]
    flying = asyncio.Barrier(len(devices) + 1)
    flights = [
        asyncio.create_task(fly(n, LiveBench(guards, device, manifest, []), way == "expire", flying))
        for n, device in enumerate(devices)
    ]
    waiting = asyncio.create_task(flying.wait())
    done, _ = await asyncio.wait([waiting, *flights], return_when=asyncio.FIRST_COMPLETED)
    if waiting not in done:
        await next(iter(done))
    print("up", flush=True)
    await asyncio.gather(*flights)


if __name__ == "__main__":
    asyncio.run(main())
