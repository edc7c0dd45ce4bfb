"""CiA 402 with canopen's LocalNode as the drive, on virtual time."""

from __future__ import annotations

import asyncio
import math

import pytest
from can_local_drive import LocalDrive
from coroutine_tests import on_bench

from lfield.errors import DeviceError

OPTIONS = {"protocol": "cia402", "node": 5, "counts": 10_000, "connect": 3.0}
LIMITS = {"speed": 20.0}


@pytest.fixture
def rig(bench, binding, bus):
    """A bench whose drive is present before the driver looks for it."""

    def make(drive=None, *, others=(), **given):
        given = {
            "limits": LIMITS,
            "waivers": ["no_homing"],
            **given,
            "options": {**OPTIONS, **given.get("options", {})},
        }
        drive = drive or LocalDrive()
        drive.bus = bus
        b = bench(binding("CanAxis", **given), *others, bus=bus, fakes=[drive.live])
        b.drive = drive
        return b

    return make


@on_bench("rig")
async def test_drive_is_identified_configured_and_moved(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("moveTo", [2.0, 10.0])
    assert b.values["position"] == pytest.approx(2.0, abs=0.01)
    assert b.drive.position == pytest.approx(2.0 / math.tau * 10_000, abs=20)
    await axis.execute("disable", [])
    assert b.drive.get(0x1017) == 100
    assert b.drive.get(0x607F) == round(20.0 / math.tau * 10_000)
    assert b.values["enabled"] is False
    assert b.values["voltage"] == 24.5
    assert "current" not in b.values  # the drive has no object for it
    assert any("does not report current" in note for note in b.notes)


@on_bench("rig", opened=False)
async def test_identity_of_a_cia402_drive(b, axis, /):
    identity = "CiA 402 drive, node 5, vendor 0xABC, product 0x7"
    assert (await axis.open(), await axis.serial()) == (identity, "serial number 4711")


@on_bench("rig", ttl=0.1)
async def test_watchdog_is_set_verified_and_fed_until_the_bus_is_quiet(b, axis, /):
    assert b.drive.get(0x1016, 1) == 127 << 16 | 200
    assert b.drive.get(0x6007) == 3
    await asyncio.sleep(0.5)
    gaps = [after - before for before, after in zip(b.drive.beats, b.drive.beats[1:], strict=False)]
    assert max(gaps) < 0.2
    b.driver.quiet()
    sent = len(b.drive.beats)
    await asyncio.sleep(0.3)
    assert len(b.drive.beats) <= sent + 1
    b.driver.resume()
    # The first heartbeat follows at once: the watchdog may be about to expire.
    assert b.bus.sent[-1].id == 0x77F
    await b.until(lambda: len(b.drive.beats) > sent + 2)


@pytest.mark.parametrize("absent", [0x6007, 0x1016])
def test_drive_without_a_watchdog_requires_a_waiver(rig, absent):
    async def mission(axis):
        with pytest.raises(DeviceError, match=r"waivers: \[device_watchdog\]"):
            await axis.open()

    rig(LocalDrive(without={absent})).run(mission, opened=False)


@on_bench("rig")
async def test_cia402_setpoints_are_sent_once(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [3.0])
    await b.until(lambda: b.values["velocity"] == pytest.approx(3.0, abs=0.01))
    sent = [frame for frame in b.bus.sent if frame.id == 0x405]
    await asyncio.sleep(0.3)
    assert [frame for frame in b.bus.sent if frame.id == 0x405] == sent
    assert len(sent) == 1
    await axis.execute("setPosition", [axis.protocol.state.position])
    await axis.execute("setTorque", [0.1])
    assert b.drive.get(0x6061) == 4
    assert b.drive.get(0x6071) == 200  # thousandths of 0.5 N m


def test_drive_without_velocity_mode_positions_and_refuses_velocities(rig):
    b = rig(LocalDrive(without={0x1402, 0x1602, 0x60FF}))

    async def mission(axis):
        await axis.execute("enable", [])
        await axis.execute("moveTo", [1.0, 10.0])
        with pytest.raises(DeviceError, match="the drive does not accept velocities"):
            await axis.execute("setVelocity", [1.0])

    b.run(mission)
    assert any("the drive does not accept velocities" in note for note in b.notes)


@pytest.mark.parametrize("without", [set(), {0x1402, 0x1602, 0x60FF}], ids=["velocities", "positions_only"])
def test_halt_keeps_the_axis_enabled_and_discards_the_goal(rig, without):
    """This drive resumes its goal when the halt bit is cleared, as CiA 402-2 specifies."""
    b = rig(LocalDrive(without=without))

    async def mission(axis):
        await axis.execute("enable", [])
        going = asyncio.ensure_future(axis.execute("moveTo", [6.0, 4.0]))
        await b.until(lambda: b.values["position"] > 0.5)
        going.cancel()
        await axis.execute("halt", [])
        stood = b.drive.position
        assert b.values["velocity"] == pytest.approx(0.0, abs=0.05)
        assert b.values["enabled"] is True
        await asyncio.sleep(0.3)
        assert b.drive.position == pytest.approx(stood, abs=20)
        assert not b.drive.controls[-1] & 0x100, "the next motion requires a cleared halt bit"
        await axis.execute("moveTo", [0.0, 10.0])
        assert b.values["position"] == pytest.approx(0.0, abs=0.01)

    b.run(mission)


@on_bench("rig")
async def test_axis_that_does_not_halt_raises_an_exception(b, axis, /, monkeypatch):
    monkeypatch.setattr("lfield_can.axis.HALT_TIMEOUT", 0.3)

    await axis.execute("enable", [])
    await axis.execute("setVelocity", [3.0])
    await b.until(lambda: b.values["velocity"] == pytest.approx(3.0, abs=0.01))
    b.drive.deaf_to_halt = True
    with pytest.raises(
        DeviceError, match=r"halt: it is still moving after 0.3 s \(operation enabled, 3 rad/s\)"
    ):
        await axis.execute("halt", [])


@on_bench("rig")
async def test_halt_of_a_disabled_drive_sends_nothing(b, axis, /):
    sent = len(b.drive.controls)
    await axis.execute("halt", [])
    assert b.drive.controls[sent:] == []
    assert b.values["enabled"] is False


@on_bench("rig", ttl=5.0)
async def test_heartbeat_follows_the_watchdog_setup_at_once(b, axis, /):
    """The drive supervises from the first heartbeat: it would not detect a guard that dies before that."""
    await b.until(lambda: b.drive.beats, 0.5)
    watched = [
        frame.data
        for frame in b.bus.sent
        if frame.id == 0x605 and frame.data[:4] == bytes.fromhex("23161001")
    ]
    assert watched[-1][4:] == (127 << 16 | 10_000).to_bytes(4, "little")
    last_write = max(n for n, frame in enumerate(b.bus.sent) if frame.data == watched[-1])
    assert any(frame.id == 0x77F for frame in b.bus.sent[last_write:])


@on_bench("rig", ttl=0.2, options={"cyclic": True})
async def test_cyclic_setpoint_is_streamed_until_its_time_to_live_ends(b, axis, /):
    await axis.execute("enable", [])
    start = b.driver.clock.monotonic()
    await axis.execute("setVelocity", [3.0])
    await asyncio.sleep(0.1)
    assert len([f for f in b.bus.sent if f.id == 0x405]) > 3
    await asyncio.sleep(0.2)
    sent = len([f for f in b.bus.sent if f.id == 0x405])
    await asyncio.sleep(0.1)
    assert len([f for f in b.bus.sent if f.id == 0x405]) == sent
    assert b.driver.clock.monotonic() - start > 0.3
    await axis.make_safe()
    await axis.execute("enable", [])
    before = b.drive.position
    await axis.execute("setPosition", [axis.protocol.state.position + 50.0])
    await asyncio.sleep(0.1)
    # Within the speed limit, without a jump.
    assert 0 < b.drive.position - before < 20.0 / math.tau * 10_000 * 0.2


@pytest.mark.parametrize(
    ("state", "control", "status"),
    [("brake", 0x02, 0x0217), ("torque_hold", 0x02, 0x0217), ("torque_off", 0x00, 0x0240)],
)
@on_bench("rig", given="safe_state=state")
async def test_cia402_safe_state_is_confirmed(b, axis, /, state, control, status):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [5.0])
    await b.until(lambda: b.values["velocity"] > 4.0)
    await axis.make_safe()
    assert b.drive.state == status
    assert b.drive.controls[-1] == control
    with pytest.raises(DeviceError, match=r"not enabled .* call enable\(\) first"):
        await axis.execute("setVelocity", [1.0])
    assert (b.drive.get(0x605A) == 6) is (state == "torque_hold")


@on_bench("rig")
async def test_cia402_unconfirmed_safe_state_is_an_error(b, axis, /, monkeypatch):
    monkeypatch.setattr("lfield_can.axis.SAFE_TIMEOUT", 0.5)

    await axis.execute("enable", [])
    b.drive.on_control = lambda word: None
    with pytest.raises(DeviceError, match=r"the safe state brake is not confirmed \(operation enabled"):
        async with asyncio.timeout(8.0):
            await axis.make_safe()


@on_bench("rig")
async def test_fault_is_described_and_reset(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [5.0])
    b.drive.fail(0x7121)
    await b.until(lambda: b.values["fault"] != "")
    assert b.values["fault"] == "motor blocked (0x7121)"
    for call in (("setVelocity", [1.0]), ("enable", [])):
        with pytest.raises(DeviceError, match=r"motor blocked \(0x7121\); resetFault\(\) clears it"):
            await axis.execute(*call)
    await axis.make_safe()
    await axis.execute("resetFault", [])
    await b.until(lambda: b.values["fault"] == "")
    await axis.execute("enable", [])


@on_bench("rig")
async def test_blocked_motion_fails_and_does_not_continue_later(b, axis, /, monkeypatch):
    monkeypatch.setattr("lfield_can.axis.STUCK_TIME", 0.4)

    await axis.execute("enable", [])
    b.drive.stuck = True
    with pytest.raises(DeviceError, match=r"moveTo failed: no progress for 0.4 s, 3.000 rad from its goal"):
        await axis.execute("moveTo", [3.0, 5.0])
    b.drive.stuck = False
    await asyncio.sleep(1.0)
    assert abs(b.values["position"]) < 0.1


@on_bench("rig", waivers=[], options={"homing_method": 37, "homing_speed": 1.0})
async def test_homing_is_required_before_positioning(b, axis, /):
    await axis.execute("enable", [])
    with pytest.raises(DeviceError, match=r"has not been homed; call home\(\) first"):
        await axis.execute("moveTo", [1.0, 5.0])
    await axis.execute("home", [])
    await b.until(lambda: b.values["referenced"])
    await axis.execute("moveTo", [1.0, 5.0])
    assert b.drive.get(0x6098) == 37
    assert b.drive.get(0x6099, 1) == round(1.0 / math.tau * 10_000)


@on_bench("rig")
async def test_restarted_drive_is_configured_again_and_stays_disabled(b, axis, /):
    await axis.execute("enable", [])
    travel = asyncio.create_task(axis.execute("moveTo", [1000.0, 5.0]))
    await asyncio.sleep(0.2)
    b.drive.restart()
    with pytest.raises(DeviceError, match="has restarted"):
        await travel
    assert (b.values["enabled"], b.values["state"]) == (False, "not operational"), (
        "values at the time of the exception"
    )
    await b.until(lambda: any("set up again" in note for note in b.notes), 5.0)
    assert b.drive.get(0x1016, 1) == 127 << 16 | 1000
    assert b.values["enabled"] is False
    await axis.execute("enable", [])


@on_bench("rig")
async def test_silent_drive_fails_the_motion_and_returns_stopped(b, axis, /):
    await axis.execute("enable", [])
    start = b.driver.clock.monotonic()
    travel = asyncio.create_task(axis.execute("moveTo", [1000.0, 5.0]))
    await asyncio.sleep(0.2)
    b.drive.silent = True
    with pytest.raises(DeviceError, match="no message for") as error:
        await travel
    assert error.value.kind == "DeviceTimeoutException"
    assert b.driver.clock.monotonic() - start < 3.0
    assert (b.values["online"], b.values["enabled"]) == (False, False), "values at the time of the exception"
    await b.until(lambda: b.values["state"] == "silent")
    b.drive.silent = False
    await b.until(lambda: b.values["online"] and b.drive.state != 0x0237)
    await axis.make_safe()
    assert [note.code for note in b.notes if note.startswith("link ")] == ["can-silent", "can-responding"]


@on_bench("rig", opened=False)
async def test_duplicate_node_id_is_detected_at_opening(b, axis, /):
    original_say = b.drive.say

    def twice(can_id, data):
        original_say(can_id, data)
        if can_id == 0x585:
            original_say(can_id, data)

    b.drive.network.say = twice
    with pytest.raises(DeviceError, match="two devices answer to this node id"):
        await axis.open()


def test_two_bindings_of_one_node_are_refused(rig, binding):
    b = rig(others=[binding("CanAxis", field="other", options=OPTIONS)])

    async def mission(*axes):
        raise AssertionError("the device must not be opened")

    with pytest.raises(
        DeviceError, match=r"winch.other and winch.axis have the same frames \(id 0x\w+\); give each device"
    ):
        b.run(mission)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"counts": 0}, "requires 'counts'"),
        ({"node": 0}, "node id is 1 to 127"),
        ({"eds": "/nonexistent.eds"}, "is not a readable EDS file"),
    ],
)
def test_invalid_cia402_option_is_refused(rig, options, words):
    async def mission(axis):
        raise AssertionError("the device must not be opened")

    with pytest.raises(DeviceError, match=words):
        rig(options=options).run(mission)


@on_bench("rig", opened=False)
async def test_node_of_another_device_type_is_refused(b, axis, /):
    b.drive.node.data_store[0x1000] = {0: (0x191).to_bytes(4, "little")}
    with pytest.raises(DeviceError, match="is not a CiA 402 drive: its device type 0x1000 is 0x00000191"):
        await axis.open()


@on_bench("rig", options={"connect": 0.5}, opened=False)
async def test_absent_cia402_node_is_an_error_within_its_time(b, axis, /):
    b.drive.silent = True
    start = b.driver.clock.monotonic()
    with pytest.raises(DeviceError, match=r"no message from node 5 .* within 0.5 s") as error:
        await axis.open()
    assert error.value.kind == "DeviceTimeoutException"
    assert b.driver.clock.monotonic() - start < 1.5


@on_bench("rig", opened=False)
async def test_malformed_sdo_answers_are_errors(b, axis, /):
    original_say = b.drive.say
    b.drive.network.say = lambda can_id, data: original_say(can_id, bytes(8) if can_id == 0x585 else data)
    with pytest.raises(DeviceError, match="device type 0x1000:0"):
        await axis.open()
