"""Reads and writes control tables on a bus, with retries and protection against late answers.

An answer does not identify its request. So a servo whose answer was missed is *unsynchronized*: before its
next answer is accepted, it must answer a ping, whose data has a length that no read here requests. A servo
answers in order: after the answer to the ping, no older answer can follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynamixel_sdk.robotis_def import (
    BROADCAST_ID,
    INST_FAST_SYNC_READ,
    INST_PING,
    INST_READ,
    INST_REBOOT,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
)
from msgspec import Struct

from lfield.driver import DeviceError
from lfield_dynamixel.bus.error_text import refusal_text
from lfield_dynamixel.bus.half_duplex_bus import COMMAND, Bus
from lfield_dynamixel.bus.packets import PROTOCOLS, AnyProtocol, Status, split_fast

#: Attempts of a request before a servo counts as silent.
TRIES = 5
#: Consecutive failures of fast reads while plain reads work: at least one servo does not support fast reads.
FAST_FAILURES = 3
#: Plain reads until a fast one is tried again: the cause may have been a lost servo or port.
FAST_RETRY_READS = 200

#: Rounds of an id check: minimum with one answer each, excess of rounds with two answers that proves a second
#: servo, maximum.
FEWEST_ROUNDS, PROOF_ROUNDS, MOST_ROUNDS = 4, 3, 12

_PING_BYTES = {0: 0, 1: 0, 2: 3}


class NoAnswer(DeviceError):
    """A servo that does not answer; `number` is its id."""

    def __init__(self, number: int, cause: str = "") -> None:
        self.number = number
        reason = f"servo {number} does not answer" + (f": {cause}" if cause else "")
        super().__init__(f"servo {number}", reason, kind="DeviceTimeoutException")


class ServoRefusal(DeviceError):
    """A servo that refused a request; `error_byte` is the byte of its answer."""

    def __init__(self, number: int, code: int, text: str) -> None:
        self.number, self.error_byte = number, code
        super().__init__(f"servo {number}", f"servo {number} refused: {text}")


class Node(Struct, frozen=True):
    """One servo on the bus, with its protocol (0 for Feetech's, 1 or 2)."""

    number: int
    protocol: int = 2

    @property
    def codec(self) -> AnyProtocol:
        """The packet codec of the servo."""
        return PROTOCOLS[self.protocol]

    def place(self, *values: int) -> bytes:
        """Addresses and lengths as parameters: two bytes each in protocol 2.0, otherwise one."""
        width = 2 if self.protocol == 2 else 1
        return b"".join(value.to_bytes(width, "little") for value in values)


class Chain:
    """The servos on one bus."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._unsynchronized: set[int] = set()
        self._fast_failures = self._plain_reads = 0

    async def ping(self, node: Node, *, urgency: int = COMMAND) -> bytes | None:
        """Pings a servo: the data of its answer (2.0: model and firmware), or None."""
        size = _PING_BYTES[node.protocol]
        answers = await self._request(node, INST_PING, b"", size, urgency)
        if not answers or len(answers[0].data) != size:
            self._unsynchronized.add(node.number)
            return None
        self._unsynchronized.discard(node.number)
        return answers[0].data

    async def read(self, node: Node, start: int, size: int, *, urgency: int = COMMAND) -> Status:
        """Reads `size` bytes of a control table from the address `start`. Raises NoAnswer, ServoRefusal."""
        parameters = node.place(start, size)
        return await self._request_with_retries(node, INST_READ, parameters, size, urgency)

    async def write(self, node: Node, start: int, data: bytes, *, urgency: int = COMMAND) -> Status:
        """Writes bytes to a control table, with confirmation. Raises NoAnswer, ServoRefusal.

        Writes are idempotent, so a lost answer is handled by writing again.
        """
        return await self._request_with_retries(node, INST_WRITE, node.place(start) + data, 0, urgency)

    async def write_unconfirmed(self, node: Node, start: int, data: bytes) -> None:
        """Writes without waiting for an answer: for a servo that is configured to send none."""
        packet = node.codec.encode(node.number, INST_WRITE, node.place(start) + data)
        await self._bus.exchange(node.codec, packet, (), 0)

    async def id_conflict(
        self, node: Node, start: int, size: int, *, urgency: int = COMMAND, fewest: int = FEWEST_ROUNDS
    ) -> str:
        """The reason why two servos seem to have an id; '' for one servo.

        Two servos both answer: one after the other, or at once, which damages the answer. Answers get lost,
        so there are several rounds, at least `fewest`, and a single one proves nothing. An answer that is
        late (slow adapter, busy computer) is missing in its own round and is the second answer of the next
        round; so a round without any answer cancels a round with two.
        """
        packet = node.codec.encode(node.number, INST_READ, node.place(start, size))
        single_rounds = double_rounds = damaged_rounds = empty_rounds = 0
        for _ in range(MOST_ROUNDS):
            data = await self._bus.listen(node.codec, packet, size, urgency=urgency)
            answers = [a for a in node.codec.reader().feed(data) if a.number == node.number]
            double_rounds += len(answers) > 1
            single_rounds += len(answers) == 1
            damaged_rounds += bool(data) and not answers
            empty_rounds += not data
            if double_rounds - empty_rounds >= PROOF_ROUNDS:
                return f"two servos answer to the id {node.number}; give each its own"
            if single_rounds >= fewest + 2 * (double_rounds + damaged_rounds):
                return ""
        if damaged_rounds > MOST_ROUNDS // 2:
            return (
                f"the answers of servo {node.number} are damaged: check whether two servos have this id, and "
                "the wires"
            )
        return ""

    async def reboot(self, node: Node) -> None:
        """Restarts a servo. It may answer before it restarts; the caller must verify that it is back."""
        await self._request(node, INST_REBOOT, b"", 0, COMMAND)
        self._unsynchronized.add(node.number)

    async def sync_write(
        self, start: int, data: Mapping[int, bytes], *, protocol: int = 2, urgency: int = COMMAND
    ) -> None:
        """Sends one packet that writes to several servos. The packet has no answer."""
        node = Node(BROADCAST_ID, protocol)
        size = len(next(iter(data.values())))
        body = b"".join(bytes((number,)) + part for number, part in data.items())
        packet = node.codec.encode(BROADCAST_ID, INST_SYNC_WRITE, node.place(start, size) + body)
        await self._bus.exchange(node.codec, packet, (), 0, urgency=urgency)

    async def sync_read(
        self, nodes: Sequence[Node], start: int, size: int, *, urgency: int = COMMAND, alone: bool = True
    ) -> dict[int, Status]:
        """Reads the same range of several servos, by id. A missing servo has answered neither in the group
        nor (unless `alone` is False, which saves time) alone. Raises nothing.
        """
        synchronized = [
            node for node in nodes if node.protocol != 1 and node.number not in self._unsynchronized
        ]
        answers = await self._read_group(synchronized, start, size, urgency) if len(synchronized) > 1 else {}
        for node in nodes:
            if node.number in answers or not (alone or len(nodes) == 1):
                continue
            try:
                answers[node.number] = await self.read(node, start, size, urgency=urgency)
            except (NoAnswer, ServoRefusal):
                continue
        return answers

    async def _read_group(
        self, nodes: Sequence[Node], start: int, size: int, urgency: int
    ) -> dict[int, Status]:
        """The answers to a fast sync read of protocol 2.0, or to a plain one if fast ones do not work."""
        numbers = tuple(node.number for node in nodes)
        may_be_fast = self._fast_failures < FAST_FAILURES or self._plain_reads >= FAST_RETRY_READS
        is_fast = nodes[0].protocol == 2 and may_be_fast
        self._plain_reads = 0 if is_fast else self._plain_reads + 1
        instruction = INST_FAST_SYNC_READ if is_fast else INST_SYNC_READ
        codec = nodes[0].codec
        packet = codec.encode(BROADCAST_ID, instruction, nodes[0].place(start, size) + bytes(numbers))
        answering_ids, length = (
            ((BROADCAST_ID,), (size + 4) * len(numbers) - 3) if is_fast else (numbers, size)
        )
        answers = await self._bus.exchange(codec, packet, answering_ids, length, urgency=urgency)
        if is_fast:
            parts = split_fast(answers[0], numbers, size) if answers else None
            self._fast_failures = 0 if parts else self._fast_failures + 1
            # A fast answer has the broadcast id, so it cannot be mistaken for a later answer.
            return parts or {}
        statuses = {answer.number: answer for answer in answers if len(answer.data) == size}
        self._unsynchronized.update(set(numbers) - statuses.keys())
        return statuses

    async def _request_with_retries(
        self, node: Node, instruction: int, parameters: bytes, size: int, urgency: int
    ) -> Status:
        """Repeats a request until it is answered with the requested length."""
        for _ in range(TRIES):
            if node.number in self._unsynchronized and await self.ping(node, urgency=urgency) is None:
                continue
            answers = await self._request(node, instruction, parameters, size, urgency)
            if answers:
                refusal = refusal_text(node.protocol, answers[0])
                if refusal:
                    raise ServoRefusal(node.number, answers[0].error, refusal)
                if len(answers[0].data) == size:
                    return answers[0]
            self._unsynchronized.add(node.number)
        raise NoAnswer(node.number, self._bus.is_lost)

    async def _request(
        self, node: Node, instruction: int, parameters: bytes, size: int, urgency: int
    ) -> list[Status]:
        packet = node.codec.encode(node.number, instruction, parameters)
        return await self._bus.exchange(node.codec, packet, (node.number,), size, urgency=urgency)
