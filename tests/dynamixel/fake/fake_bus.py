"""A chain of simulated servos with a clock of the test, and a parser for its answers."""

from __future__ import annotations

import struct

from lfield_sim.dynamixel.packets import Instruction, crc16, encode, unstuff
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.servo_chain import ServoChain
from lfield_sim.dynamixel.servo_model import model_named

PING, READ, WRITE, REG_WRITE, ACTION = 1, 2, 3, 4, 5
RESET, REBOOT, CLEAR, BROADCAST = 6, 8, 0x10, 0xFE
ID, BAUD, DELAY, MODE, SECONDARY, VELOCITY_LIMIT, TORQUE, LED, LEVEL = 7, 8, 9, 11, 12, 44, 64, 65, 68
REGISTERED, HARDWARE, GOAL_VELOCITY, GOAL, POSITION = 69, 70, 104, 116, 132
RESULT_FAIL, BAD_INSTRUCTION, BAD_CRC, RANGE, LENGTH, LIMIT, ACCESS, ALERT = 1, 2, 3, 4, 5, 6, 7, 128


def parse(data: bytes) -> list[tuple[int, int, bytes]]:
    """The id, error and data of each status packet. Fails if a packet is not valid."""
    found = []
    while data:
        end = 7 + int.from_bytes(data[5:7], "little")
        assert data[:4] == b"\xff\xff\xfd\x00"
        assert crc16(data[: end - 2]) == int.from_bytes(data[end - 2 : end], "little")
        body = unstuff(data[7 : end - 2])
        assert body[0] == 0x55
        found.append((data[4], body[1], body[2:]))
        data = data[end:]
    return found


class Bus:
    """A chain and the present time."""

    def __init__(self, *ids: int, model: str = "XM430-W350", **settings: int) -> None:
        servos = []
        for id in ids or (1,):
            servos.append(Servo(model_named(model)))
            for name, value in {"id": id, **settings}.items():
                servos[-1].table.put(name, value)
        self.chain = ServoChain(servos)
        self.now, self.baud = 1.0, None

    def send(self, raw: bytes) -> bytes:
        """Send bytes and return all replies that arrive before the next request."""
        replies = self.chain.receive(raw, self.now, self.baud)
        self.now = max([self.now + 0.005, *(reply.at for reply in replies)])
        return b"".join(reply.data for reply in replies)

    def ask(self, id: int, instruction: int, parameters: bytes = b"") -> list[tuple[int, int, bytes]]:
        """Send an instruction and return the answers."""
        return parse(self.send(encode(id, instruction, parameters)))

    def read(self, id: int, address: int, length: int) -> bytes:
        """Read registers. Fails if the servo answers with an error."""
        ((answering_id, error, data),) = self.ask(id, READ, struct.pack("<HH", address, length))
        assert (answering_id, error) == (id, 0)
        return data

    def write(self, id: int, address: int, data: bytes) -> int | None:
        """Write registers. Return the error byte, or None without an answer."""
        answers = self.ask(id, WRITE, struct.pack("<H", address) + data)
        return answers[0][1] if answers else None

    def wait(self, seconds: float) -> None:
        """Advance the time without a packet."""
        self.now += seconds
        self.chain.advance(self.now)


def sync_read(*ids: int, fast: bool = False) -> bytes:
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return encode(BROADCAST, instruction, struct.pack("<HH", POSITION, 4) + bytes(ids))
