"""DroneCAN servos on a bus in memory: two nodes with one id, and an outdated position."""

from __future__ import annotations

import asyncio

import pytest

from lfield.driver import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.drone_can.messages import (
    ACTUATOR_COMMAND,
    ACTUATOR_STATUS,
    GET_NODE_INFO,
    NODE_STATUS,
    decode,
    encode,
)
from lfield_can.drone_can.transfers import Transfer, TransferKind, frames_of

NODE, PERIOD, SPEED = 42, 0.05, 1.0


class ServoNode:
    """A node that was switched on `since` seconds ago; its servo has no failsafe."""

    def __init__(self, bus, since=0.0) -> None:
        self.bus, self.time = bus, since
        self.position = self.goal = 0.0
        self.commands, self.is_mute = 0, False

    def say(self, data_type, data, number, kind=None):
        transfer = Transfer(kind or data_type.kind, NODE, number % 32, data)
        for frame in frames_of(transfer, data_type.signature):
            self.bus.received(frame)

    def on_frame(self, frame: Frame) -> None:
        if frame.id & 0x80:
            self.say(GET_NODE_INFO, bytes(40) + b"\0x", frame.data[-1], TransferKind(1, 126))
        elif frame.id >> 8 & 0xFFFF == ACTUATOR_COMMAND.id:
            self.commands += 1
            self.goal = decode(ACTUATOR_COMMAND, frame.data[:-1])[0]["value"]

    async def live(self):
        due = 0.0
        while True:
            if due <= 0.0:
                due += 1.0
                self.say(NODE_STATUS, encode(NODE_STATUS, {"uptime": self.time}), int(self.time))
            step = max(-SPEED * PERIOD, min(SPEED * PERIOD, self.goal - self.position))
            self.position += step
            values = {"position": self.position, "speed": step / PERIOD}
            if not self.is_mute:
                self.say(ACTUATOR_STATUS, encode(ACTUATOR_STATUS, values), 0)
            await asyncio.sleep(PERIOD)
            self.time, due = self.time + PERIOD, due - PERIOD


@pytest.fixture
def play(bench, binding, bus):
    def run(scenario, *nodes):
        bus.device = lambda frame: [node.on_frame(frame) for node in nodes]
        bound = binding(
            "DroneCanServo", options={"node": NODE}, waivers=["device_watchdog"], safe_state="hold"
        )
        b = bench(bound, bus=bus, fakes=[node.live for node in nodes])
        b.run(lambda servo: scenario(b, servo))

    return run


@pytest.mark.parametrize("apart", [0.0, 0.3, 100.0])
def test_two_nodes_with_one_id(play, bus, apart):
    """The conflict is also detected if both were switched on together, with equal uptimes."""

    async def scenario(b, servo):
        await asyncio.sleep(5.0)
        with pytest.raises(DeviceError, match="moveTo refused: two nodes have id 42"):
            await servo.execute("moveTo", [0.5])

    play(scenario, ServoNode(bus), ServoNode(bus, apart))


def test_one_node_that_restarts_is_not_two(play, bus):
    node = ServoNode(bus, 100.0)

    async def scenario(b, servo):
        await asyncio.sleep(5.0)
        node.time = 0.0
        await asyncio.sleep(2.0)
        assert [note for note in b.notes if note.code == "can-node-restarted"] != []
        await servo.execute("moveTo", [0.5])

    play(scenario, node)


def test_an_outdated_position_is_not_held(play, bus):
    """The statuses are lost, the commands arrive: the servo would return to its last reported position."""
    node = ServoNode(bus)

    async def scenario(b, servo):
        motion = asyncio.ensure_future(servo.execute("moveTo", [1.5]))
        await asyncio.sleep(0.4)
        node.is_mute = True
        with pytest.raises(DeviceError, match="no message for"):
            await motion
        count, at = node.commands, node.position
        with pytest.raises(DeviceError, match="no message for"):
            await servo.make_safe()
        await asyncio.sleep(1.0)
        assert (node.commands, node.position >= at) == (count, True)
        node.is_mute = False
        await asyncio.sleep(1.0)
        assert node.commands > count, "it holds again"

    play(scenario, node)
