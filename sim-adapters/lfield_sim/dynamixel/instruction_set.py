"""Execution of instruction packets, and their answers: unicast, broadcast, groups.

https://emanual.robotis.com/docs/en/dxl/protocol2/ and .../protocol1/ (sections Instruction).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

from msgspec import Struct, field

from lfield_sim.dynamixel.control_table import InstructionRefused, RefusalCode
from lfield_sim.dynamixel.packets import BROADCAST, MAX_PACKET, Instruction, InstructionPacket
from lfield_sim.dynamixel.servo import ANSWER_ALL, Servo

#: Lowest Status Return Level at which an instruction is answered; others from 2.
_LEVELS = {Instruction.PING: 0, Instruction.READ: 1}
_READ_LEVEL = 1
#: Instructions that a Feetech servo does not answer.
_SILENT = (RefusalCode.CRC, RefusalCode.INSTRUCTION)
#: Factory Reset of protocol 1.0, which has no option: everything.
_RESET_ALL = 0xFF
#: Bytes of a fast-read block in addition to its data: error, id, checksum.
_FAST_FRAME = 4
_STATUS = 0x55
#: Maximum data of an answer in protocol 1.0.
_LONGEST_1 = 253


class ServoAnswer(Struct, frozen=True):
    """An answer, with the id and baud rate of the servo at the time of the request."""

    servo: Servo
    id: int
    baud: int
    error: int
    data: bytes


class InstructionOutcome(Struct, frozen=True):
    """The answers in order.

    With `fast` they share one packet; it is the total size of its blocks if all answer.
    """

    answers: Sequence[ServoAnswer] = ()
    fast: int = 0


class _Cursor(Struct):
    """Reads parameters from the front. Raises InstructionRefused when they are too short."""

    data: bytes
    width: int
    at: int = field(default=0)

    def read(self, size: int) -> bytes:
        """Some bytes."""
        if self.at + size > len(self.data):
            raise InstructionRefused(RefusalCode.LENGTH)
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self) -> int:
        """An address or a length: two bytes in protocol 2.0, one in 1.0."""
        return int.from_bytes(self.read(self.width), "little")

    def byte(self) -> int:
        """One byte."""
        return self.read(1)[0]

    @property
    def remaining(self) -> bytes:
        """The bytes that have not been read."""
        return self.data[self.at :]


def execute(packet: InstructionPacket, protocol: int, servos: Sequence[Servo]) -> InstructionOutcome:
    """Executes a packet on the servos that receive it. Never raises."""
    if packet.instruction == _STATUS:
        return InstructionOutcome()
    cursor = _Cursor(packet.parameters, 2 if protocol == 2 else 1)
    try:
        match packet.instruction if packet.is_valid else None:
            case Instruction.SYNC_WRITE:
                _sync_write(cursor, servos)
            case Instruction.BULK_WRITE if protocol == 2:
                _bulk_write(cursor, servos)
            case Instruction.SYNC_READ if protocol != 1:
                return _group(packet, protocol, servos, _sync_list(cursor))
            case Instruction.FAST_SYNC_READ if protocol == 2:
                return _group(packet, protocol, servos, _sync_list(cursor))
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                return _group(packet, protocol, servos, _bulk_list(cursor))
            case _:
                return _execute_on_each(packet, protocol, servos)
    except InstructionRefused:
        # An invalid group packet has no answer.
        pass
    return InstructionOutcome()


def _execute_on_each(packet: InstructionPacket, protocol: int, servos: Sequence[Servo]) -> InstructionOutcome:
    """The servos for an id: one by its id, some by their secondary id, or all."""
    answers = []
    for servo in sorted(servos, key=lambda servo: servo.id):
        has_id = servo.id == packet.id
        if not has_id and packet.id != BROADCAST and servo.secondary != packet.id:
            continue
        is_broadcast_ping = (
            packet.id == BROADCAST and packet.instruction == Instruction.PING and packet.is_valid
        )
        id, baud = servo.id, servo.baud
        is_answered = servo.answers(_LEVELS.get(_known_instruction(packet.instruction), ANSWER_ALL))
        error, data = _execute_on_servo(
            servo, packet, protocol, secondary=not has_id and packet.id != BROADCAST
        )
        if (has_id or is_broadcast_ping) and is_answered and not (protocol == 0 and error in _SILENT):
            answers.append(ServoAnswer(servo, id, baud, error, data))
    return InstructionOutcome(answers)


def _known_instruction(instruction: int) -> Instruction:
    """The instruction of a number; an unknown one is answered like a write."""
    return Instruction(instruction) if instruction in Instruction.__members__.values() else Instruction.WRITE


def _execute_on_servo(
    servo: Servo, packet: InstructionPacket, protocol: int, *, secondary: bool
) -> tuple[int, bytes]:
    try:
        if not packet.is_valid:
            raise InstructionRefused(RefusalCode.CRC)
        return 0, _perform(servo, packet, protocol, secondary)
    except InstructionRefused as refused:
        return refused.reason, b""


def _perform(servo: Servo, packet: InstructionPacket, protocol: int, secondary: bool) -> bytes:
    cursor = _Cursor(packet.parameters, 2 if protocol == 2 else 1)
    match packet.instruction:
        case Instruction.PING:
            return servo.ping() if protocol == 2 else b""
        case Instruction.READ:
            return _read(servo, cursor.number(), cursor.number(), protocol)
        case Instruction.WRITE:
            servo.write(cursor.number(), cursor.remaining, secondary=secondary)
        case Instruction.REG_WRITE:
            servo.register(cursor.number(), cursor.remaining, secondary=secondary)
        case Instruction.ACTION:
            servo.act()
        case Instruction.FACTORY_RESET:
            _factory_reset(servo, packet, _RESET_ALL if protocol != 2 else cursor.byte())
        case Instruction.REBOOT if protocol == 2:
            servo.reboot()
        case Instruction.CLEAR if protocol == 2:
            servo.clear(cursor.remaining)
        case _:
            raise InstructionRefused(RefusalCode.INSTRUCTION)
    return b""


def _read(servo: Servo, address: int, length: int, protocol: int) -> bytes:
    if protocol != 2 and length > _LONGEST_1:
        raise InstructionRefused(RefusalCode.LENGTH)
    return servo.read(address, length)


def _factory_reset(servo: Servo, packet: InstructionPacket, option: int) -> None:
    if packet.id == BROADCAST and option == _RESET_ALL:
        return  # all would get the same id: the firmware refuses
    servo.factory_reset(option)


def _sync_write(cursor: _Cursor, servos: Sequence[Servo]) -> None:
    address, length = cursor.number(), cursor.number()
    while cursor.remaining:
        _write_to(cursor.byte(), address, cursor.read(length), servos)


def _bulk_write(cursor: _Cursor, servos: Sequence[Servo]) -> None:
    while cursor.remaining:
        id, address = cursor.byte(), cursor.number()
        _write_to(id, address, cursor.read(cursor.number()), servos)


def _write_to(id: int, address: int, data: bytes, servos: Sequence[Servo]) -> None:
    for servo in servos:
        if id in (servo.id, servo.secondary):
            # A group write has no answer, not even a refusal.
            with contextlib.suppress(InstructionRefused):
                servo.write(address, data, secondary=servo.id != id)


#: Id, address and length of a group read.
ReadRequest = tuple[int, int, int]


def _sync_list(cursor: _Cursor) -> list[ReadRequest]:
    address, length = cursor.number(), cursor.number()
    return [(id, address, length) for id in cursor.remaining]


def _bulk_list(cursor: _Cursor) -> list[ReadRequest]:
    if cursor.width == 2:
        return list(_bulk_requests_2(cursor))
    cursor.byte()  # always 0
    return list(_bulk_requests_1(cursor))


def _bulk_requests_2(cursor: _Cursor) -> Iterator[ReadRequest]:
    while cursor.remaining:
        yield cursor.byte(), cursor.number(), cursor.number()


def _bulk_requests_1(cursor: _Cursor) -> Iterator[ReadRequest]:
    while cursor.remaining:
        length, id, address = cursor.byte(), cursor.byte(), cursor.byte()
        yield id, address, length


def _group(
    packet: InstructionPacket, protocol: int, servos: Sequence[Servo], requests: Sequence[ReadRequest]
) -> InstructionOutcome:
    """Executes a group read: each servo answers after the previous one in the list; a missing answer stops
    the rest.

    A list with a duplicate id, or too long for a shared packet, has no answer. Servos with one id answer one
    after the other here, simultaneously on the wire.
    """
    fast = packet.instruction in (Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ)
    size = sum(length + _FAST_FRAME for _, _, length in requests)
    has_duplicates = len({id for id, _, _ in requests}) < len(requests)
    if packet.id != BROADCAST or has_duplicates or (fast and size > MAX_PACKET):
        return InstructionOutcome()
    answers = []
    for id, address, length in requests:
        responders = [s for s in servos if s.id == id and s.answers(_READ_LEVEL)]
        if not responders:
            break
        for servo in responders:
            try:
                error, data = 0, _read(servo, address, length, protocol)
            except InstructionRefused as refused:
                # In a shared packet every block has its full size.
                error, data = refused.reason, bytes(length) if fast else b""
            answers.append(ServoAnswer(servo, id, servo.baud, error, data))
    return InstructionOutcome(answers, size if fast else 0)
