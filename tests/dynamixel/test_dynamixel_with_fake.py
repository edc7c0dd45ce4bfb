"""The driver and the fake as they are: a process at the other end of a pseudo-terminal, in real time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

from lfield.clock import SystemClock
from lfield.driver import DeviceBinding
from lfield.driver.sims import control_folder
from lfield.errors import DeviceError
from lfield.testing.reports import KeptReports
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.driver import DynamixelDriver

pytestmark = pytest.mark.process

MANIFESTS = PLUGIN.read_manifests()


class Fake:
    """A running fake chain."""

    def __init__(self, process: subprocess.Popen[str], endpoint: str) -> None:
        self.process, self.endpoint = process, endpoint

    def fault(self, *texts: str) -> None:
        """Set faults while it runs."""
        with socket.socket(socket.AF_UNIX) as door:
            door.connect(str(control_folder() / f"dynamixel-{self.process.pid}.sock"))
            door.sendall(json.dumps({"set": list(texts)}).encode() + b"\n")
            answer = json.loads(door.makefile().readline())
        assert "error" not in answer, answer


@contextlib.contextmanager
def fake_chain(*servos: str) -> Iterator[Fake]:
    options = [part for servo in servos for part in ("--servo", servo)]
    command = [sys.executable, "-m", "lfield.driver.sims", "lfield_sim.dynamixel:SIM", "--until-stdin-closes"]
    process = subprocess.Popen(
        [*command, "--baud", "1000000", *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        ready = process.stdout.readline().split()
        assert ready[0] == "ready"
        yield Fake(process, ready[1])
    finally:
        process.communicate(timeout=10)


class Seen(KeptReports):
    """What a driver reports."""

    async def until(self, condition, bound: float = 10.0) -> None:
        """Look again and again; a condition that never holds fails the test."""
        deadline = time.monotonic() + bound
        while not condition():
            assert time.monotonic() < deadline, (self.values, self.notes)
            await asyncio.sleep(0.01)


def binding(endpoint: str, *ids: int, safe_state: str = "torque_hold", **options: Any) -> DeviceBinding:
    kind = "DynamixelGroup" if len(ids) > 1 else "Dynamixel"
    given: dict[str, Any] = {o.name: o.default for o in MANIFESTS[kind].options}
    given |= {"ids": list(ids)} if len(ids) > 1 else {"id": ids[0]}
    return DeviceBinding(
        agent="arm", field="joints", type=kind, driver="dynamixel", endpoint=endpoint,
        safe_state=safe_state, options={**given, **options},
    )  # fmt: skip


def run(bound: DeviceBinding, story) -> None:
    """A story with one device of the driver, in real time."""
    seen = Seen()

    async def main() -> None:
        driver = DynamixelDriver([bound], MANIFESTS, SystemClock(), seen)
        try:
            await driver.open()
            device = driver.devices["arm.joints"]
            await device.open()
            await story(device, driver, seen)
        finally:
            await driver.close()

    asyncio.run(asyncio.wait_for(main(), 60.0))
    assert seen.crashes == []


@pytest.fixture
def chain() -> Iterator[Fake]:
    with fake_chain("1:XL330-M288", "2:XL330-M288", "3:XM430-W350") as fake:
        yield fake


def test_a_group_moves_and_arrives(chain):
    async def story(group, driver, seen):
        await group.execute("torque", [True])
        await group.execute("setProfile", [3.0, 20.0])
        await group.execute("moveTo", [[0.5, -0.4, 0.2]])
        assert seen.values["positions"] == pytest.approx([0.5, -0.4, 0.2], abs=0.03)
        assert seen.values["missing"] == []

    run(binding(chain.endpoint, 1, 2, 3), story)


def test_a_dead_servo_is_missing_and_the_others_are_safe(chain):
    async def story(group, driver, seen):
        await group.execute("torque", [True])
        chain.fault("dead@2=true")
        await seen.until(lambda: seen.values["missing"] == [2])
        assert math.isnan(seen.values["positions"][1])
        with pytest.raises(DeviceError, match="servo 2 does not answer"):
            await group.make_safe()
        chain.fault("dead@2=false")
        await seen.until(lambda: seen.values["missing"] == [])
        await group.make_safe()
        await seen.until(lambda: not seen.values["torqueOn"])

    run(binding(chain.endpoint, 1, 2, 3, safe_state="torque_off"), story)


def test_lost_replies_do_not_stop_a_travel(chain):
    async def story(group, driver, seen):
        await group.execute("torque", [True])
        await group.execute("setProfile", [2.0, 20.0])
        chain.fault("lose=0.05", "noise=0.05")
        await group.execute("moveTo", [[0.6, 0.6, 0.6]])
        assert seen.values["positions"] == pytest.approx([0.6, 0.6, 0.6], abs=0.03)

    run(binding(chain.endpoint, 1, 2, 3), story)


def test_a_pulled_plug_is_told_once_and_it_comes_back_still(chain):
    async def story(servo, driver, seen):
        await servo.execute("torque", [True])
        await servo.execute("setProfile", [0.4, 0.0])
        moving = asyncio.ensure_future(servo.execute("moveTo", [1.5]))
        await seen.until(lambda: seen.values["position"] > 0.1)
        start = time.monotonic()
        chain.fault("unplug=true")
        with pytest.raises(DeviceError) as caught:
            await moving
        assert caught.value.kind == "DeviceTimeoutException"
        assert time.monotonic() - start < 3.0
        # Longer than its watchdog: the servo has stopped by itself when the plug is back.
        await asyncio.sleep(1.5)
        chain.fault("unplug=false")
        await seen.until(lambda: any("answers again" in note for note in seen.notes))
        assert sum("is gone" in note for note in seen.notes) == 1
        assert any("torque on, stopped by its watchdog" in note for note in seen.notes)
        await servo.execute("release", [])
        place = (await servo.servo.present()).position
        assert place < 1.3
        await servo.execute("moveTo", [place])

    run(binding(chain.endpoint, 3), story)


def test_overload_is_told_in_words(chain):
    async def story(servo, driver, seen):
        await servo.execute("torque", [True])
        chain.fault("overload@1=true")
        with pytest.raises(DeviceError):
            await servo.execute("moveTo", [1.0])
        await seen.until(lambda: "overload" in seen.values["fault"])
        chain.fault("overload@1=false")
        await servo.execute("reboot", [])
        assert seen.values["fault"] == ""

    run(binding(chain.endpoint, 1), story)


def test_a_silent_owner_lets_the_watchdog_stop_the_servo(chain):
    async def story(servo, driver, seen):
        await servo.execute("torque", [True])
        driver.quiet()
        await asyncio.sleep(1.3)
        driver.resume()
        await seen.until(lambda: any("stopped by its own watchdog" in note for note in seen.notes))
        await servo.execute("release", [])
        await servo.execute("moveTo", [0.2])

    run(binding(chain.endpoint, 1), story)


def test_two_drivers_for_one_port(chain):
    async def story(servo, driver, seen):
        rival = DynamixelDriver([binding(chain.endpoint, 2)], MANIFESTS, SystemClock(), Seen())
        with pytest.raises(DeviceError, match="another program has it open"):
            await rival.open()
        await rival.close()

    run(binding(chain.endpoint, 1), story)


@pytest.mark.parametrize(
    ("endpoint", "match"),
    [
        ("serial:/dev/nothing-there:57600", "cannot open /dev/nothing-there: No such file"),
        ("serial:/dev/null:fast", "is not an endpoint; write serial:PATH:BAUD"),
        ("tcp:localhost:1", "is not an endpoint"),
    ],
)
def test_an_endpoint_that_is_none(endpoint, match):
    with pytest.raises(DeviceError, match=match):
        run(binding(endpoint, 1), None)
