"""The port of a vendor's SDK with simulated servos at its end; asking what time it is lets some pass."""

from __future__ import annotations

from lfield_sim.dynamixel.servo_chain import ServoChain, TimedReply


class ChainWire:
    """What an SDK's PortHandler does, on given time: a base of it, before the SDK's own class."""

    chain: ServoChain
    now: float
    baudrate: int

    def connect(self, chain: ServoChain, baudrate: int) -> None:
        self.chain, self.now = chain, 1.0
        self._coming: list[TimedReply] = []
        self.baudrate, self.tx_time_per_byte = baudrate, 10_000.0 / baudrate

    def clearPort(self) -> None:  # the SDK's own name, like those below
        self._coming.clear()

    def writePort(self, packet) -> int:
        self._coming += self.chain.receive(bytes(packet), self.now, self.baudrate)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        self.now += 0.0005
        there = b"".join(reply.data for reply in self._coming if reply.at <= self.now)
        later = [reply for reply in self._coming if reply.at > self.now]
        self._coming = ([TimedReply(0.0, there[length:])] if there[length:] else []) + later
        return there[:length]

    def getCurrentTime(self) -> float:
        return self.now * 1000.0

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.chain.advance(self.now)
