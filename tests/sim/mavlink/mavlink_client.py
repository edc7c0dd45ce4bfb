"""A ground station that sends packets to a fake in virtual time."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.link.radio_link import make_faults
from lfield_sim.mavlink.mavlink_fake import MavlinkFake

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
ARM, TAKEOFF, LAND, MODE, YAW, SPEED, RTL, STREAM, ONCE = 400, 22, 21, 176, 115, 178, 20, 511, 512
GUIDED, BRAKE = 4, 17


class Client:
    """A ground station that sends packets."""

    def __init__(
        self, kind="copter", *, flavour="ardupilot", system=1, faults=(), sender=255, beats=False, **autopilot
    ) -> None:
        self.beats, self._beaten = beats, 0.0
        self.autopilot = Autopilot(FLAVOURS[flavour][kind], **autopilot)
        self.fake = MavlinkFake(self.autopilot, system=system, faults=make_faults(*faults, systems=(system,)))
        self.out = dialect.MAVLink(None, srcSystem=sender, srcComponent=190)
        self.back = dialect.MAVLink(None)
        self.back.robust_parsing = True
        self.messages: list = []

    def send(self, message) -> list:
        """Sends one message; returns the answers."""
        return self._parse(self.fake.receive("c", message.pack(self.out)))

    def wait(self, seconds: float) -> list:
        """Advances time; returns the sent messages. With `beats`, sends a heartbeat each second."""
        packets = []
        for _ in range(round(seconds / 0.02)):
            if self.beats and self.autopilot.now - self._beaten >= 1.0:
                self._beaten = self.autopilot.now
                self.heartbeat()
            packets += self.fake.advance(0.02)
        return self._parse(packets)

    def _parse(self, packets) -> list:
        messages = self.back.parse_buffer(b"".join(packets)) or []
        assert not [m for m in messages if m.get_type() == "BAD_DATA"]
        self.messages += messages
        return messages

    def command(self, number, *values, target=1, component=1) -> int | None:
        padded = [*values, *[0.0] * (7 - len(values))]
        answers = self.send(dialect.MAVLink_command_long_message(target, component, number, 0, *padded))
        acks = [m for m in answers if m.get_type() == "COMMAND_ACK"]
        assert all(m.command == number and m.target_system == 255 and m.target_component == 190 for m in acks)
        return acks[0].result if acks else None

    def command_int(self, number, *values, x=0, y=0, z=0.0, frame=0) -> int | None:
        padded = [*values, *[0.0] * (4 - len(values))]
        answers = self.send(dialect.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *padded, x, y, z))
        acks = [m for m in answers if m.get_type() == "COMMAND_ACK"]
        return acks[0].result if acks else None

    def ask(self, kind):
        """Requests one message at once."""
        assert self.command(ONCE, kind) == ACCEPTED
        return [m for m in self.messages if m.get_msgId() == kind][-1]

    def heartbeat(self, kind=6):
        self.send(dialect.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3))

    def fault(self, *texts):
        self.fake.faults.apply(texts)

    def texts(self) -> list[str]:
        return [m.text for m in self.messages if m.get_type() == "STATUSTEXT"]

    def up(self, height=5.0):
        assert self.command(MODE, 1, GUIDED) == ACCEPTED
        assert self.command(ARM, 1) == ACCEPTED
        assert self.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height) == ACCEPTED
        self.wait(5.0 + height)

    def target(self, mask, place=(0, 0, 0), velocity=(0, 0, 0), frame=1):
        zero = (0, 0, 0)
        message = dialect.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, frame, mask, *place, *velocity, *zero, 0, 0
        )
        return self.send(message)

    @property
    def place(self):
        return self.autopilot.vehicle.place
