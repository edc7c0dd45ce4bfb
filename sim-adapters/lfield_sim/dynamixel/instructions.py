"""Who carries out an instruction packet, and who answers it: unicast, broadcast, groups.

https://emanual.robotis.com/docs/en/dxl/protocol2/ and .../protocol1/ (sections Instruction).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from lfield_sim.dynamixel.packets import BROADCAST, MAX_PACKET, Instruction, Packet
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.table import Refusal, Refused

#: From which Status Return Level on an instruction is answered; all others from 2 on.
_LEVELS = {Instruction.PING: 0, Instruction.READ: 1}
_READ_LEVEL = 1
#: What Factory Reset does in protocol 1.0, which has no option: everything.
_RESET_ALL = 0xFF
#: What a block of a fast read has beside its data: error, id, check sum.
_FAST_FRAME = 4
_STATUS = 0x55
#: The most data that an answer of protocol 1.0 has room for.
_LONGEST_1 = 253


@dataclass(frozen=True, slots=True)
class Answer:
    """What a servo says, under the id and at the baud rate that it had when it was asked."""

    servo: Servo
    id: int
    baud: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Outcome:
    """The answers in their order.

    With `fast` they share one packet; it is how many bytes its blocks have if all answer.
    """

    answers: Sequence[Answer] = ()
    fast: int = 0


@dataclass(slots=True)
class _Cursor:
    """Reads parameters from the front. Raises Refused when they are too short."""

    data: bytes
    width: int
    at: int = field(default=0)

    def take(self, size: int) -> bytes:
        """Some bytes."""
        if self.at + size > len(self.data):
            raise Refused(Refusal.LENGTH)
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self) -> int:
        """An address or a length: two bytes in protocol 2.0, one in 1.0."""
        return int.from_bytes(self.take(self.width), "little")

    def byte(self) -> int:
        """One byte."""
        return self.take(1)[0]

    @property
    def rest(self) -> bytes:
        """What is left."""
        return self.data[self.at :]


def carry_out(packet: Packet, protocol: int, servos: Sequence[Servo]) -> Outcome:
    """Let the servos that hear a packet do what it says. Never raises."""
    if packet.instruction == _STATUS:
        return Outcome()
    cursor = _Cursor(packet.parameters, 2 if protocol == 2 else 1)
    try:
        match packet.instruction if packet.sound else None:
            case Instruction.SYNC_WRITE:
                _sync_write(cursor, servos)
            case Instruction.BULK_WRITE if protocol == 2:
                _bulk_write(cursor, servos)
            case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ if protocol == 2:
                return _group(packet, protocol, servos, _sync_list(cursor))
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                return _group(packet, protocol, servos, _bulk_list(cursor))
            case _:
                return _each(packet, protocol, servos)
    except Refused:
        # A group is never told that its packet makes no sense: nobody is asked by name.
        pass
    return Outcome()


def _each(packet: Packet, protocol: int, servos: Sequence[Servo]) -> Outcome:
    """One servo by its id, some by their secondary id, or all."""
    answers = []
    for servo in sorted(servos, key=lambda servo: servo.id):
        mine = servo.id == packet.id
        if not mine and packet.id != BROADCAST and servo.secondary != packet.id:
            continue
        roll_call = packet.id == BROADCAST and packet.instruction == Instruction.PING and packet.sound
        level, id, baud = servo.table["status_return_level"], servo.id, servo.baud
        error, data = _execute(servo, packet, protocol, secondary=not mine and packet.id != BROADCAST)
        if (mine or roll_call) and level >= _LEVELS.get(_known(packet.instruction), 2):
            answers.append(Answer(servo, id, baud, error, data))
    return Outcome(answers)


def _known(instruction: int) -> Instruction:
    """An unknown instruction is answered as a write is."""
    return Instruction(instruction) if instruction in Instruction.__members__.values() else Instruction.WRITE


def _execute(servo: Servo, packet: Packet, protocol: int, *, secondary: bool) -> tuple[int, bytes]:
    try:
        if not packet.sound:
            raise Refused(Refusal.CRC)
        return 0, _perform(servo, packet, protocol, secondary)
    except Refused as refused:
        return refused.reason, b""


def _perform(servo: Servo, packet: Packet, protocol: int, secondary: bool) -> bytes:
    cursor = _Cursor(packet.parameters, 2 if protocol == 2 else 1)
    match packet.instruction:
        case Instruction.PING:
            return servo.ping() if protocol == 2 else b""
        case Instruction.READ:
            return _read(servo, cursor.number(), cursor.number(), protocol)
        case Instruction.WRITE:
            servo.write(cursor.number(), cursor.rest, secondary=secondary)
        case Instruction.REG_WRITE:
            servo.register(cursor.number(), cursor.rest, secondary=secondary)
        case Instruction.ACTION:
            servo.act()
        case Instruction.FACTORY_RESET:
            _factory_reset(servo, packet, _RESET_ALL if protocol == 1 else cursor.byte())
        case Instruction.REBOOT if protocol == 2:
            servo.reboot()
        case Instruction.CLEAR if protocol == 2:
            servo.clear(cursor.rest)
        case _:
            raise Refused(Refusal.INSTRUCTION)
    return b""


def _read(servo: Servo, address: int, length: int, protocol: int) -> bytes:
    if protocol == 1 and length > _LONGEST_1:
        raise Refused(Refusal.LENGTH)
    return servo.read(address, length)


def _factory_reset(servo: Servo, packet: Packet, option: int) -> None:
    if packet.id == BROADCAST and option == _RESET_ALL:
        return  # all would have the same id: the firmware does not do it
    servo.factory_reset(option)


def _sync_write(cursor: _Cursor, servos: Sequence[Servo]) -> None:
    address, length = cursor.number(), cursor.number()
    while cursor.rest:
        _write_to(cursor.byte(), address, cursor.take(length), servos)


def _bulk_write(cursor: _Cursor, servos: Sequence[Servo]) -> None:
    while cursor.rest:
        id, address = cursor.byte(), cursor.number()
        _write_to(id, address, cursor.take(cursor.number()), servos)


def _write_to(id: int, address: int, data: bytes, servos: Sequence[Servo]) -> None:
    for servo in servos:
        if id in (servo.id, servo.secondary):
            # Nobody answers a group write, not even with a refusal.
            with contextlib.suppress(Refused):
                servo.write(address, data, secondary=servo.id != id)


#: Id, address and length of what is asked of one servo of a group.
Wish = tuple[int, int, int]


def _sync_list(cursor: _Cursor) -> list[Wish]:
    address, length = cursor.number(), cursor.number()
    return [(id, address, length) for id in cursor.rest]


def _bulk_list(cursor: _Cursor) -> list[Wish]:
    if cursor.width == 2:
        return list(_bulk_wishes_2(cursor))
    cursor.byte()  # always 0
    return list(_bulk_wishes_1(cursor))


def _bulk_wishes_2(cursor: _Cursor) -> Iterator[Wish]:
    while cursor.rest:
        yield cursor.byte(), cursor.number(), cursor.number()


def _bulk_wishes_1(cursor: _Cursor) -> Iterator[Wish]:
    while cursor.rest:
        length, id, address = cursor.byte(), cursor.byte(), cursor.byte()
        yield id, address, length


def _group(packet: Packet, protocol: int, servos: Sequence[Servo], wishes: Sequence[Wish]) -> Outcome:
    """Each answers after the one before it in the list; one that does not answer stops all that follow.

    Nobody answers to a list that has an id twice, or that a shared packet has no room for. Servos with one
    id answer one after the other here, and at one time on the wire.
    """
    fast = packet.instruction in (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
    size = sum(length + _FAST_FRAME for _, _, length in wishes)
    twice = len({id for id, _, _ in wishes}) < len(wishes)
    if packet.id != BROADCAST or twice or (fast and size > MAX_PACKET):
        return Outcome()
    answers = []
    for id, address, length in wishes:
        asked = [s for s in servos if s.id == id and s.table["status_return_level"] >= _READ_LEVEL]
        if not asked:
            break
        for servo in asked:
            try:
                error, data = 0, _read(servo, address, length, protocol)
            except Refused as refused:
                # In a packet that is shared every block has its size, whatever is in it.
                error, data = refused.reason, bytes(length) if fast else b""
            answers.append(Answer(servo, id, servo.baud, error, data))
    return Outcome(answers, size if fast else 0)
