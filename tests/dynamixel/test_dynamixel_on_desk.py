"""Servos in virtual time: the driver is connected to a simulated chain with faults."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from contextlib import closing

import pytest
from coroutine_tests import scenario

from lfield.driver import DeviceError
from lfield.testing.desk import Desk, DeskFake
from lfield.testing.driver_bench import DriverBench, bind
from lfield_dynamixel import PLUGIN


@pytest.fixture
def desk() -> Iterator[Desk]:
    with closing(Desk()) as desk:
        yield desk


@pytest.fixture
def chain(desk: Desk) -> DeskFake:
    servos = ("--servo", "1:XL330-M288", "--servo", "2:XL330-M288", "--servo", "3:XM430-W350")
    return desk.fake("dynamixel", "--baud", "1000000", *servos)


@pytest.fixture
def run(desk, chain):
    """A function that runs the steps of a test with one device of the driver and its bench."""

    def run_steps(steps, *ids: int, safe_state: str = "torque_hold") -> None:
        kind, options = (
            ("DynamixelGroup", {"ids": list(ids)}) if len(ids) > 1 else ("Dynamixel", {"id": ids[0]})
        )
        bound = bind(PLUGIN, kind, endpoint=chain.endpoint, safe_state=safe_state, options=options)
        bench = DriverBench(PLUGIN, bound)
        desk.run(lambda: bench.play(lambda device: steps(device, bench), desk.clock))

    return run_steps


@scenario("run", 1, 2, 3, safe_state="torque_off")
async def test_dead_servo_is_missing_and_the_others_are_safe(group, bench, /, chain):
    await group.execute("torque", [True])
    chain.fault("dead@2=true")
    await bench.until(lambda: bench.values["missing"] == [2])
    assert math.isnan(bench.values["positions"][1])
    with pytest.raises(DeviceError, match="servo 2 does not answer"):
        await group.make_safe()
    chain.fault("dead@2=false")
    await bench.until(lambda: bench.values["missing"] == [])
    await group.make_safe()
    await bench.until(lambda: not bench.values["torqueOn"])


@scenario("run", 1, 2, 3)
async def test_lost_replies_do_not_stop_a_motion(group, bench, /, chain):
    await group.execute("torque", [True])
    await group.execute("setProfile", [2.0, 20.0])
    chain.fault("lose=0.05", "noise=0.05")
    await group.execute("moveTo", [[0.6, 0.6, 0.6]])
    assert bench.values["positions"] == pytest.approx([0.6, 0.6, 0.6], abs=0.03)


@scenario("run", 3)
async def test_unplugged_chain_is_reported_once_and_stopped_by_its_watchdog(servo, bench, /, desk, chain):
    await servo.execute("torque", [True])
    await servo.execute("setProfile", [0.4, 0.0])
    moving = asyncio.ensure_future(servo.execute("moveTo", [1.5]))
    await bench.until(lambda: bench.values["position"] > 0.1)
    start = desk.now
    chain.fault("unplug=true")
    with pytest.raises(DeviceError) as error:
        await moving
    assert error.value.kind == "DeviceTimeoutException"
    assert desk.now - start < 10.0
    # Longer than the time of the watchdog: the servo has stopped when the port is plugged in again.
    await asyncio.sleep(1.5)
    chain.fault("unplug=false")
    await bench.until(lambda: any("responding again" in note for note in bench.notes))
    assert sum("is gone" in note for note in bench.notes) == 1
    assert any("torque on, stopped by its watchdog" in note for note in bench.notes)
    await servo.execute("release", [])
    position = (await servo.servo.present()).position
    assert position < 1.3
    await servo.execute("moveTo", [position])
