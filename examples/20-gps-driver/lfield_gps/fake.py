"""A simulated receiver on a pseudo-terminal, as behind a USB adapter. It moves on a circle."""

from __future__ import annotations

import argparse
import asyncio
import math
import random
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from lfield.driver import DeviceBinding
from lfield_gps.nmea import KNOT, sentence
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Fault, Faults, add_fault_option, share
from lfield_sim.terminal import Terminal

#: Centre of the circle in degrees and metres; radius in metres; speed in m/s.
LATITUDE, LONGITUDE, HEIGHT, RADIUS, SPEED = 47.397742, 8.545594, 488.0, 20.0, 2.0
#: Metres of a degree of latitude.
DEGREE = 111_320.0
#: The number of the simulated receiver.
NUMBER = "1"
#: Ten times a second, the three sentences have 2,000 bytes/s, too many for 9,600 baud.
BAUD = 38_400
START = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)

FAULTS = (
    share("noise", "bytes that are replaced by others"),
    share("half", "sentences that end in their middle"),
    Fault("no_fix", False, "it sees no satellites"),
    Fault("silent", False, "it sends nothing"),
    Fault("unplug", False, "the adapter is pulled out"),
)


def sentences(seconds: float, *, fix: bool = True) -> bytes:
    """The sentences GGA, GSA and RMC at a time since the start."""
    angle = SPEED / RADIUS * seconds
    north, east = on_circle(seconds)
    latitude = LATITUDE + north / DEGREE
    longitude = LONGITUDE + east / DEGREE / math.cos(math.radians(LATITUDE))
    place = f"{_minutes(latitude, 2)},N,{_minutes(longitude, 3)},E" if fix else ",,,"
    now = START + timedelta(seconds=seconds)
    clock, course = now.strftime("%H%M%S.%f")[:9], math.degrees(angle + math.pi / 2.0) % 360.0
    height = f"1,09,0.9,{HEIGHT:.1f},M,47.0,M" if fix else "0,00,,,M,,M"
    moving = f"A,{place},{SPEED / KNOT:.2f},{course:.1f}" if fix else f"V,{place},,"
    used = "3,04,05,09,12,17,19,24,25,29,,,,2.1,0.9,1.9" if fix else "1,,,,,,,,,,,,,,,"
    bodies = (
        f"GNGGA,{clock},{place},{height},,",
        f"GNGSA,A,{used}",
        f"GNRMC,{clock},{moving},{now:%d%m%y},,,A",
    )
    return b"".join(map(sentence, bodies))


def on_circle(seconds: float) -> tuple[float, float]:
    """The position at a time since the start: metres north and east of the centre."""
    angle = SPEED / RADIUS * seconds
    return RADIUS * math.cos(angle), RADIUS * math.sin(angle)


def _minutes(degrees: float, digits: int) -> str:
    whole = int(degrees)
    return f"{whole:0{digits}d}{(degrees - whole) * 60.0:08.5f}"


class Receiver:
    """The receiver and its adapter; `path` is a link to the terminal, also after it is plugged in again."""

    def __init__(self, path: Path, faults: Faults, rate: float) -> None:
        self._faults, self._rate = faults, rate
        self._terminal = Terminal(path, lambda data, baud: None)  # ignores received data
        self._rng = random.Random(1)
        self._seconds = 0.0

    @property
    def place(self) -> tuple[float, float, float]:
        """The position: metres north, east and up of the centre."""
        return *on_circle(self._seconds), 0.0

    async def run(self) -> None:
        """Sends sentences `rate` times a second."""
        while True:
            self.set_plugged(not self._fault("unplug"))
            if not self._fault("silent"):
                self._terminal.write(self._damaged(sentences(self._seconds, fix=not self._fault("no_fix"))))
            await asyncio.sleep(1.0 / self._rate)
            self._seconds += 1.0 / self._rate

    def set_plugged(self, plugged: bool) -> None:
        """Plugs the adapter in, or unplugs it, so that a client gets an input/output error.

        Raises AddressError.
        """
        if plugged:
            self._terminal.plug()
        else:
            self._terminal.unplug()

    def _fault(self, name: str) -> Any:
        return self._faults.get(name, NUMBER)

    def _damaged(self, data: bytes) -> bytes:
        noise, half, rng = self._fault("noise"), self._fault("half"), self._rng
        lines = [line[: len(line) // 2] if rng.random() < half else line for line in data.splitlines(True)]
        return bytes(rng.randrange(256) if rng.random() < noise else byte for byte in b"".join(lines))


class GpsSim:
    """The simulated device for `lfield sim gps` and `lfield up --sim`."""

    name = "gps"
    help = "A receiver that drives in a circle of 20 m and sends NMEA 0183 on a pseudo-terminal."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the endpoint, the rate and the faults."""
        parser.add_argument("--listen", default="", metavar="PATH", help="of the link to its terminal")
        parser.add_argument("--rate", type=float, default=5.0, metavar="HZ", help="from 1 to 10 (5)")
        parser.add_argument("--called", default="", metavar="NAME", help="the name of its binding")
        parser.add_argument("--until-stdin-closes", action="store_true", help="end with who started it")
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The command line of the simulated device of a binding."""
        return ["--called", devices[0].name]

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped."""
        with tempfile.TemporaryDirectory(prefix="lfield-gps-") as folder:
            args.listen = args.listen or f"{folder}/gps"
            asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """Serves in the running event loop, for example of a test with virtual time."""
        faults = Faults(FAULTS, {NUMBER: args.called})
        faults.apply(args.fault)
        path = args.listen or f"/dev/{args.called or 'gps'}"
        receiver = Receiver(Path(path), faults, min(10.0, max(1.0, args.rate)))
        receiver.set_plugged(True)
        sending = asyncio.get_running_loop().create_task(receiver.run())
        await serve_until_stopped(
            "gps",
            f"serial:{path}:{BAUD}",
            "",
            faults,
            devices={NUMBER: args.called},
            until_stdin_closes=args.until_stdin_closes,
            places={NUMBER: lambda: receiver.place},
        )
        sending.cancel()
        receiver.set_plugged(False)


SIM = GpsSim()
