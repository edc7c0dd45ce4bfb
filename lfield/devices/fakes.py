"""Fakes that a host starts for `--sim`: processes of their own, which end with the host whatever happens."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import msgspec

from lfield.driver.binding import SIMULATED, DeviceBinding, by_bus
from lfield.driver.sims import Sims, sims_of
from lfield.errors import PluginError

#: Seconds for a fake to be ready, and to end when it is told.
READY, END = 20.0, 3.0
#: How many characters of what a fake says while it starts are kept, the last ones.
MOST = 1 << 16


@dataclass(frozen=True, slots=True)
class Fake:
    """A running fake and the endpoint where it answers."""

    endpoint: str
    process: asyncio.subprocess.Process
    words: Words

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
        await self.words.end()


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
        *(sys.executable, "-P", "-m", "lfield.driver.sims", reference, *options, "--until-stdin-closes"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    words = Words(process.stderr)
    try:
        async with asyncio.timeout(READY):
            line = (await process.stdout.readline()).decode("utf-8", "replace")
    except TimeoutError:
        line = ""
    fake = Fake(next(iter(line.split()[1:2]), ""), process, words)
    if not line.startswith("ready ") or not fake.endpoint:
        await fake.stop()
        raise PluginError(words.why(f"{names}: the fake '{sim.name}' did not start", line))
    words.let_out()
    return fake


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


class Words:
    """What a fake writes to stderr: kept while it starts, since it may say why not, then passed on."""

    def __init__(self, stream: asyncio.StreamReader) -> None:
        self._kept: str | None = ""
        self._reading = asyncio.create_task(self._read(stream))

    async def _read(self, stream: asyncio.StreamReader) -> None:
        while data := await stream.read(1 << 16):
            text = data.decode("utf-8", "replace")
            if self._kept is None:
                sys.stderr.write(text)
                sys.stderr.flush()
            else:
                self._kept = (self._kept + text)[-MOST:]

    def let_out(self) -> None:
        """Pass on what was said, and from now on all that is."""
        kept, self._kept = self._kept, None
        sys.stderr.write(kept or "")

    def why(self, what: str, said: str) -> str:
        """`what` with the words of a fake that has ended, on stderr or in `said`; of a traceback the last."""
        lines = [line.strip() for line in f"{self._kept or ''}\n{said}".splitlines() if line.strip()]
        if any(line.startswith("Traceback") for line in lines):
            lines = lines[-1:]
        return f"{what}; it said: {' '.join(lines)}" if lines else f"{what}, and said nothing"

    async def end(self) -> None:
        """Wait for the last words. A process of its own that still has the stream is not waited for."""
        with suppress(TimeoutError):
            async with asyncio.timeout(END):
                await self._reading
        self._reading.cancel()
