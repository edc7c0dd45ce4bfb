"""The driver and a process of the fake, connected by a pseudo-terminal, in real time.

The tests in test_dynamixel_on_desk.py run in virtual time, without a process and a terminal.
"""

from __future__ import annotations

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


def run(bound: DeviceBinding, scenario) -> None:
    bench = DriverBench(PLUGIN, bound)
    bench.run_real(lambda device: scenario(device, bench))


@pytest.fixture
def chain() -> Iterator[RunningFake]:
    servos = ("--servo", "1:XL330-M288", "--servo", "2:XL330-M288", "--servo", "3:XM430-W350")
    with running_fake("dynamixel", "--baud", "1000000", *servos) as fake:
        yield fake


def test_group_reaches_its_goal_in_real_time(chain):
    async def scenario(group, bench):
        await group.execute("torque", [True])
        await group.execute("setProfile", [3.0, 20.0])
        await group.execute("moveTo", [[0.5, -0.4, 0.2]])
        assert bench.values["positions"] == pytest.approx([0.5, -0.4, 0.2], abs=0.03)
        assert bench.values["missing"] == []

    run(binding(chain.endpoint, 1, 2, 3), scenario)


def test_second_driver_on_one_port_is_refused(chain):
    async def scenario(servo, bench):
        bound = binding(chain.endpoint, 2)
        second = DynamixelDriver([bound], PLUGIN.read_manifests(), SystemClock(), DriverBench(PLUGIN, bound))
        with pytest.raises(DeviceError, match="is in use by another program"):
            await second.open()
        await second.close()

    run(binding(chain.endpoint, 1), scenario)


@pytest.mark.parametrize(
    ("endpoint", "match"),
    [
        ("serial:/dev/nothing-there:57600", "cannot open serial:/dev/nothing-there:57600: No such file"),
        ("serial:/dev/null:fast", "is not a serial endpoint; write serial:PATH:BAUD"),
        ("tcp:localhost:1", "is not a serial endpoint"),
    ],
)
def test_invalid_servo_endpoint_is_refused(endpoint, match):
    with pytest.raises(DeviceError, match=match):
        run(binding(endpoint, 1), None)
