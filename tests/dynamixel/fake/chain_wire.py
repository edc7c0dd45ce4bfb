"""The port of a vendor's SDK with simulated servos at its end; each query of the time advances it."""

from __future__ import annotations

from lfield_sim.dynamixel.servo_chain import ServoChain, TimedReply


class ChainWire:
    """The behaviour of an SDK's PortHandler on virtual time: a base class before the SDK's own."""

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
