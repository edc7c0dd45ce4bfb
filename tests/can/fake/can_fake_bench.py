"""A bus with fake devices on the time of the test, without a client of a real library."""

from __future__ import annotations

import struct

from lfield_sim.can.bus_world import TICK, BusWorld
from lfield_sim.can.can_bus import FAULTS, BusPort, CanFrame
from lfield_sim.can.canopen.sdo import TYPES
from lfield_sim.can.device_specs import build, parse
from lfield_sim.faults import Faults

REACHED, LIMITED, ACKNOWLEDGED, HOMED = 1 << 10, 1 << 11, 1 << 12, 1 << 12


class Bench:
    """One client on a bus with devices; `wait` advances the time."""

    def __init__(self, *devices: str, bitrate: int = 1_000_000) -> None:
        specs = [parse(text) for text in devices]
        self.faults = Faults(FAULTS, {spec.id: spec.name for spec in specs})
        self.devices = build(specs, self.faults)
        self.world = BusWorld(self.devices, self.faults, bitrate=bitrate)
        self.now = 0.0
        self.received: list[CanFrame] = []
        self.port = self.listen(self.received)

    def listen(self, heard: list[CanFrame], **options) -> BusPort:
        """Attach another client."""
        port = BusPort(lambda frame, _: heard.append(frame), **options)
        self.world.bus.attach(port)
        return port

    def send(self, identifier: int, data: bytes = b"", **options) -> None:
        self.world.bus.send(self.port, CanFrame(identifier, data, **options), self.now)

    def wait(self, seconds: float = TICK) -> list[CanFrame]:
        """Advance the time; returns the frames received meanwhile."""
        before = len(self.received)
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.world.advance(self.now)
        return self.received[before:]

    def fault(self, *texts: str) -> None:
        self.faults.apply(texts)

    def last(self, identifier: int) -> bytes:
        return next(f.data for f in reversed(self.received) if f.identifier == identifier and not f.error)


class DriveBench(Bench):
    """A CiA 402 drive, node 5, and its master."""

    def __init__(self, options: str = "") -> None:
        super().__init__(f"cia402:5{options}")
        self.drive = self.devices[0]

    def transfer(self, request: bytes) -> bytes:
        self.send(0x605, request)
        answers = [frame.data for frame in self.wait() if frame.identifier == 0x585]
        assert len(answers) == 1
        return answers[0]

    def write(self, index: int, value: int, subindex: int = 0) -> int:
        """An expedited download; the abort code, or 0."""
        length, signed = TYPES[self.drive.node.objects.entries[index, subindex].type]
        head = struct.pack("<BHB", 0x23 | (4 - length) << 2, index, subindex)
        answer = self.transfer(head + value.to_bytes(length, "little", signed=signed).ljust(4, b"\0"))
        assert answer[1:4] == head[1:4]
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def read(self, index: int, subindex: int = 0) -> int:
        answer = self.transfer(struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] != 0x80, f"{index:04X}: abort {answer[4:].hex()}"
        length, signed = TYPES[self.drive.node.objects.entries[index, subindex].type]
        return int.from_bytes(answer[4 : 4 + length], "little", signed=signed)

    def abort(self, index: int, subindex: int = 0) -> int:
        answer = self.transfer(struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] == 0x80
        return int.from_bytes(answer[4:], "little")

    def operational(self) -> None:
        self.send(0x000, b"\x01\x05")
        self.wait(0.1)

    def enable(self, mode: int) -> None:
        """Switch to OPERATION ENABLED in a mode."""
        self.operational()
        assert self.write(0x6060, mode) == 0
        for word in (0x06, 0x07, 0x0F):
            self.write(0x6040, word)
        assert self.status & 0x6F == 0x27

    @property
    def status(self) -> int:
        return self.read(0x6041)

    def emergencies(self) -> list[tuple[int, int]]:
        """Error codes with error registers."""
        return [struct.unpack_from("<HB", f.data) for f in self.received if f.identifier == 0x85]


def state(bench: DriveBench) -> int:
    return bench.status & 0x6F


def go_to(bench: DriveBench, increments: int, *, extra: int = 0) -> None:
    bench.write(0x607A, increments)
    bench.write(0x6040, 0x1F | extra)
    assert bench.status & ACKNOWLEDGED
    bench.write(0x6040, 0x0F | extra)
