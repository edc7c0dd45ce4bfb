"""The driver of one receiver on a serial port, `serial:PATH:BAUD`. The driver only receives."""

from __future__ import annotations

import asyncio
from typing import Any

from lfield.driver import Device, DeviceBinding, Driver
from lfield.driver.serial import Lines, SerialLine
from lfield_gps.nmea import LONGEST, InvalidSentence, parse

#: Seconds: interval of checks; time without a valid sentence after which the receiver counts as lost.
CHECK_INTERVAL, SILENCE = 0.1, 3.0


class GpsDriver(Driver):
    """The serial port; each line is a sentence."""

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
    """A receiver: a pure sensor, without safe state, watchdog or motion."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.malformed = 0
        self._fix = ""
        self._received_at: float | None = None
        self._lost = False

    def on_line(self, line: bytes) -> None:
        """Publishes the values of a line; counts and drops invalid lines."""
        try:
            values = parse(line)
        except InvalidSentence:
            self.malformed += 1
            self.publish(malformed=self.malformed)
            return
        self._received_at = self.clock.monotonic()
        self._fix = str(values.get("fix", self._fix))
        self.heard()
        self.publish(**values)

    async def watch(self) -> None:
        """Logs the loss and the recovery of the receiver."""
        while True:
            await asyncio.sleep(CHECK_INTERVAL)
            silent = self._received_at is not None and self.clock.monotonic() - self._received_at > SILENCE
            if silent != self._lost:
                self._lost = silent
                self.note("no sentence for 3 s" if silent else "heard again")
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
        """Waits for a fix; returns False if there is none within the time."""
        end = self.clock.monotonic() + seconds
        while self._fix in ("", "none"):
            if not self.clock.monotonic() < end:
                return False
            await asyncio.sleep(CHECK_INTERVAL)
        return True
