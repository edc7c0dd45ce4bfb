"""The driver and the fake as they are: a process at the other end of a pseudo-terminal, in real time."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator

import pytest

from lfield.clock import SystemClock
from lfield.driver import DeviceBinding, DeviceError
from lfield.testing.driver_bench import DriverBench, RunningFake, bind, running_fake
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.driver import DynamixelDriver

pytestmark = pytest.mark.process


def binding(endpoint: str, *ids: int, safe_state: str = "torque_hold") -> DeviceBinding:
    kind, options = ("DynamixelGroup", {"ids": list(ids)}) if len(ids) > 1 else ("Dynamixel", {"id": ids[0]})
    return bind(PLUGIN, kind, endpoint=endpoint, safe_state=safe_state, options=options)


def run(bound: DeviceBinding, story) -> None:
    """A story with one device of the driver and its bench, in real time."""
    bench = DriverBench(PLUGIN, bound)
    bench.run_real(lambda device: story(device, bench))


@pytest.fixture
def chain() -> Iterator[RunningFake]:
    servos = ("--servo", "1:XL330-M288", "--servo", "2:XL330-M288", "--servo", "3:XM430-W350")
    with running_fake("dynamixel", "--baud", "1000000", *servos) as fake:
        yield fake


def test_a_group_moves_and_arrives(chain):
    async def story(group, bench):
        await group.execute("torque", [True])
        await group.execute("setProfile", [3.0, 20.0])
        await group.execute("moveTo", [[0.5, -0.4, 0.2]])
        assert bench.values["positions"] == pytest.approx([0.5, -0.4, 0.2], abs=0.03)
        assert bench.values["missing"] == []

    run(binding(chain.endpoint, 1, 2, 3), story)


def test_a_dead_servo_is_missing_and_the_others_are_safe(chain):
    async def story(group, bench):
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

    run(binding(chain.endpoint, 1, 2, 3, safe_state="torque_off"), story)


def test_lost_replies_do_not_stop_a_travel(chain):
    async def story(group, bench):
        await group.execute("torque", [True])
        await group.execute("setProfile", [2.0, 20.0])
        chain.fault("lose=0.05", "noise=0.05")
        await group.execute("moveTo", [[0.6, 0.6, 0.6]])
        assert bench.values["positions"] == pytest.approx([0.6, 0.6, 0.6], abs=0.03)

    run(binding(chain.endpoint, 1, 2, 3), story)


def test_a_pulled_plug_is_told_once_and_it_comes_back_still(chain):
    async def story(servo, bench):
        await servo.execute("torque", [True])
        await servo.execute("setProfile", [0.4, 0.0])
        moving = asyncio.ensure_future(servo.execute("moveTo", [1.5]))
        await bench.until(lambda: bench.values["position"] > 0.1)
        start = time.monotonic()
        chain.fault("unplug=true")
        with pytest.raises(DeviceError) as caught:
            await moving
        assert caught.value.kind == "DeviceTimeoutException"
        assert time.monotonic() - start < 10.0
        # Longer than its watchdog: the servo has stopped by itself when the plug is back.
        await asyncio.sleep(1.5)
        chain.fault("unplug=false")
        await bench.until(lambda: any("answers again" in note for note in bench.notes))
        assert sum("is gone" in note for note in bench.notes) == 1
        assert any("torque on, stopped by its watchdog" in note for note in bench.notes)
        await servo.execute("release", [])
        place = (await servo.servo.present()).position
        assert place < 1.3
        await servo.execute("moveTo", [place])

    run(binding(chain.endpoint, 3), story)


def test_overload_is_told_in_words(chain):
    async def story(servo, bench):
        await servo.execute("torque", [True])
        chain.fault("overload@1=true")
        with pytest.raises(DeviceError):
            await servo.execute("moveTo", [1.0])
        await bench.until(lambda: "overload" in bench.values["fault"])
        chain.fault("overload@1=false")
        await servo.execute("reboot", [])
        assert bench.values["fault"] == ""

    run(binding(chain.endpoint, 1), story)


def test_a_silent_owner_lets_the_watchdog_stop_the_servo(chain):
    async def story(servo, bench):
        await servo.execute("torque", [True])
        bench.driver.quiet()
        await asyncio.sleep(1.3)
        bench.driver.resume()
        await bench.until(lambda: any("stopped by its own watchdog" in note for note in bench.notes))
        await servo.execute("release", [])
        await servo.execute("moveTo", [0.2])

    run(binding(chain.endpoint, 1), story)


def test_two_drivers_for_one_port(chain):
    async def story(servo, bench):
        bound = binding(chain.endpoint, 2)
        rival = DynamixelDriver([bound], PLUGIN.read_manifests(), SystemClock(), DriverBench(PLUGIN, bound))
        with pytest.raises(DeviceError, match="is in use by another program"):
            await rival.open()
        await rival.close()

    run(binding(chain.endpoint, 1), story)


@pytest.mark.parametrize(
    ("endpoint", "match"),
    [
        ("serial:/dev/nothing-there:57600", "cannot open serial:/dev/nothing-there:57600: No such file"),
        ("serial:/dev/null:fast", "is not an endpoint; write serial:PATH:BAUD"),
        ("tcp:localhost:1", "is not an endpoint"),
    ],
)
def test_an_endpoint_that_is_none(endpoint, match):
    with pytest.raises(DeviceError, match=match):
        run(binding(endpoint, 1), None)
