"""A CANopen node: NMT, heartbeats both ways, SDO, PDOs, SYNC and emergencies (CiA 301). Pure."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from enum import IntEnum

from lfield_sim.can.can_bus import CanFrame, FaultLookup
from lfield_sim.can.canopen import pdo
from lfield_sim.can.canopen.pdo import Rpdo, Tpdo
from lfield_sim.can.canopen.sdo import ObjectDictionary, SdoServer

NMT, SYNC, HEARTBEAT = 0x000, 0x080, 0x700
#: Communication error codes (CiA 301, table 26) and their bit in the error register 0x1001.
HEARTBEAT_LOST, PDO_TOO_SHORT, COMMUNICATION = 0x8130, 0x8210, 0x10


class Nmt(IntEnum):
    """States in the heartbeat."""

    BOOT = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


_NMT_COMMANDS = {1: Nmt.OPERATIONAL, 2: Nmt.STOPPED, 128: Nmt.PRE_OPERATIONAL}
_RESET_NODE, _RESET_COMMUNICATION = 129, 130


class CanopenNode:
    """The communication of one node. The application sets the `on_...` callbacks."""

    def __init__(self, node: int, objects: ObjectDictionary, flaw: FaultLookup) -> None:
        self.node, self.objects, self._flaw = node, objects, flaw
        self.state = Nmt.BOOT
        self.on_reset: Callable[[], None] = lambda: None
        self.on_heartbeat_lost: Callable[[], None] = lambda: None
        self.on_heartbeat_back: Callable[[], None] = lambda: None
        self._random = random.Random(node)
        self._sdo = SdoServer(objects)
        objects.guard(lambda key, value: pdo.guard(objects, key, value))
        objects.watch(self._written)
        self._emergencies: list[CanFrame] = []
        self._since_heartbeat = 0.0
        self._reset()

    def boot(self) -> list[CanFrame]:
        """Restarts with power-up values; returns the boot-up message."""
        self.objects.reset()
        self._reset()
        self.state = Nmt.PRE_OPERATIONAL
        self.on_reset()
        return [CanFrame(HEARTBEAT + self.node, bytes([Nmt.BOOT]))]

    def emergency(self, code: int, register: int) -> None:
        """Reports an error (code 0: no error); `register` is the whole of 0x1001."""
        self.objects.put(0x1001, register)
        if code:
            errors = [self.objects.get(0x1003, n) for n in range(1, 4)]
            for n, error in enumerate([code, *errors], 1):
                self.objects.put(0x1003, error, n)
            self.objects.put(0x1003, min(4, self.objects.get(0x1003) + 1))
        identifier = self.objects.get(0x1014)
        if not identifier & pdo.INVALID and self.state in (Nmt.OPERATIONAL, Nmt.PRE_OPERATIONAL):
            data = struct.pack("<HB5x", code, register)
            self._emergencies.append(CanFrame(identifier & 0x7FF, data))

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame; returns the answers."""
        if frame.error or frame.remote or frame.fd or frame.extended:
            return []
        identifier, data = frame.identifier, frame.data
        if identifier == NMT:
            return self._command(data)
        if identifier == 0x600 + self.node:
            return self._answer(data)
        if identifier == self.objects.get(0x1005) & 0x7FF:
            return self._sync()
        if identifier & 0x780 == HEARTBEAT:
            self._on_heartbeat(identifier & 0x7F)
        elif self.state is Nmt.OPERATIONAL:
            self._on_pdo(identifier, data)
        return []

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time; returns heartbeats, emergencies and PDOs that are due."""
        if self.state is Nmt.BOOT:
            return []
        self._watch_heartbeat(dt)
        frames, self._emergencies = self._emergencies, []
        self._since_heartbeat += dt
        period = self.objects.get(0x1017) / 1000.0
        if period and self._since_heartbeat >= period - 1e-9:
            self._since_heartbeat = 0.0
            if not self._flaw("lost_heartbeat"):
                frames.append(CanFrame(HEARTBEAT + self.node, bytes([self.state])))
        if self.state is Nmt.OPERATIONAL:
            frames += self._sent([tpdo for tpdo in self._tpdos if tpdo.due(dt)])
        return frames

    def _reset(self) -> None:
        self._rpdos = [Rpdo(self.objects, n) for n in range(4)]
        self._tpdos = [Tpdo(self.objects, n) for n in range(4)]
        self._emergencies.clear()
        self._since_heartbeat = 0.0
        #: Seconds since the heartbeat monitored by 0x1016; None before the first, and after a loss.
        self._master_silence: float | None = None
        #: Whether that heartbeat was lost.
        self.master_lost = False

    def _command(self, data: bytes) -> list[CanFrame]:
        if len(data) != 2 or data[1] not in (0, self.node):
            return []
        if data[0] in (_RESET_NODE, _RESET_COMMUNICATION):
            return self.boot()
        self.state = _NMT_COMMANDS.get(data[0], self.state)
        return []

    def _answer(self, request: bytes) -> list[CanFrame]:
        if self.state not in (Nmt.OPERATIONAL, Nmt.PRE_OPERATIONAL):
            return []
        answer = self._sdo.answer(request)
        if answer is None:
            return []
        if self._random.random() < self._flaw("nonsense"):
            answer = self._random.randbytes(8)
        return [CanFrame(0x580 + self.node, answer)]

    def _sync(self) -> list[CanFrame]:
        if self.state is not Nmt.OPERATIONAL:
            return []
        for rpdo in self._rpdos:
            rpdo.apply()
        return self._sent([tpdo for tpdo in self._tpdos if tpdo.due_at_sync()])

    def _sent(self, tpdos: list[Tpdo]) -> list[CanFrame]:
        lost = self._flaw("lost_tpdo")
        return [CanFrame(t.identifier, t.data()) for t in tpdos if t.identifier is not None and not lost]

    def _on_pdo(self, identifier: int, data: bytes) -> None:
        for rpdo in self._rpdos:
            if rpdo.identifier == identifier and not rpdo.on_data(data):
                self.emergency(PDO_TOO_SHORT, self.objects.get(0x1001) | COMMUNICATION)

    def _written(self, key: tuple[int, int], _: int) -> None:
        if key == (0x1016, 1):
            self._master_silence = None

    def _on_heartbeat(self, node: int) -> None:
        watched = self.objects.get(0x1016, 1)
        if watched & 0xFFFF and watched >> 16 & 0x7F == node:
            self._master_silence = 0.0
            if self.master_lost:
                self.master_lost = False
                self.on_heartbeat_back()

    def _watch_heartbeat(self, dt: float) -> None:
        if self._master_silence is None:
            return
        self._master_silence += dt
        if self._master_silence > (self.objects.get(0x1016, 1) & 0xFFFF) / 1000.0:
            self._master_silence, self.master_lost = None, True
            self.on_heartbeat_lost()
