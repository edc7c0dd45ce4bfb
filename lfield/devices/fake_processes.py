"""Processes of simulated devices for `--sim`, which end with the host in every case."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from contextlib import suppress

import msgspec

from lfield.driver.binding import SIMULATED, DeviceBinding, by_bus
from lfield.driver.sims import Sims, sims_of
from lfield.errors import PluginError
from lfield.event_loop import start_child

#: Seconds for a simulated device to be ready; seconds to end on request.
READY_TIMEOUT, END_TIMEOUT = 20.0, 3.0
#: The number of characters kept of a simulated device's output at startup (the last ones).
MAX_OUTPUT = 1 << 16


class FakeProcess(msgspec.Struct, frozen=True):
    """A running simulated device and its endpoint."""

    endpoint: str
    process: asyncio.subprocess.Process
    output: FakeOutput

    async def stop(self) -> None:
        """Ends the simulated device."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        try:
            async with asyncio.timeout(END_TIMEOUT):
                await self.process.wait()
        except TimeoutError:
            self.process.kill()
            await self.process.wait()
        await self.output.end()


def fault_options(bus: Sequence[DeviceBinding]) -> list[str]:
    """Faults of the bindings as options: `--fault NAME@DEVICE=VALUE`."""
    options = []
    for device in bus:
        for setting in device.sim:
            name, equals, value = setting.partition("=")
            options += ["--fault", f"{name}@{device.name}{equals}{value}" if "@" not in name else setting]
    return options


async def start_fake(sims: Sims, bus: Sequence[DeviceBinding]) -> FakeProcess:
    """Starts the simulation of all devices of one bus on a free port. Raises PluginError.

    The simulated device ends when its stdin closes, also when this process is killed. It has its own session:
    a Ctrl-C must not end it while devices are still being made safe.
    """
    names, driver = ", ".join(device.name for device in bus), bus[0].driver
    sim = sims.get(driver)
    if sim is None:
        known = ", ".join(sorted(sims)) or "none"
        raise PluginError(f"{names}: there is no simulated device for driver '{driver}' (installed: {known})")
    reference, options = sims.references[sim.name], [*sim.arguments(bus), *fault_options(bus)]
    command = (sys.executable, "-P", "-m", "lfield.driver.sims", reference, *options, "--until-stdin-closes")
    try:
        process = await start_child(*command, stdin=asyncio.subprocess.PIPE)
    except OSError as error:
        reason = error.strerror or error
        raise PluginError(f"{names}: the simulated device '{sim.name}' did not start: {reason}") from None
    assert process.stdout is not None
    assert process.stderr is not None
    output = FakeOutput(process.stderr)
    try:
        async with asyncio.timeout(READY_TIMEOUT):
            line = (await process.stdout.readline()).decode("utf-8", "replace")
    except (TimeoutError, ValueError):  # ValueError: the line is longer than the buffer
        line = ""
    except asyncio.CancelledError:
        process.kill()
        await process.wait()
        await output.end()
        raise
    fake = FakeProcess(next(iter(line.split()[1:2]), ""), process, output)
    if not line.startswith("ready ") or not fake.endpoint:
        await fake.stop()
        raise PluginError(
            output.exit_reason(f"{names}: the simulated device '{sim.name}' did not start", line)
        )
    output.flush()
    return fake


async def bind_to_fakes(
    devices: Sequence[DeviceBinding], running: list[FakeProcess], problems: list[str]
) -> list[DeviceBinding]:
    """The devices, with the simulated ones bound to the endpoints of started processes.

    The simulated devices are added to `running`, and a sentence to `problems` for each that does not start.
    After a cancellation `running` has all processes that are left.
    """

    async def start(bus: Sequence[DeviceBinding]) -> FakeProcess:
        fake = await start_fake(sims, bus)
        running.append(fake)
        return fake

    simulated = by_bus(device for device in devices if device.endpoint.startswith(SIMULATED))
    if not simulated:
        return list(devices)
    sims = sims_of({driver for driver, _ in simulated})
    started = await asyncio.gather(*map(start, simulated.values()), return_exceptions=True)
    endpoints: dict[tuple[str, str], str] = {}
    for bus, fake in zip(simulated, started, strict=True):
        if isinstance(fake, FakeProcess):
            endpoints[bus] = fake.endpoint
        elif isinstance(fake, PluginError):
            problems.append(str(fake))
        else:
            raise fake
    return [msgspec.structs.replace(d, endpoint=endpoints.get(d.bus, d.endpoint)) for d in devices]


class FakeOutput:
    """Output of a simulated device on stderr: buffered while it starts, since it may explain a failure, then
    passed on.
    """

    def __init__(self, stream: asyncio.StreamReader) -> None:
        self._buffered: str | None = ""
        self._reading = asyncio.create_task(self._read(stream))

    async def _read(self, stream: asyncio.StreamReader) -> None:
        while data := await stream.read(1 << 16):
            text = data.decode("utf-8", "replace")
            if self._buffered is None:
                sys.stderr.write(text)
                sys.stderr.flush()
            else:
                self._buffered = (self._buffered + text)[-MAX_OUTPUT:]

    def flush(self) -> None:
        """Passes on the buffered output, and all later output."""
        buffered, self._buffered = self._buffered, None
        sys.stderr.write(buffered or "")

    def exit_reason(self, event: str, output: str) -> str:
        """`event` with the output of a simulated device that has ended (stderr or `output`): only the last
        line of a traceback.
        """
        lines = [line.strip() for line in f"{self._buffered or ''}\n{output}".splitlines() if line.strip()]
        if any(line.startswith("Traceback") for line in lines):
            lines = lines[-1:]
        return f"{event}; it said: {' '.join(lines)}" if lines else f"{event}, without output"

    async def end(self) -> None:
        """Waits for the last output, but not for a child process that still has the stream."""
        with suppress(TimeoutError):
            async with asyncio.timeout(END_TIMEOUT):
                await self._reading
        self._reading.cancel()
