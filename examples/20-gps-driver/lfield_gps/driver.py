"""One receiver on one serial port, `serial:PATH:BAUD`. It sends by itself; nothing is sent to it."""

from __future__ import annotations

import asyncio
from typing import Any

from lfield.driver import Device, DeviceBinding, Driver
from lfield.driver.serial import Lines, SerialLine
from lfield_gps.nmea import LONGEST, Nonsense, parse

#: Seconds between two checks, and without a valid sentence after which it is lost.
CHECK_INTERVAL, SILENCE = 0.1, 3.0


class GpsDriver(Driver):
    """The port and its framer: a sentence is a line."""

    def _set_up(self) -> None:
        self._line = SerialLine(
            self.endpoint,
            Lines(b"\n", longest=LONGEST),
            on_frame=self._sentence,
            note=self._note,
            wire_log=self.wire_log,
        )

    def _device(self, binding: DeviceBinding) -> GpsDevice:
        return GpsDevice(binding, self.manifests[binding.type], self.clock, self.reports)

    async def _open(self) -> None:
        first, *others = self.devices.values()
        if others:
            raise first.error(f"{self.endpoint} supports one receiver, with one binding")
        self._line.open()
        self.spawn(self._receiver.watch())

    async def _close(self) -> None:
        self._line.close()

    @property
    def _receiver(self) -> GpsDevice:
        return next(device for device in self.devices.values() if isinstance(device, GpsDevice))

    def _sentence(self, line: bytes) -> None:
        self._receiver.on_line(line)

    def _note(self, text: str) -> None:
        self._receiver.note(text)


class GpsDevice(Device):
    """A receiver. A pure sensor: no safe state, no watchdog, no motion."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.malformed = 0
        self._fix = ""
        self._received_at: float | None = None
        self._lost = False

    def on_line(self, line: bytes) -> None:
        """Handles a line of the port; invalid lines are counted and dropped."""
        try:
            values = parse(line)
        except Nonsense:
            self.malformed += 1
            self.publish(malformed=self.malformed)
            return
        self._received_at = self.clock.monotonic()
        self._fix = str(values.get("fix", self._fix))
        self.heard()
        self.publish(**values)

    async def watch(self) -> None:
        """Logs loss and recovery of the receiver."""
        while True:
            await asyncio.sleep(CHECK_INTERVAL)
            silent = self._received_at is not None and self.clock.monotonic() - self._received_at > SILENCE
            if silent != self._lost:
                self._lost = silent
                self.note("no sentence for 3 s" if silent else "heard again")
                # An earlier fix is outdated.
                self._fix = "" if silent else self._fix

    async def _open(self) -> str:
        patience: float = self.binding.option("connect")
        end = self.clock.monotonic() + patience
        while self._received_at is None:
            if self.clock.monotonic() >= end:
                received = f"{self.malformed} lines that are not NMEA" if self.malformed else "nothing"
                raise self.error(
                    f"received {received} within {patience:g} s; check the wires and the baud rate",
                    timeout=True,
                )
            await asyncio.sleep(CHECK_INTERVAL)
        self.publish(malformed=self.malformed)
        return f"NMEA receiver, fix: {self._fix or 'not known yet'}"

    async def do_wait_fix(self, seconds: float) -> bool:
        """Waits for a fix."""
        end = self.clock.monotonic() + seconds
        while self._fix in ("", "none"):
            if not self.clock.monotonic() < end:
                return False
            await asyncio.sleep(CHECK_INTERVAL)
        return True
