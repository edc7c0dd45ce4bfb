"""A port for the SDK of a vendor that is connected to simulated servos; each read advances the time."""

from __future__ import annotations

from lfield_sim.dynamixel.servo_chain import ServoChain, TimedReply


class ChainWire:
    """The methods of PortHandler of an SDK, in virtual time. Use it as the base class before PortHandler."""

    chain: ServoChain
    now: float
    baudrate: int

    def connect(self, chain: ServoChain, baudrate: int) -> None:
        self.chain, self.now = chain, 1.0
        self._pending: list[TimedReply] = []
        self.baudrate, self.tx_time_per_byte = baudrate, 10_000.0 / baudrate

    def clearPort(self) -> None:  # the SDK defines the names of these methods
        self._pending.clear()

    def writePort(self, packet) -> int:
        self._pending += self.chain.receive(bytes(packet), self.now, self.baudrate)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        self.now += 0.0005
        received = b"".join(reply.data for reply in self._pending if reply.at <= self.now)
        later = [reply for reply in self._pending if reply.at > self.now]
        self._pending = ([TimedReply(0.0, received[length:])] if received[length:] else []) + later
        return received[:length]

    def getCurrentTime(self) -> float:
        return self.now * 1000.0

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.chain.advance(self.now)
