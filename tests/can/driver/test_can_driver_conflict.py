"""Two devices with one id are detected and named; foreign frames and reading tools cause no conflict."""

from __future__ import annotations

import asyncio
import random
import re
import struct

import pytest
from can_local_drive import LocalDrive
from coroutine_tests import on_bench
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.protocols.id_conflict import (
    MIN_SURPLUS,
    PROBED_OBJECTS,
    RETURNS,
    Alternation,
    IdConflictProbe,
)

NODE = 5
TWO = r"two devices answer to this node id \(5\)"


class Wire:
    """The bus of a bench: all drives receive every frame, and frames get lost."""

    def __init__(self, bus, loss: float = 0.0, seed: int = 1) -> None:
        self.bus, self.loss, self.rng = bus, loss, random.Random(seed)
        self.drives: list[LocalDrive] = []
        self.echoes = False
        bus.device = self.on_frame

    def on_frame(self, frame: Frame) -> None:
        if self.echoes:
            self.bus.say(frame.id, frame.data)
        for drive in self.drives:
            if self.rng.random() >= self.loss:
                drive.on_frame(frame)

    def say(self, identifier: int, data: bytes) -> None:
        if identifier != 0x580 + NODE or self.rng.random() >= self.loss:
            self.bus.say(identifier, data)

    def join(self) -> LocalDrive:
        """Add a drive and switch it on."""
        drive = LocalDrive(NODE)
        drive.bus = self
        drive.attach()
        self.bus.device = self.on_frame
        self.drives.append(drive)
        return drive

    def restart(self, drive: LocalDrive) -> None:
        drive.restart()
        self.bus.device = self.on_frame

    def read(self, index: int, subindex: int = 0) -> None:
        """Another client reads an object."""
        request = struct.pack("<BHBI", 0x40, index, subindex, 0)
        self.bus.say(0x600 + NODE, request)
        self.on_frame(Frame(0x600 + NODE, request))

    @property
    def device(self):
        return self.bus.device

    @device.setter
    def device(self, handler) -> None:
        pass


@pytest.fixture
def rig(bench, drive, bus):
    def make(**given):
        wire = Wire(bus, **given)

        async def live() -> None:
            wire.join()
            await asyncio.Event().wait()

        b = bench(drive()("virtual:test"), bus=bus, fakes=[live])
        b.wire = wire
        return b

    return make


def answer(index: int, subindex: int = 0, value: int = 7) -> bytes:
    return struct.pack("<BHBI", 0x43, index, subindex, value)


async def restarts(b, axis) -> None:
    """The drive loses power for a moment and is configured again."""
    before = sum("set up again" in note for note in b.notes)
    b.wire.restart(b.wire.drives[0])
    await b.until(lambda: sum("set up again" in note for note in b.notes) > before)
    await axis.execute("enable", [])


@pytest.mark.parametrize("foreign", [1, 20])
@on_bench("rig")
async def test_foreign_sdo_answers_do_not_disturb_the_set_up(b, axis, /, foreign):
    for _ in range(foreign):
        b.bus.say(0x580 + NODE, answer(0x6041))
        b.bus.say(0x580 + NODE, answer(0x1018, 1))
    for _ in range(3):
        await restarts(b, axis)
    assert not any("two devices" in note for note in b.notes)


@on_bench("rig", opened=False)
async def test_one_surplus_answer_during_set_up_is_no_second_device(b, axis, /):
    original_say = b.wire.say

    def once_more(identifier, data):
        original_say(identifier, data)
        if identifier == 0x580 + NODE and data[1:3] == bytes([0x18, 0x10]):
            b.wire.say = original_say
            original_say(identifier, data[:4] + b"\1\2\3\4")

    b.wire.say = once_more
    await axis.open()


@on_bench("rig")
async def test_tool_polling_the_same_objects_is_no_second_device(b, axis, /):
    async def poll() -> None:
        while True:
            for key in ((0x1018, 4), (0x1018, 1), (0x1000, 0), (0x6041, 0)):
                b.wire.read(*key)
                await asyncio.sleep(0.004)

    polling = asyncio.ensure_future(poll())
    await restarts(b, axis)
    polling.cancel()
    assert not any("two devices" in note for note in b.notes)


@pytest.mark.few(4)
@pytest.mark.parametrize("pause", [0.001, 0.004, 0.01, 0.02, 0.024, 0.03])
@pytest.mark.parametrize("echoes", [False, True])
def test_tool_scanning_all_subindexes_is_no_second_device(rig, pause, echoes):
    """Also in step with the rounds of the probe, and with an adapter that echoes its own frames."""
    b = rig()
    b.wire.echoes = echoes

    async def mission(axis):
        async def scan() -> None:
            while True:
                # It reads the object of the next probe about every second time.
                for subindex in range(0x5C, 0x70):
                    b.wire.read(0x1018, subindex)
                    await asyncio.sleep(pause)

        scanning = asyncio.ensure_future(scan())
        for _ in range(3):
            await restarts(b, axis)
        scanning.cancel()
        b.wire.join()
        await b.until(lambda: any("two devices" in note for note in b.notes))

    b.run(mission)
    assert sum("two devices" in note for note in b.notes) == 1


def test_echoing_adapter_neither_hides_nor_invents_a_device(rig):
    b = rig()
    b.wire.echoes = True

    async def mission(axis):
        await restarts(b, axis)
        b.wire.join()
        await b.until(lambda: any("two devices" in note for note in b.notes))

    b.run(mission)


@pytest.mark.parametrize("seed", [1, 2, 3])
@on_bench("rig", loss=0.25, given="seed", opened=False)
async def test_lost_answers_do_not_hide_a_second_device(b, axis, /, seed):
    b.wire.join()
    reason = ""
    for _ in range(5):  # with so much loss a set-up may also fail by timeout
        with pytest.raises(DeviceError) as error:
            await axis.open()
        reason = error.value.reason
        if error.value.kind != "DeviceTimeoutException":
            break
    assert re.search(TWO, reason), reason


@on_bench("rig")
async def test_second_device_that_joins_later_is_named_and_motion_is_refused(b, axis, /):
    await axis.execute("enable", [])
    second = b.wire.join()
    await b.until(lambda: any("two devices" in note for note in b.notes))
    for call in (["enable"], ["moveTo", 1.0, 1.0], ["setVelocity", 1.0]):
        with pytest.raises(DeviceError, match=f"{call[0]} refused: {TWO}"):
            await axis.execute(call[0], call[1:])
    await asyncio.sleep(10.0)
    assert sum("two devices" in note for note in b.notes) == 1
    second.silent = True
    second.node.nmt.stop_heartbeat()
    second.task.cancel()
    b.wire.drives.remove(second)
    await b.until(lambda: any("set up again" in note for note in b.notes))
    await axis.execute("enable", [])


@pytest.mark.parametrize("boots", [True, False])
@on_bench("rig")
async def test_second_device_that_joins_stops_the_axis_in_motion(b, axis, /, boots):
    """Also a device that is plugged in with its power on: it sends no boot-up message."""
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [1.0])
    await asyncio.sleep(0.5)
    first, original_say = b.wire.drives[0], b.wire.say
    assert first.velocity > 0.0
    if not boots:
        b.wire.say = lambda identifier, data: None
    second = b.wire.join()
    b.wire.say = original_say
    await asyncio.sleep(2.5)
    assert any("two devices" in note for note in b.notes)
    assert first.velocity == second.velocity == 0.0
    assert first.state != 0x0237
    with pytest.raises(DeviceError, match=TWO):
        await axis.execute("setVelocity", [1.0])
    assert sum("two devices" in note for note in b.notes) == 1


@on_bench("rig")
async def test_drive_that_another_master_takes_out_of_operation_is_stopped(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [1.0])
    await asyncio.sleep(0.5)
    drive = b.wire.drives[0]
    drive.node.nmt.state = "PRE-OPERATIONAL"
    await b.until(lambda: any("set up again" in note for note in b.notes))
    assert drive.velocity == 0.0
    assert b.values["enabled"] is False


@on_bench("rig")
async def test_values_show_the_silence_when_the_exception_is_raised(b, axis, /):
    await axis.execute("enable", [])
    motion = asyncio.ensure_future(axis.execute("moveTo", [100.0, 2.0]))
    await asyncio.sleep(0.5)
    b.wire.drives[0].silent = True
    with pytest.raises(DeviceError, match="no message"):
        await motion
    assert (b.values["online"], b.values["enabled"], b.values["state"]) == (False, False, "silent")


@pytest.mark.parametrize("every", [1, 7])
@on_bench("rig")
async def test_repeated_answers_do_not_stop_an_axis_in_motion(b, axis, /, every):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [1.0])
    original_say, count = b.wire.say, [0]

    def at_times_twice(identifier, data):
        original_say(identifier, data)
        if identifier == 0x580 + NODE and struct.unpack_from("<H", data, 1)[0] != 0x1018:
            count[0] += 1
            if count[0] % every == 0:
                original_say(identifier, data)

    b.wire.say = at_times_twice
    for _ in range(10):
        await asyncio.sleep(0.5)
        await axis.execute("setVelocity", [1.0])
    assert b.wire.drives[0].velocity > 0.0


@on_bench("rig", opened=False)
async def test_drive_that_ignores_absent_objects_is_probed_at_set_up_only(b, axis, /):
    """Each such request takes a second without an answer, and commands would have to wait."""

    def is_unanswered_probe(frame):
        return frame.id == 0x600 + NODE and frame.data[1:3] == b"\x18\x10" and frame.data[3] >= 0x60

    received = b.wire.on_frame
    b.bus.device = b.wire.on_frame = lambda frame: None if is_unanswered_probe(frame) else received(frame)
    await axis.open()
    before = len(b.bus.sent)
    await asyncio.sleep(5.0)
    requests = [f for f in b.bus.sent[before:] if is_unanswered_probe(f) and f.data[0] != 0x80]
    assert requests == []


@on_bench("rig")
async def test_request_of_another_client_does_not_count_as_a_message(b, axis, /):
    b.wire.drives[0].silent = True
    for _ in range(100):
        b.bus.say(0x600 + NODE, struct.pack("<BHBI", 0x40, 0x6041, 0, 0))
        await asyncio.sleep(0.1)
        if not b.values["online"]:
            return
    raise AssertionError("the request counts as a message of the device")


@given(
    st.lists(st.integers(0, 2), max_size=12),
    st.lists(st.sampled_from(PROBED_OBJECTS), max_size=MIN_SURPLUS - 1),
)
def test_probe_ends_and_single_frames_prove_no_conflict(lost, foreign):
    """An answer to a repeated request counts for its request."""
    conflict_probe, rounds = IdConflictProbe(), 0
    for key in foreign:
        conflict_probe.on_answer(key)
    while (key := conflict_probe.next_key()) is not None:
        times = 1 + (lost[rounds] if rounds < len(lost) else 0)
        rounds += 1
        for _ in range(times):
            conflict_probe.on_request(key)
        for _ in range(1 if times == 3 else times):
            conflict_probe.on_answer(key)
    assert rounds <= len(PROBED_OBJECTS)
    assert not conflict_probe.is_doubled


# -- ODrive: no answers, but positions that alternate ------------------------------------------------------


def estimate(bus, position: float, velocity: float = 0.0) -> None:
    bus.say(3 << 5 | 0x09, struct.pack("<ff", position, velocity))


@pytest.fixture
def wheel(bench, odrive, bus):
    """An axis that stands still in closed loop once it is commanded."""
    state = [1]

    def on_frame(frame: Frame) -> None:
        if frame.id == 3 << 5 | 0x07:
            state[0] = struct.unpack("<I", frame.data)[0]

    async def live() -> None:
        bus.device = on_frame
        while True:
            estimate(bus, 2.0)
            bus.say(3 << 5 | 0x01, struct.pack("<IB3x", 0, state[0]))
            await asyncio.sleep(0.01)

    return bench(odrive()("virtual:test"), bus=bus, fakes=[live])


def test_two_odrives_with_one_id_are_named_and_stopped(wheel):
    async def mission(axis):
        await axis.execute("enable", [])

        async def other() -> None:
            await asyncio.sleep(0.005)
            while True:
                estimate(wheel.bus, 7.0)
                await asyncio.sleep(0.01)

        second = asyncio.ensure_future(other())
        await wheel.until(lambda: any("two axes have node id 3" in note for note in wheel.notes))
        with pytest.raises(DeviceError, match="setVelocity refused: two axes have node id 3"):
            await axis.execute("setVelocity", [1.0])
        second.cancel()
        await wheel.until(lambda: any("the id is unique" in note for note in wheel.notes))
        await axis.execute("setVelocity", [1.0])

    wheel.run(mission)
    assert sum("two axes" in note for note in wheel.notes) == 1


def test_single_foreign_estimate_is_no_second_odrive(wheel):
    async def mission(axis):
        await axis.execute("enable", [])
        for _ in range(5):
            estimate(wheel.bus, 7.0)
            await asyncio.sleep(0.5)
        await axis.execute("setVelocity", [1.0])

    wheel.run(mission)
    assert not any("two axes" in note for note in wheel.notes)


@given(st.lists(st.floats(-50.0, 50.0), min_size=20, max_size=60), st.floats(0.001, 0.05))
def test_motion_of_one_axis_is_not_taken_for_two(speeds, period):
    """At any speed: velocities are reported with the positions."""
    alternation, position = Alternation(), 0.0
    for step, speed in enumerate(speeds):
        position += speed * period
        alternation.on_position(position, speed, step * period)
        assert not alternation.is_proved(step * period)


def test_two_alternating_positions_prove_two_axes_at_a_high_rate_only():
    fast, slow = Alternation(), Alternation()
    for step in range(2 * RETURNS + 2):
        fast.on_position(5.0 * (step % 2), 0.0, step * 0.005)
        slow.on_position(5.0 * (step % 2), 0.0, step * 1.0)
    assert fast.is_proved(step * 0.005)
    assert not slow.is_proved(step * 1.0)
