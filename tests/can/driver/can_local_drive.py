"""A drive with canopen's LocalNode: SDO server, NMT and heartbeat are canopen's, the axis is simulated."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Any

import canopen
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.objectdictionary import datatypes as t

from lfield_can.bus.frames import Frame

STEP = 0.005
U8, U16, U32, I8, I16, I32 = t.UNSIGNED8, t.UNSIGNED16, t.UNSIGNED32, t.INTEGER8, t.INTEGER16, t.INTEGER32

#: (index, subindex): (type, value)
OBJECTS: dict[tuple[int, int], tuple[int, int]] = {
    (0x1000, 0): (U32, 0x00020192),
    (0x1001, 0): (U8, 0),
    (0x1016, 0): (U8, 1),
    (0x1016, 1): (U32, 0),
    (0x1017, 0): (U16, 0),
    (0x1018, 1): (U32, 0xABC),
    (0x1018, 2): (U32, 7),
    (0x1018, 4): (U32, 4711),
    (0x6007, 0): (I16, 0),
    (0x603F, 0): (U16, 0),
    (0x6040, 0): (U16, 0),
    (0x6041, 0): (U16, 0x0240),
    (0x605A, 0): (I16, 2),
    (0x6060, 0): (I8, 0),
    (0x6061, 0): (I8, 0),
    (0x6064, 0): (I32, 0),
    (0x606C, 0): (I32, 0),
    (0x6071, 0): (I16, 0),
    (0x6076, 0): (U32, 500),
    (0x6079, 0): (U32, 24_500),
    (0x607A, 0): (I32, 0),
    (0x607D, 1): (I32, 0),
    (0x607D, 2): (I32, 0),
    (0x607F, 0): (U32, 0),
    (0x6081, 0): (U32, 0),
    (0x6083, 0): (U32, 0),
    (0x6084, 0): (U32, 0),
    (0x6085, 0): (U32, 0),
    (0x6098, 0): (I8, 0),
    (0x6099, 1): (U32, 0),
    (0x6099, 2): (U32, 0),
    (0x60FF, 0): (I32, 0),
}
for _number, _transmitted in ((0, True), (1, True), (0, False), (1, False), (2, False), (3, False)):
    _pdo, _map = (0x1800, 0x1A00) if _transmitted else (0x1400, 0x1600)
    OBJECTS |= {
        (_pdo + _number, 1): (U32, 1 << 31), (_pdo + _number, 2): (U8, 255), (_pdo + _number, 5): (U16, 0),
        (_map + _number, 0): (U8, 0), (_map + _number, 1): (U32, 0), (_map + _number, 2): (U32, 0),
    }  # fmt: skip


def dictionary(without: set[int]) -> canopen.ObjectDictionary:
    od = canopen.ObjectDictionary()
    records = {index for index, subindex in OBJECTS if subindex}
    for (index, subindex), (kind, value) in OBJECTS.items():
        if index in without:
            continue
        variable = ODVariable(f"{index:X}-{subindex}", index, subindex)
        variable.data_type, variable.default, variable.pdo_mappable = kind, value, True
        if index not in records:
            od.add_object(variable)
            continue
        if index not in od:
            od.add_object(ODRecord(f"{index:X}", index))
        od[index].add_member(variable)
    return od


class Network(canopen.Network):
    """canopen on a bus in memory; periodic messages run on the loop."""

    def __init__(self, say: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self.say = say

    def send_message(self, can_id, data, remote=False):
        self.say(can_id, bytes(data))

    def send_periodic(self, can_id, data, period, remote=False):
        return Periodic(self, can_id, data, period)


class Periodic:
    def __init__(self, network: Network, can_id: int, data: Any, period: float) -> None:
        self.network, self.can_id, self.data = network, can_id, data
        self.task = asyncio.get_running_loop().create_task(self.run(period))

    async def run(self, period: float) -> None:
        while True:
            self.network.say(self.can_id, bytes(self.data))
            await asyncio.sleep(period)

    def update(self, data: Any) -> None:
        self.data = data

    def stop(self) -> None:
        self.task.cancel()


class LocalDrive:
    """`live()` runs beside the driver; `bus` is the bus that it is attached to."""

    bus: Any

    def __init__(self, node: int = 5, *, without: set[int] = frozenset(), modes: int | None = None) -> None:
        self.id, self.without = node, without
        self.position = self.velocity = 0.0
        self.state, self.failed = 0x0240, False
        self.acknowledged = self.reached = False
        self.controls: list[int] = []
        self.beats: list[float] = []
        self.silent = self.stuck = self.deaf_to_halt = False

    async def live(self) -> None:
        self.attach()
        await asyncio.Event().wait()

    def attach(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.network = Network(self.say)
        self.node = canopen.LocalNode(self.id, dictionary(self.without))
        self.network.add_node(self.node)
        self.node.add_write_callback(self.on_write)
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.bus.device = self.on_frame
        self.task = self.loop.create_task(self.run())

    def say(self, can_id: int, data: bytes) -> None:
        if not self.silent:
            self.bus.say(can_id, data)

    def restart(self) -> None:
        """Power off and on."""
        self.node.nmt.stop_heartbeat()
        self.task.cancel()
        self.__init__(self.id, without=self.without)
        self.attach()

    # -- objects

    def get(self, index: int, subindex: int = 0) -> int:
        return self.node.object_dictionary.get_variable(index, subindex).decode_raw(
            self.node.get_data(index, subindex)
        )

    def set(self, index: int, value: int) -> None:
        variable = self.node.object_dictionary.get_variable(index, 0)
        self.node.data_store.setdefault(index, {})[0] = variable.encode_raw(value)

    # -- the bus

    def on_frame(self, frame: Frame) -> None:
        if self.silent:
            return
        if frame.id == 0x77F:
            self.beats.append(self.loop.time())
        code = frame.id - self.id
        if code in (0x200, 0x300, 0x400, 0x500) and self.node.nmt.state == "OPERATIONAL":
            self.on_process_data(0x1600 + ((code - 0x200) >> 8), frame.data)
            return
        self.network.notify(frame.id, bytearray(frame.data), 0.0)

    def on_process_data(self, mapping: int, data: bytes) -> None:
        for subindex in range(1, self.get(mapping, 0) + 1):
            entry = self.get(mapping, subindex)
            size = (entry & 0xFF) // 8
            self.node.set_data(entry >> 16, entry >> 8 & 0xFF, data[:size])
            data = data[size:]

    def send_process_data(self, number: int) -> None:
        if self.node.nmt.state != "OPERATIONAL" or self.get(0x1800 + number, 1) >> 31:
            return
        entries = [self.get(0x1A00 + number, s) for s in range(1, self.get(0x1A00 + number, 0) + 1)]
        data = b"".join(self.node.get_data(entry >> 16, entry >> 8 & 0xFF) for entry in entries)
        self.say(self.get(0x1800 + number, 1), data)

    # -- the axis

    def on_write(self, index: int, data: bytes, **rest: Any) -> None:
        if index == 0x6040:
            self.on_control(struct.unpack("<H", data)[0])
        elif index == 0x6060:
            self.set(0x6061, struct.unpack("<b", data)[0])

    def on_control(self, word: int) -> None:
        self.controls.append(word)
        enabled = self.state == 0x0237
        if self.failed:
            if word & 0x80:
                self.failed, self.state = False, 0x0240
        elif not word & 0x02:
            self.state = 0x0240
        elif not word & 0x04:
            self.state = 0x0217 if enabled else 0x0240
        elif word & 0x0F == 0x06:
            self.state = 0x0231
        elif word & 0x0F == 0x07 and self.state != 0x0240:
            self.state = 0x0233
        elif word & 0x0F == 0x0F and self.state in (0x0233, 0x0237):
            self.state = 0x0237
            self.acknowledged = bool(word & 0x10)
            if self.get(0x6061) == 1 and word & 0x10:
                self.goal = self.get(0x607A)
                self.travel = True
            if self.get(0x6061) == 6:
                self.acknowledged = False
                self.homing = bool(word & 0x10)
        self.report()

    goal: float = 0.0
    travel = homing = False

    def fail(self, code: int) -> None:
        self.failed, self.state = True, 0x0218
        self.set(0x603F, code)
        self.say(0x80 + self.id, struct.pack("<HB5x", code, 1))
        self.report()

    def report(self) -> None:
        bits = (0x1000 if self.acknowledged else 0) | (0x0400 if self.reached else 0)
        self.set(0x6041, self.state | bits)
        self.send_process_data(0)

    async def run(self) -> None:
        ticks = 0
        while True:
            await asyncio.sleep(STEP)
            ticks += 1
            self.move()
            if ticks % 4 == 0:
                self.report()
                self.send_process_data(1)

    def move(self) -> None:
        self.velocity = 0.0
        mode = self.get(0x6061)
        halted = bool(self.controls and self.controls[-1] & 0x100) and not self.deaf_to_halt
        if self.state == 0x0237 and not (self.stuck or halted):
            if mode in (3, 9):
                self.velocity = self.get(0x60FF)
            elif mode == 1 and self.travel:
                speed = self.get(0x6081) * STEP
                self.velocity = max(-speed, min(speed, self.goal - self.position)) / STEP
            elif mode == 8:
                self.velocity = (self.get(0x607A) - self.position) / STEP
            elif mode == 6 and self.homing:
                self.position, self.acknowledged, self.reached = 0.0, True, True
        if self.state != 0x0237:
            self.travel = False
        self.position += self.velocity * STEP
        self.set(0x6064, round(self.position))
        self.set(0x606C, round(self.velocity))
