"""Contact with one axis: its frames, being lost and found, its safe states. What it can do is in CanAxis."""

from __future__ import annotations

import asyncio
import math

from lfield.clock import Clock
from lfield.driver import Device, DeviceBinding, Manifest, Reports
from lfield.errors import DeviceError
from lfield_can.bus import Bus
from lfield_can.frames import Frame
from lfield_can.protocols import PROTOCOLS, Wiring
from lfield_can.waiting import News

#: Seconds between two looks at a device that says nothing.
LOOK = 0.1
#: Seconds between two calls to a device that has not been heard yet.
CALL = 0.3
#: Seconds between two polls.
POLL = 1.0
#: Seconds until the command of a safe state is sent again, and until the guard is told that it failed.
SAFE_AGAIN, SAFE_BY = 0.2, 5.0


class AxisContact(Device):
    """An axis that is heard, set up and made safe."""

    def __init__(
        self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports, bus: Bus
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self._news = News(clock)
        wiring = Wiring(binding, bus, clock, self._news, self.note, self.error)
        self.protocol = PROTOCOLS[binding.option("protocol")](wiring)
        self.malformed = 0
        self._heard_at: float | None = None
        self._lost = self._quiet = self._opened = False
        self._polled = 0.0

    # -- frames and signs of life -----------------------------------------------------------------------

    def prepare(self) -> None:
        """Read its files. Raises DeviceError."""
        self.protocol.prepare()

    def listens(self) -> frozenset[int]:
        """The keys of the frames that it wants."""
        return self.protocol.ids()

    def commands(self) -> frozenset[int]:
        """The keys that nobody else on the bus may command."""
        return self.protocol.ids()

    def on_frame(self, frame: Frame) -> None:
        """A frame of this device; one that makes no sense is counted and dropped."""
        values = self.protocol.on_frame(frame)
        if values is None:
            self.malformed += 1
            return
        self._heard_at = self.clock.monotonic()
        self.heard()
        if values:
            self.publish(**values)
        self._news.tell()

    def quiet(self, on: bool) -> None:
        """Nothing that feeds the device's watchdog from now on (False: again)."""
        self._quiet = on
        self.protocol.quiet(on)

    def close(self) -> None:
        """The driver ends."""
        self.protocol.close()

    async def watch(self) -> None:
        """Tell when the device is lost and found; bring it back standing still; poll it."""
        while True:
            await asyncio.sleep(LOOK)
            if not self._opened:
                continue
            try:
                await self._look()
            except DeviceError as error:
                self.note(f"{error.reason}; trying again")
                await asyncio.sleep(POLL)

    async def _look(self) -> None:
        silent = self._silence() > self.protocol.silence
        self.publish(online=not silent)
        if silent != self._lost:
            self._lost = silent
            self.note("it is not heard any more" if silent else "heard again")
            if silent:
                self.protocol.silent()
                self._news.tell()
            else:
                # Nobody knows what it did meanwhile: it comes back standing.
                await self.make_safe()
        if self.protocol.state.enabled and self._runs_out:
            self.note("it was leaving its bounds and is stopped")
            await self._make_safe("brake")
        if silent or self._quiet:
            return
        if self.protocol.needs_setup:
            await self.protocol.setup()
            self.note("it had restarted and is set up again, not enabled")
        if self.clock.monotonic() - self._polled >= POLL:
            self._polled = self.clock.monotonic()
            self.publish(**await self.protocol.poll())

    async def _open(self) -> str:
        await self._find()
        identity = await self.protocol.setup()
        self.publish(online=True)
        self._opened = True
        return identity

    async def _find(self) -> None:
        """Wait until the device is heard."""
        patience: float = self.binding.option("connect")
        end = self.clock.monotonic() + patience
        while self.clock.monotonic() < end:
            self.protocol.call()
            if await self._news.seen(lambda: self._heard_at is not None, min(CALL, patience)):
                return
        raise self.error(
            f"nothing heard from node {self.protocol.node} at {self.binding.endpoint} within {patience:g} s; "
            "check its power, the wires and terminators, the bit rate, and its id in the bindings",
            timeout=True,
        )

    async def _set_watchdog(self, longest: float) -> float | None:
        return await self.protocol.set_watchdog(longest)

    async def _make_safe(self, state: str) -> None:
        end = self.clock.monotonic() + SAFE_BY
        while True:
            await self.protocol.command_safe(state)
            if await self._news.seen(lambda: self.protocol.is_safe(state, self._still), SAFE_AGAIN):
                return
            if self.clock.monotonic() >= end or self._silence() > self.protocol.silence:
                break
        self._check_heard()
        raise self.error(f"it does not show the safe state {state} ({self._told()})")

    # -- what is known ----------------------------------------------------------------------------------

    @property
    def _still(self) -> bool:
        velocity = self.protocol.state.velocity
        return velocity is not None and abs(velocity) <= self.binding.option("standstill")

    @property
    def _runs_out(self) -> bool:
        """Whether it is outside its bounds and on its way farther out, as velocities may lead it."""
        position, velocity = self.protocol.state.position, self.protocol.state.velocity
        if position is None or velocity is None or self._still:
            return False
        margin = self.binding.option("tolerance")
        below = position < self.binding.option("lowest") - margin and velocity < 0.0
        return below or (position > self.binding.option("highest") + margin and velocity > 0.0)

    def _silence(self) -> float:
        return math.inf if self._heard_at is None else self.clock.monotonic() - self._heard_at

    def _told(self) -> str:
        state = self.protocol.state
        speed = "?" if state.velocity is None else f"{state.velocity:.3g}"
        return f"{state.state or 'no state'}, {speed} rad/s{f', fault: {state.fault}' if state.fault else ''}"

    def _check_heard(self) -> None:
        if self._silence() > self.protocol.silence:
            raise self.error(f"not heard for {self._silence():.1f} s", timeout=True)
