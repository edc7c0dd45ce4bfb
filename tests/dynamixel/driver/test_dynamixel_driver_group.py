"""Groups: synchronous motion, members that do not answer, the safe state of a group with a dead member."""

from __future__ import annotations

import asyncio
import itertools
import math

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.driver import DeviceBinding
from lfield.errors import DeviceError


async def enable(group, velocity=2.0, acceleration=10.0):
    await call(group, "torque", True)
    await call(group, "setProfile", velocity, acceleration)


@on_bench(Bench, 1, 2, 3)
async def test_group_members_reach_their_goals_at_the_same_time(bench, group, /):
    goals = [1.2, -0.6, 0.3]

    await enable(group)
    moving = asyncio.ensure_future(call(group, "moveTo", goals))
    shares = []
    while not moving.done():
        await asyncio.sleep(0.1)
        shares.append([p / g for p, g in zip(bench.values["positions"], goals, strict=True)])
    await moving
    assert bench.values["positions"] == pytest.approx(goals, abs=0.02)
    # At each time of the motion, all members have completed the same share of their distance.
    assert max(max(share) - min(share) for share in shares) < 0.12


@on_bench(Bench, 1, 2, 3)
async def test_group_setpoint_is_one_packet(bench, group, /):
    await enable(group)
    sent = len(bench.sent)
    await call(group, "setPositions", [0.1, 0.2, 0.3])
    assert [p[7] for _, p in bench.sent[sent:] if p[7] in (0x03, 0x83)] == [0x83]
    await asyncio.sleep(1.0)
    assert bench.values["positions"] == pytest.approx([0.1, 0.2, 0.3], abs=0.02)


@on_bench(Bench, 1, 2, 3)
async def test_missing_member_is_reported_and_its_position_is_nan(bench, group, /):
    await enable(group)
    bench.fault("dead@2=true")
    await asyncio.sleep(2.0)
    positions = bench.values["positions"]
    assert math.isnan(positions[1])
    assert not math.isnan(positions[0])
    assert bench.values["missing"] == [2]
    with pytest.raises(DeviceError, match="servo 2 does not answer") as error:
        await call(group, "moveTo", [0.1, 0.1, 0.1])
    assert error.value.kind == "DeviceTimeoutException"
    bench.fault("dead@2=false")
    await asyncio.sleep(1.0)
    assert bench.values["missing"] == []
    matching = [note for note in bench.notes if "servo 2" in note and "respond" in note]
    assert matching[0] == "servo 2 not responding; retrying"
    assert matching[1].startswith("servo 2 responding again: torque on, stopped by its watchdog")
    assert len(matching) == 2


@pytest.mark.parametrize("fault", ["lose=0.1", "corrupt=0.1", "noise=0.2"])
@on_bench(Bench, 1, 2, 3, 4, 5, 6)
async def test_lost_replies_do_not_stop_a_group(bench, group, /, fault):
    observed = []

    await enable(group)
    bench.fault(fault)
    moving = asyncio.ensure_future(call(group, "moveTo", [1.0, -1.0, 0.5, 0.2, 0.7, -0.3]))
    while not moving.done():
        await asyncio.sleep(0.05)
        observed.append((list(bench.values["positions"]), list(bench.values["missing"])))
    await moving
    # An unknown position is NaN, never 0. All servos move away from 0, so no known position decreases.
    for servo in range(6):
        distances = [abs(positions[servo]) for positions, _ in observed if not math.isnan(positions[servo])]
        assert all(later >= before - 0.02 for before, later in itertools.pairwise(distances))


@pytest.mark.parametrize("fault", ["other@1=true", "nonsense@1=true", "delay@1=0.04"])
@on_bench(Bench, 1, 2, 3)
async def test_member_with_invalid_answers_is_missing(bench, group, /, fault):
    await enable(group)
    await call(group, "moveTo", [0.5, 0.5, 0.5])
    bench.fault(fault)
    for _ in range(40):
        await asyncio.sleep(0.1)
        for position in bench.values["positions"]:
            assert math.isnan(position) or position == pytest.approx(0.5, abs=0.03)
    assert 1 in bench.values["missing"]
    assert 2 not in bench.values["missing"]


@pytest.mark.parametrize(("state", "item"), [("torque_off", "torque_enable"), ("torque_hold", None)])
@on_bench(Bench, 1, 2, 3, given="safe_state=state")
async def test_safe_state_reaches_all_members_and_reports_the_dead_one(bench, group, /, state, item):
    await enable(group)
    moving = asyncio.ensure_future(call(group, "moveTo", [1.5, 1.5, 1.5]))
    await asyncio.sleep(0.4)
    moving.cancel()
    bench.fault("dead@1=true")
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"^joint: servo 1 does not answer$"):
        await group.make_safe()
    assert asyncio.get_running_loop().time() - start < 1.0
    for number in (2, 3):
        if item:
            assert bench.servos[number].table[item] == 0
        else:
            assert abs(bench.servos[number].motion.motor.speed) < 0.1


@on_bench(Bench, 1, 2, 3, safe_state="torque_off")
async def test_member_whose_answers_are_lost_is_made_safe(bench, group, /):
    await enable(group)
    bench.fault("lose@2=1.0")
    with pytest.raises(DeviceError, match="servo 2 does not answer"):
        await group.make_safe()
    assert [servo.table["torque_enable"] for servo in bench.servos.values()] == [0, 0, 0]


@on_bench(Bench, 1, 2, 3, 4, 5, 6, safe_state="torque_off")
async def test_first_safe_state_packet_does_not_wait_for_dead_members(bench, group, /):
    await enable(group)
    bench.fault("dead@1=true", "dead@2=true", "dead@3=true")
    await asyncio.sleep(0.51)
    start = asyncio.get_running_loop().time()
    task = asyncio.ensure_future(group.make_safe())
    await asyncio.sleep(0.05)
    safe = [at for at, packet in bench.sent if at >= start and packet[7] == 0x83]
    assert safe
    assert safe[0] - start < 0.04
    with pytest.raises(DeviceError, match=r"servo 1 .*servo 2 .*servo 3"):
        await task


@on_bench(Bench, 1, 2, 3, opened=False)
async def test_open_error_names_all_missing_servos(bench, group, /):
    bench.fault("dead@1=true", "dead@3=true")
    with pytest.raises(DeviceError, match=r"servo 1 does not answer.*servo 3 does not answer"):
        await group.open()


@on_bench(Bench, 1, 2)
async def test_group_requires_one_angle_per_member(b, group, /):
    await enable(group)
    with pytest.raises(DeviceError, match="requires 2 angles, one for each id, not 3"):
        await call(group, "moveTo", [0.0, 0.0, 0.0])
    with pytest.raises(DeviceError, match="outside"):
        await call(group, "setPositions", [0.0, math.nan])


@on_bench(Bench, 1, 2, ids=[], opened=False)
async def test_group_without_servos_is_refused(b, group, /):
    with pytest.raises(DeviceError, match="names no servo"):
        await group.open()


def test_servo_of_two_devices_is_refused():
    other = DeviceBinding(
        agent="alpha", field="wrist", type="Dynamixel", driver="dynamixel",
        endpoint="serial:/dev/null:1000000", safe_state="torque_hold",
        options={"id": 2, "protocol": 2, "model": ""},
    )  # fmt: skip
    bench = Bench(1, 2, extra=[other])
    with pytest.raises(DeviceError, match=r"servo 2 on .* already belongs to alpha\.joint"):
        bench.run(lambda group: group.open())


@on_bench(Bench, 1, 2)
async def test_unplugged_port_is_reported_once_and_used_again(bench, group, /):
    await enable(group)
    moving = asyncio.ensure_future(call(group, "moveTo", [1.0, 1.0]))
    await asyncio.sleep(0.2)
    start = asyncio.get_running_loop().time()
    bench.port.unplug()
    with pytest.raises(DeviceError, match="not answer") as error:
        await moving
    assert error.value.kind == "DeviceTimeoutException"
    assert asyncio.get_running_loop().time() - start < 3.0
    await asyncio.sleep(5.0)
    with pytest.raises(DeviceError, match="not answer"):
        await call(group, "moveTo", [0.0, 0.0])
    bench.chain.advance(asyncio.get_running_loop().time())
    stopped_at = [servo.motion.place for servo in bench.servos.values()]
    bench.port.plug()
    await asyncio.sleep(2.0)
    assert bench.values["missing"] == []
    assert [servo.motion.place for servo in bench.servos.values()] == pytest.approx(stopped_at, abs=10)
    assert sum("is gone" in note for note in bench.notes) == 1
    assert sum("stopped by its watchdog" in note for note in bench.notes) == 2
    await call(group, "release")
    await call(group, "moveTo", [0.2, 0.2])


@on_bench(Bench, 1, 2)
async def test_member_that_lost_power_is_configured_again(bench, group, /):
    await enable(group)
    bench.fault("dead@2=true")
    await asyncio.sleep(1.0)
    bench.servos[2].reboot()
    bench.fault("dead@2=false")
    await asyncio.sleep(2.0)
    assert bench.servos[2].table["bus_watchdog"] == 50
    assert "servo 2 responding again: torque off, restarted" in bench.notes
    assert not bench.values["torqueOn"]
