"""Fakes that a host starts for `--sim`: processes of their own, which end with the host whatever happens."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from lfield.driver.binding import SIMULATED, DeviceBinding, by_bus
from lfield.driver.sims import Sims, sims_of
from lfield.errors import PluginError

#: Seconds for a fake to be ready, and to end when it is told.
READY, END = 20.0, 3.0


@dataclass(frozen=True, slots=True)
class Fake:
    """A running fake and the endpoint where it answers."""

    endpoint: str
    process: asyncio.subprocess.Process

    async def stop(self) -> None:
        """End it."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        try:
            async with asyncio.timeout(END):
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()


def conditions(bus: Sequence[DeviceBinding]) -> list[str]:
    """What the bindings say of their fakes, as options: `--fault NAME@DEVICE=VALUE`."""
    options = []
    for device in bus:
        for setting in device.sim:
            name, equals, value = setting.partition("=")
            options += ["--fault", f"{name}@{device.name}{equals}{value}" if "@" not in name else setting]
    return options


async def start_fake(sims: Sims, bus: Sequence[DeviceBinding]) -> Fake:
    """Start the fake of all devices of one bus on a free port. Raises PluginError.

    The fake ends when its stdin closes, so also when this process is killed. It is in a session of its own:
    a Ctrl-C must not take it away from devices that are still being made safe.
    """
    names, driver = ", ".join(device.name for device in bus), bus[0].driver
    sim = sims.get(driver)
    if sim is None:
        known = ", ".join(sorted(sims)) or "none"
        raise PluginError(f"{names}: there is no fake for driver '{driver}' (fakes installed: {known})")
    reference, options = sims.references[sim.name], [*sim.arguments(bus), *conditions(bus)]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "lfield.driver.sims", reference, *options, "--until-stdin-closes"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(READY):
            line = (await process.stdout.readline()).decode("utf-8", "replace")
    except TimeoutError:
        line = ""
    words = line.split()
    if words[:1] != ["ready"] or len(words) < 2:
        fake = Fake("", process)
        await fake.stop()
        said = f"; it said: {line.strip()}" if line.strip() else "; see above"
        raise PluginError(f"{names}: the fake '{sim.name}' did not start{said}")
    return Fake(words[1], process)


async def on_running_fakes(
    devices: Sequence[DeviceBinding], running: list[Fake], problems: list[str]
) -> list[DeviceBinding]:
    """The same devices, the simulated ones at the endpoints of fakes that now run.

    The fakes are added to `running`, and a sentence to `problems` for each that does not start.
    """
    simulated = by_bus(device for device in devices if device.endpoint.startswith(SIMULATED))
    if not simulated:
        return list(devices)
    sims = sims_of({driver for driver, _ in simulated})
    fakes = (start_fake(sims, bus) for bus in simulated.values())
    started = await asyncio.gather(*fakes, return_exceptions=True)
    running += [fake for fake in started if isinstance(fake, Fake)]
    endpoints: dict[tuple[str, str], str] = {}
    for bus, fake in zip(simulated, started, strict=True):
        if isinstance(fake, Fake):
            endpoints[bus] = fake.endpoint
        elif isinstance(fake, PluginError):
            problems.append(str(fake))
        else:
            raise fake
    return [msgspec.structs.replace(d, endpoint=endpoints.get(d.bus, d.endpoint)) for d in devices]
