"""Detection of rest in a safe state, on fakes with inertia."""

from __future__ import annotations

import asyncio
import re
import struct

import pytest
from can_local_drive import LocalDrive
from coroutine_tests import on_bench
from msgspec import structs

from lfield.errors import DeviceError
from lfield_can.bus.frames import Frame
from lfield_sim.can import can_bus as fake
from lfield_sim.can.bus_world import TICK, BusWorld
from lfield_sim.can.canopen.pdo import Tpdo
from lfield_sim.can.device_specs import build, parse
from lfield_sim.faults import Faults

NODE = 3
ODRIVE = {"options": {"protocol": "odrive", "node": NODE}, "waivers": ["device_watchdog", "no_homing"]}


class FakeBus:
    """The bus of the fakes with the driver on it, in the time of the loop."""

    def __init__(self, bus, *devices: str) -> None:
        self.bus = bus
        specs = [parse(text) for text in devices]
        self.faults = Faults(fake.FAULTS, {spec.id: spec.name for spec in specs})
        self.devices = build(specs, self.faults)
        self.world = BusWorld(self.devices, self.faults, bitrate=1_000_000)
        self.port = fake.BusPort(lambda frame, _: bus.say(frame.identifier, frame.data))
        self.world.bus.attach(self.port)
        bus.device = self.on_frame

    def on_frame(self, frame: Frame) -> None:
        now = asyncio.get_running_loop().time()
        self.world.bus.send(self.port, fake.CanFrame(frame.id, frame.data), now)

    async def live(self) -> None:
        while True:
            await asyncio.sleep(TICK)
            self.world.advance(asyncio.get_running_loop().time())

    def command(self, command: int, layout: str, *values) -> None:
        """A frame of another master, which the driver does not receive."""
        now = asyncio.get_running_loop().time()
        self.world.bus.send(self.port, fake.CanFrame(NODE << 5 | command, struct.pack(layout, *values)), now)


@pytest.fixture
def rig(bench, binding, bus):
    def make(device="odrive:3", **given):
        given = {**ODRIVE, "limits": {"speed": 50.0}, **given}
        world = FakeBus(bus, device)
        b = bench(binding("CanAxis", **given), bus=bus, fakes=[world.live])
        b.world = world
        return b

    return make


async def turning(axis, speed=20.0):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [speed])
    await asyncio.sleep(1.0)


async def rests(axis, bound):
    """The reports until the axis is at rest, and the time that this took."""
    words, start = [], asyncio.get_running_loop().time()
    while report := axis.moving():
        assert asyncio.get_running_loop().time() - start < bound, report
        words.append(report)
        await asyncio.sleep(0.1)
    return words, asyncio.get_running_loop().time() - start


@on_bench("rig", safe_state="torque_off")
async def test_coasting_axis_without_torque_reports_its_speed_until_rest(b, axis, /):
    assert axis.moving() == ""
    await turning(axis)
    await axis.make_safe()
    words, seconds = await rests(axis, 60.0)
    assert re.fullmatch(r"turning at \d\d rad/s", words[0]), words[0]
    assert words[-1].startswith("turning at 0.")
    assert seconds > 10.0  # only friction slows it down


CIA402 = {"options": {"protocol": "cia402", "node": 5, "counts": 4096}, "waivers": ["no_homing"]}


@pytest.fixture
def drive(rig):
    """A fake CiA 402 drive with a hanging load and no brake; the bench."""

    def make(**given):
        b = rig("cia402:5,load=0.5,counts=4096", **{**CIA402, **given})
        (b.drive,) = b.world.devices
        return b

    return make


def keep(b, index, value):
    """Set an object as its owner does: the drive keeps the value over a restart."""
    objects = b.drive.node.objects
    objects.entries[index, 0] = structs.replace(objects.entries[index, 0], default=value)
    objects.put(index, value)


@pytest.mark.parametrize("state", ["brake", "torque_hold"])
@on_bench("drive", given="safe_state=state", opened=False)
async def test_quick_stop_that_coasts_is_refused_as_brake(b, axis, /, state):
    """0x605A = 0: the motor coasts. For torque_hold the driver sets it; for brake the owner must."""
    keep(b, 0x605A, 0)
    if state == "torque_hold":
        await axis.open()
        assert b.drive.node.objects.get(0x605A) == 6
        return
    with pytest.raises(DeviceError, match=r"quick stop coasts \(0x605A is 0\).* set it to 2"):
        await axis.open()


def test_coasting_fault_reaction_is_noted(drive):
    b = drive()
    keep(b, 0x605A, 7)
    keep(b, 0x605E, 0)

    async def mission(axis):
        notes = [note for note in b.notes if "0x605" in note]
        assert notes == ["coasts after a fault: object 0x605E (fault reaction) is 0"]

    b.run(mission)


@on_bench("drive")
async def test_values_sent_on_change_stay_valid_while_the_heartbeat_arrives(b, axis, /):
    """A drive at rest sends nothing new; its position is still valid."""
    await axis.execute("enable", [])
    axis.protocol.pdo_configuration = structs.replace(axis.protocol.pdo_configuration, by_changes=True)
    b.world.faults.apply(["lost_tpdo=true"])
    await asyncio.sleep(0.1)
    for _ in range(4):
        b.values.clear()
        await asyncio.sleep(0.3)
        assert b.values.keys() >= {"position", "velocity", "state", "enabled"}


@on_bench("drive")
async def test_sdo_answer_overtaken_by_process_data_is_ignored(b, axis, /):
    """The drive reads a value, changes it, sends the change, and only then is its answer on the bus."""
    await axis.execute("enable", [])
    protocol = axis.protocol
    protocol.pdo_configuration = structs.replace(protocol.pdo_configuration, by_changes=True)
    b.world.faults.apply(["lost_tpdo=true"])
    await asyncio.sleep(0.1)
    objects, say = b.drive.node.objects, b.bus.say

    def overtaken(identifier, data):
        if identifier == 0x580 + 5:
            for index, value in ((0x6041, 0x1237), (0x6064, 4096), (0x606C, 512)):
                objects.put(index, value)
            for tpdo in (Tpdo(objects, number) for number in range(4)):
                if tpdo.identifier is not None:
                    say(tpdo.identifier, tpdo.data())
        say(identifier, data)

    b.bus.say = overtaken
    published = await protocol.poll()
    assert protocol.statusword == 0x1237
    assert published["position"] == protocol.units.position(4096)
    assert published["velocity"] == protocol.units.velocity(512)


@on_bench("drive", safe_state="torque_hold")
async def test_enabling_a_held_axis_does_not_release_its_load(b, axis, /):
    """The driver uses transition 16; without voltage in between the load would fall."""
    await axis.execute("enable", [])
    await asyncio.sleep(0.3)
    await axis.make_safe()
    states, motor = set(), b.drive.motor
    b.drive.axis.objects.watch(lambda key, value: states.add(b.drive.axis.state.name))
    before = motor.angle
    await axis.execute("enable", [])
    assert states <= {"QUICK_STOP_ACTIVE", "OPERATION_ENABLED"}
    assert abs(motor.angle - before) < 0.001
    await axis.execute("setVelocity", [2.0])
    await b.until(lambda: b.values["velocity"] == pytest.approx(2.0, abs=0.1))


@on_bench("rig", "odrive:3,load=0.05", safe_state="torque_off")
async def test_axis_turned_by_its_load_is_not_at_rest(b, axis, /):
    await axis.execute("enable", [])
    await asyncio.sleep(0.5)
    await axis.make_safe()
    await asyncio.sleep(2.0)
    assert re.fullmatch(r"turning at [\d.]+ rad/s", axis.moving()), axis.moving()


@pytest.mark.parametrize("state", ["brake", "torque_hold"])
@on_bench("rig", given="safe_state=state")
async def test_braked_axis_is_at_rest_when_confirmed(b, axis, /, state):
    await turning(axis)
    assert axis.moving() == "turning at 20 rad/s"
    await axis.make_safe()
    assert axis.moving() == ""


@on_bench("rig", safe_state="torque_off")
async def test_silent_axis_is_not_at_rest(b, axis, /):
    await turning(axis)
    await axis.make_safe()
    b.bus.cut = True
    await asyncio.sleep(3.0)
    assert re.fullmatch(r"no message for [23]\.\d s, last seen turning at \d\d rad/s", axis.moving())


@on_bench("rig", safe_state="torque_off")
async def test_axis_moved_out_of_its_safe_state_by_another_master_is_not_at_rest(b, axis, /):
    await axis.execute("enable", [])
    await axis.make_safe()
    assert axis.moving() == ""
    b.world.command(0x07, "<I", 8)
    await asyncio.sleep(0.5)
    assert axis.moving().startswith("no longer in torque_off (closed loop")


class Coasting(LocalDrive):
    """A drive whose motor is slowed only by friction when the voltage is off."""

    slowing = 0.99

    def move(self) -> None:
        before = self.velocity
        super().move()
        if self.state == 0x0240:
            self.velocity = before * self.slowing
            self.position += self.velocity * 0.005
            self.set(0x606C, round(self.velocity))


def test_coasting_cia402_drive_reports_its_speed_until_rest(bench, binding, bus):
    drive = Coasting()
    drive.bus = bus
    options = {"protocol": "cia402", "node": 5, "counts": 10_000, "connect": 3.0}
    bound = binding(
        "CanAxis", options=options, limits={"speed": 20.0}, waivers=["no_homing"], safe_state="torque_off"
    )
    b = bench(bound, bus=bus, fakes=[drive.live])

    async def mission(axis):
        await axis.execute("enable", [])
        await axis.execute("setVelocity", [5.0])
        await b.until(lambda: b.values["velocity"] > 4.0)
        await axis.make_safe()
        assert re.fullmatch(r"turning at [\d.]+ rad/s", axis.moving()), axis.moving()
        await b.until(lambda: axis.moving() == "")
        assert abs(drive.velocity) < 0.05 * 10_000

    b.run(mission)


@pytest.mark.parametrize("state", ["torque_off", "torque_hold", "brake"])
@on_bench("rig", given="safe_state=state")
async def test_axis_silent_before_its_stop_is_an_error(b, axis, /, state):
    await axis.make_safe()
    b.world.faults.apply(["silence=true"])
    await asyncio.sleep(0.3)
    with pytest.raises(DeviceError, match="no message for"):
        await axis.make_safe()


@pytest.mark.parametrize("state", ["torque_off", "brake"])
@on_bench("rig", given="safe_state=state")
async def test_axis_that_turns_since_its_last_message_is_not_at_rest(b, axis, /, state):
    await turning(axis)
    await axis.make_safe()
    axis.protocol.state.velocity = 0.0  # as reported before it began to turn
    await axis.make_safe()
    words, _ = await rests(axis, 60.0)
    assert words or state == "brake"
