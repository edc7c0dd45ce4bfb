"""A chain of servos on one wire: bytes in, timed replies out. Pure: time is given to it, in seconds."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lfield_sim.dynamixel.instructions import Answer, Outcome, carry_out
from lfield_sim.dynamixel.model import BAUDS
from lfield_sim.dynamixel.packets import MAX_PACKET, Codec, Codec1, Codec2, Packet, fast_status
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.table import Refusal
from lfield_sim.faults import Fault, Faults, share

#: The angle of an obstacle that is not there.
NOTHING = 1000.0

FAULTS = (
    Fault("dead", False, "does not answer, and does nothing it is told"),
    share("lose", "share of its replies that get lost"),
    share("corrupt", "share of its replies with a wrong byte"),
    Fault("delay", 0.0, "seconds that its replies come late", 0.0, 60.0),
    Fault("other", False, "answers with the id of another"),
    Fault("nonsense", False, "answers with random bytes"),
    Fault("overload", False, "more load than it can hold: it stalls and shuts down"),
    Fault("stuck", False, "a broken gear: the shaft stays while the motor turns freely"),
    Fault("obstacle", NOTHING, "rad from its middle where something solid is; 1000: none", -10.0, NOTHING),
    Fault("hot", False, "gets hotter, 10 degrees a second"),
    Fault("sag", 0.0, "volts that its supply lacks", 0.0, 100.0),
    Fault("encoder", False, "its encoder fails"),
    share("noise", "share of replies with random bytes before them"),
    Fault("echo", False, "the adapter echoes every transmitted byte"),
    Fault("unplug", False, "the adapter is pulled out; false plugs it in again"),
)
#: Degrees per second of the fault `hot`.
HEATER = 10.0

#: A byte on the wire: start, eight bits, stop.
BITS = 10
#: A packet that pauses for longer is given up, in seconds.
PAUSE = 0.1
#: How far two speeds may be apart to understand each other.
TOLERANCE = 0.03
#: A wire that has more than this still to carry takes no more, in seconds.
BACKLOG = 1.0
#: Protocol 1.0 has a bit for each error.
_ERRORS_1 = {
    0: 0x00,
    Refusal.RESULT_FAIL: 0x40,
    Refusal.INSTRUCTION: 0x40,
    Refusal.CRC: 0x10,
    Refusal.RANGE: 0x08,
    Refusal.LENGTH: 0x08,
    Refusal.LIMIT: 0x02,
    Refusal.ACCESS: 0x08,
}


@dataclass(frozen=True, slots=True)
class Reply:
    """Bytes of which the last arrives at time `at`."""

    at: float
    data: bytes


class Chain:
    """Servos on a bus. `faults` may change at any time; `seed` makes random faults repeat.

    The faults of a servo go by the id that it had at first, for that is how it was named.
    """

    def __init__(self, servos: Sequence[Servo], faults: Faults | None = None, *, seed: int = 1) -> None:
        self.servos = list(servos)
        self.faults = Faults(FAULTS, [str(servo.id) for servo in servos]) if faults is None else faults
        self._names = {id(servo): str(servo.id) for servo in self.servos}
        self._random = random.Random(seed)
        self._codecs: dict[int, Codec] = {1: Codec1(), 2: Codec2()}
        self._baud: int | None = None
        self._heard = self._free = 0.0
        self.faults.watch(self._break)
        self._break()

    def advance(self, now: float) -> None:
        """Let time pass until `now`."""
        for servo in self.servos:
            servo.advance(now)

    def receive(self, data: bytes, now: float, baud: int | None = None) -> list[Reply]:
        """What these bytes are answered with. `baud` is the speed they came with, None if nobody knows.

        Never raises: what is no packet is noise.
        """
        self.advance(now)
        if baud != self._baud or now - self._heard > PAUSE:
            for codec in self._codecs.values():
                codec.clear()
        self._baud, self._heard = baud, now
        replies = self._echo(data, now)
        for start in range(0, len(data), MAX_PACKET):
            replies += self._listen(data[start : start + MAX_PACKET], now)
        return replies

    def _echo(self, data: bytes, now: float) -> list[Reply]:
        """What an adapter that does not switch its receiver off hears of what it sends."""
        if not (data and self.faults.get("echo")):
            return []
        baud = self._baud or max((servo.baud for servo in self.servos), default=BAUDS[0])
        return [Reply(now + len(data) * BITS / baud, data)]

    def _listen(self, data: bytes, now: float) -> Iterator[Reply]:
        for protocol in sorted({servo.protocol for servo in self.servos}):
            for packet in self._codecs[protocol].feed(data):
                hearers = self._hearers(protocol)
                for servo in hearers if packet.sound else ():
                    servo.hear(now)
                yield from self._say(carry_out(packet, protocol, hearers), packet, protocol, now)

    def _hearers(self, protocol: int) -> list[Servo]:
        """Those who understand the protocol and the speed, and are alive and awake."""
        baud = self._baud
        return [
            servo
            for servo in self.servos
            if servo.protocol == protocol
            and servo.awake
            and not self._fault("dead", servo)
            and (baud is None or abs(servo.baud - baud) <= TOLERANCE * baud)
        ]

    def _say(self, outcome: Outcome, packet: Packet, protocol: int, now: float) -> list[Reply]:
        """The answers as bytes, each at the time when the wire has carried it."""
        self._free = max(now, self._free)
        if not outcome.answers or self._free - now > BACKLOG:
            return []
        self._free += packet.size * BITS / outcome.answers[0].baud
        if outcome.fast:
            return self._say_fast(outcome)
        replies: list[Reply] = []
        for _, group in itertools.groupby(outcome.answers, lambda answer: answer.id):
            replies += self._collide(list(group), protocol)
        return replies

    def _collide(self, answers: Sequence[Answer], protocol: int) -> list[Reply]:
        """Servos with one id answer at once: one that waits longer than the others talk is heard by itself.

        The line is low where anybody has it low.
        """
        begun, ends = self._free, self._free
        replies: list[Reply] = []
        for answer in sorted(answers, key=lambda answer: answer.servo.return_delay):
            self._free = begun
            starts = begun + answer.servo.return_delay
            reply = self._reply(answer, self._status(answer, protocol))
            if replies and starts < ends and reply.data:
                both = itertools.zip_longest(replies[-1].data, reply.data, fillvalue=0xFF)
                data = bytes(one & other for one, other in both)
                replies[-1] = Reply(max(reply.at, replies[-1].at), data)
            elif reply.data:
                replies.append(reply)
            ends = max(ends, reply.at)
        self._free = ends
        return replies

    def _say_fast(self, outcome: Outcome) -> list[Reply]:
        blocks = []
        for answer in outcome.answers:
            if self._happens("lose", answer.servo):
                break
            blocks.append((self._id(answer), answer.error | answer.servo.alert, answer.data))
            if len(blocks) > 1 and blocks[-2][0] == blocks[-1][0]:
                # Two with one id talk at once; the last servo makes the check sum of what it has heard.
                (number, one_error, one), (_, other_error, other) = blocks[-2:]
                both = bytes(a & b for a, b in zip(one, other, strict=True))
                blocks[-2:] = [(number, one_error & other_error, both)]
        if not blocks:
            return []
        return [self._reply(outcome.answers[0], fast_status(outcome.fast, blocks))]

    def _status(self, answer: Answer, protocol: int) -> bytes:
        """The packet of an answer; empty when it is lost."""
        if self._happens("lose", answer.servo):
            return b""
        error = answer.error if protocol == 2 else _ERRORS_1[answer.error]
        return self._codecs[protocol].status(self._id(answer), error | answer.servo.alert, answer.data)

    def _reply(self, answer: Answer, data: bytes) -> Reply:
        servo = answer.servo
        self._free += servo.return_delay + len(data) * BITS / answer.baud
        if data and self._fault("nonsense", servo):
            data = self._random.randbytes(len(data))
        if data and self._happens("corrupt", servo):
            place = self._random.randrange(len(data))
            data = data[:place] + bytes([data[place] ^ self._random.randint(1, 255)]) + data[place + 1 :]
        if self._happens("noise", servo):
            data = self._random.randbytes(self._random.randint(1, 8)) + data
        return Reply(self._free + float(self._fault("delay", servo)), data)

    def _id(self, answer: Answer) -> int:
        """The id under which it answers."""
        return (answer.id + 1) % 253 if self._fault("other", answer.servo) else answer.id

    def _fault(self, name: str, servo: Servo) -> float:
        return float(self.faults.get(name, self._names[id(servo)]))

    def _happens(self, name: str, servo: Servo) -> bool:
        return self._random.random() < self._fault(name, servo)

    def _break(self) -> None:
        """Let the mechanics have the faults that are set."""
        for servo in self.servos:
            motor, overload = servo.motion.motor, bool(self._fault("overload", servo))
            motor.blocked, motor.load = overload, 1.5 * motor.strength.stall_torque if overload else 0.0
            motor.slipping = bool(self._fault("stuck", servo))
            obstacle = float(self._fault("obstacle", servo))
            motor.meet(obstacle + math.pi if obstacle < NOTHING else None)
            motor.heater = HEATER if self._fault("hot", servo) else 0.0
            motor.sag = self._fault("sag", servo)
            servo.encoder_fault = bool(self._fault("encoder", servo))
            servo.motion.resting = False
