"""A chain of servos on one wire: bytes in, timed replies out. Pure: time is given in seconds."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield_sim.dynamixel.control_table import RefusalCode
from lfield_sim.dynamixel.instruction_set import InstructionOutcome, ServoAnswer, execute
from lfield_sim.dynamixel.packets import MAX_PACKET, Codec, Codec1, Codec2, InstructionPacket, fast_status
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.servo_model import BAUDS
from lfield_sim.faults import Fault, Faults, share

#: Angle of an obstacle that means none.
NO_OBSTACLE = 1000.0

FAULTS = (
    Fault("dead", False, "neither answers nor executes instructions"),
    share("lose", "share of lost replies"),
    share("corrupt", "share of replies with a wrong byte"),
    Fault("delay", 0.0, "seconds that replies are late", 0.0, 60.0),
    Fault("other", False, "answers with the id of another"),
    Fault("nonsense", False, "answers with random bytes"),
    Fault("overload", False, "a load above its torque: it stalls and shuts down"),
    Fault("stuck", False, "a broken gear: the motor turns without the shaft"),
    Fault(
        "obstacle",
        NO_OBSTACLE,
        "angle of an obstacle in rad from its middle; 1000: none",
        -10.0,
        NO_OBSTACLE,
    ),
    Fault("hot", False, "heats up by 10 degrees a second"),
    Fault("sag", 0.0, "voltage drop of its supply", 0.0, 100.0),
    Fault("encoder", False, "its encoder fails"),
    Fault("brownout", False, "a short dip of its supply: it restarts, with its torque off"),
    share("noise", "share of replies with random bytes before them"),
    Fault("echo", False, "the adapter echoes every transmitted byte"),
    Fault("unplug", False, "the adapter is unplugged; false plugs it in again"),
)
#: Degrees per second of the fault `hot`.
HEATER = 10.0

#: A byte on the wire: start, eight bits, stop.
BITS = 10
#: Seconds of a pause that ends a packet.
PAUSE = 0.1
#: Maximum relative difference of two baud rates.
TOLERANCE = 0.03
#: Seconds of queued data above which the wire accepts no more.
BACKLOG = 1.0
#: Error bits of protocol 1.0.
_ERRORS_1 = {
    0: 0x00,
    RefusalCode.RESULT_FAIL: 0x40,
    RefusalCode.INSTRUCTION: 0x40,
    RefusalCode.CRC: 0x10,
    RefusalCode.RANGE: 0x08,
    RefusalCode.LENGTH: 0x08,
    RefusalCode.LIMIT: 0x02,
    RefusalCode.ACCESS: 0x08,
}


class TimedReply(Struct, frozen=True):
    """Bytes whose last one arrives at time `at`."""

    at: float
    data: bytes


class ServoChain:
    """Servos on a bus. `faults` may change at any time; `seed` determines random faults.

    Faults refer to a servo's initial id.
    """

    def __init__(self, servos: Sequence[Servo], faults: Faults | None = None, *, seed: int = 1) -> None:
        self.servos = list(servos)
        self.faults = Faults(FAULTS, [str(servo.id) for servo in servos]) if faults is None else faults
        self._names = {id(servo): str(servo.id) for servo in self.servos}
        self._random = random.Random(seed)
        self._codecs: dict[int, Codec] = {0: Codec1(), 1: Codec1(), 2: Codec2()}
        self._baud: int | None = None
        self._brownouts: set[int] = set()
        self._last_byte_at = self._free_at = 0.0
        self.faults.watch(self._apply_mechanical_faults)
        self._apply_mechanical_faults()

    def advance(self, now: float) -> None:
        """Advances to `now`."""
        for servo in self.servos:
            servo.advance(now)

    def receive(self, data: bytes, now: float, baud: int | None = None) -> list[TimedReply]:
        """The answers to these bytes. `baud` is their baud rate, None if unknown.

        Never raises: invalid data is treated as noise.
        """
        self.advance(now)
        if baud != self._baud or now - self._last_byte_at > PAUSE:
            for codec in self._codecs.values():
                codec.clear()
        self._baud, self._last_byte_at = baud, now
        replies = self._echo(data, now)
        for start in range(0, len(data), MAX_PACKET):
            replies += self._listen(data[start : start + MAX_PACKET], now)
        return replies

    def _echo(self, data: bytes, now: float) -> list[TimedReply]:
        """The echo of an adapter that keeps receiving while it sends."""
        if not (data and self.faults.get("echo")):
            return []
        baud = self._baud or max((servo.baud for servo in self.servos), default=BAUDS[0])
        return [TimedReply(now + len(data) * BITS / baud, data)]

    def _listen(self, data: bytes, now: float) -> Iterator[TimedReply]:
        for protocol in sorted({servo.protocol for servo in self.servos}):
            for packet in self._codecs[protocol].feed(data):
                receivers = self._addressable(protocol)
                for servo in receivers if packet.is_valid else ():
                    servo.on_packet(now)
                yield from self._encode(execute(packet, protocol, receivers), packet, protocol, now)

    def _addressable(self, protocol: int) -> list[Servo]:
        """The servos that understand protocol and baud rate, and are working and awake."""
        baud = self._baud
        return [
            servo
            for servo in self.servos
            if servo.protocol == protocol
            and servo.awake
            and not self._fault("dead", servo)
            and (baud is None or abs(servo.baud - baud) <= TOLERANCE * baud)
        ]

    def _encode(
        self, outcome: InstructionOutcome, packet: InstructionPacket, protocol: int, now: float
    ) -> list[TimedReply]:
        """The answers as bytes, each at the time when it has been transmitted."""
        self._free_at = max(now, self._free_at)
        if not outcome.answers or self._free_at - now > BACKLOG:
            return []
        self._free_at += packet.size * BITS / outcome.answers[0].baud
        if outcome.fast:
            return self._encode_fast(outcome)
        replies: list[TimedReply] = []
        for _, group in itertools.groupby(outcome.answers, lambda answer: answer.id):
            replies += self._collide(list(group), protocol)
        return replies

    def _collide(self, answers: Sequence[ServoAnswer], protocol: int) -> list[TimedReply]:
        """Answers of servos with one id, at once: one with a longer delay than the others' answers is
        received separately.

        The line is low where any sender has it low.
        """
        start, end = self._free_at, self._free_at
        replies: list[TimedReply] = []
        for answer in sorted(answers, key=lambda answer: answer.servo.return_delay):
            self._free_at = start
            reply_start = start + answer.servo.return_delay
            reply = self._reply(answer, self._status(answer, protocol))
            if replies and reply_start < end and reply.data:
                both = itertools.zip_longest(replies[-1].data, reply.data, fillvalue=0xFF)
                data = bytes(first & second for first, second in both)
                replies[-1] = TimedReply(max(reply.at, replies[-1].at), data)
            elif reply.data:
                replies.append(reply)
            end = max(end, reply.at)
        self._free_at = end
        return replies

    def _encode_fast(self, outcome: InstructionOutcome) -> list[TimedReply]:
        blocks = []
        for answer in outcome.answers:
            if self._happens("lose", answer.servo):
                break
            blocks.append((self._id(answer), answer.error | answer.servo.alert, answer.data))
            if len(blocks) > 1 and blocks[-2][0] == blocks[-1][0]:
                # Two servos with one id collide; the last servo computes the checksum of what it has
                # received.
                (number, first_error, first), (_, second_error, second) = blocks[-2:]
                both = bytes(a & b for a, b in zip(first, second, strict=True))
                blocks[-2:] = [(number, first_error & second_error, both)]
        if not blocks:
            return []
        return [self._reply(outcome.answers[0], fast_status(outcome.fast, blocks))]

    def _status(self, answer: ServoAnswer, protocol: int) -> bytes:
        """The packet of an answer; empty when it is lost."""
        if self._happens("lose", answer.servo):
            return b""
        error = {0: 0, 1: _ERRORS_1[answer.error], 2: answer.error}[protocol]
        return self._codecs[protocol].status(self._id(answer), error | answer.servo.alert, answer.data)

    def _reply(self, answer: ServoAnswer, data: bytes) -> TimedReply:
        servo = answer.servo
        self._free_at += servo.return_delay + len(data) * BITS / answer.baud
        if data and self._fault("nonsense", servo):
            data = self._random.randbytes(len(data))
        if data and self._happens("corrupt", servo):
            position = self._random.randrange(len(data))
            data = (
                data[:position]
                + bytes([data[position] ^ self._random.randint(1, 255)])
                + data[position + 1 :]
            )
        if self._happens("noise", servo):
            data = self._random.randbytes(self._random.randint(1, 8)) + data
        return TimedReply(self._free_at + float(self._fault("delay", servo)), data)

    def _id(self, answer: ServoAnswer) -> int:
        """The id in the answers of a servo."""
        return (answer.id + 1) % 253 if self._fault("other", answer.servo) else answer.id

    def _fault(self, name: str, servo: Servo) -> float:
        return float(self.faults.get(name, self._names[id(servo)]))

    def _happens(self, name: str, servo: Servo) -> bool:
        return self._random.random() < self._fault(name, servo)

    def _apply_mechanical_faults(self) -> None:
        """Applies the mechanical faults."""
        for servo in self.servos:
            motor, overload = servo.motion.motor, bool(self._fault("overload", servo))
            motor.blocked, motor.load = overload, 1.5 * motor.strength.stall_torque if overload else 0.0
            motor.slipping = bool(self._fault("stuck", servo))
            obstacle = float(self._fault("obstacle", servo))
            motor.set_obstacle(obstacle + math.pi if obstacle < NO_OBSTACLE else None)
            motor.heater = HEATER if self._fault("hot", servo) else 0.0
            motor.sag = self._fault("sag", servo)
            servo.encoder_fault = bool(self._fault("encoder", servo))
            servo.motion.resting = False
            self._set_brownout(servo, bool(self._fault("brownout", servo)))

    def _set_brownout(self, servo: Servo, present: bool) -> None:
        """Restarts a servo at the start of the fault."""
        if present and id(servo) not in self._brownouts:
            servo.reboot()
        (self._brownouts.add if present else self._brownouts.discard)(id(servo))
