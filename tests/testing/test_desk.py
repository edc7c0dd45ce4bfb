"""A desk in virtual time: connected fakes, drivers behind guards, and their faults."""

from __future__ import annotations

import socket
from contextlib import closing

import pytest

from lfield.driver.kit import Check
from lfield.errors import DeviceError, DevicesError, MissionTestError, PluginError, RealEndpoint, Stuck
from lfield.testing.desk import Desk
from lfield.testing.driver_bench import bind
from lfield_dynamixel import PLUGIN

SERVO = ("--baud", "1000000", "--servo", "1:XM430-W350")


@pytest.fixture
def desk():
    with closing(Desk()) as desk:
        yield desk


@pytest.fixture
def fake(desk):
    return desk.fake("dynamixel", *SERVO)


@pytest.fixture
def servo(fake):
    return bind(PLUGIN, "Dynamixel", endpoint=fake.endpoint, options={"id": 1})


async def moves(servo):
    await servo.call("setProfile", 1.0, 5.0)
    await servo.call("torque", True)
    await servo.call("moveTo", servo.query("position") + 1.0)
    return servo.now


def test_a_scenario_has_guarded_devices_and_returns_its_result(desk, servo):
    started = desk.clock.monotonic()
    ended = desk.run(moves, servo)
    assert 1.0 < ended - started < 3.0
    assert 1.0 < desk.now < 5.0


def test_the_same_seed_gives_the_same_scenario():
    def ends(seed):
        desk = Desk(seed=seed)
        endpoint = desk.fake("dynamixel", *SERVO).endpoint
        desk.run(moves, bind(PLUGIN, "Dynamixel", endpoint=endpoint, options={"id": 1}))
        return desk.now

    assert ends(1) == ends(1)
    clocks = {Desk(seed=seed).clock.monotonic() for seed in (1, 1, 2)}
    assert len(clocks) == 2


@pytest.mark.few(0)
def test_faults_are_set_in_a_scenario_and_at_a_time(desk, fake, servo):
    async def scenario(servo):
        await servo.call("torque", True)
        fake.fault("stuck=true")
        with pytest.raises(DeviceError, match="an obstacle blocks it"):
            await servo.call("moveTo", servo.query("position") + 1.0)
        desk.at(desk.now + 5.0, lambda: fake.fault("stuck=false", "dead=true"))
        return await servo.reads("age", lambda age: age > 3.0)

    assert desk.run(scenario, servo) > 3.0
    assert fake.facts("1")["torque"] in (True, False)


def test_an_exception_and_a_timeout_of_a_scenario_are_raised(desk, servo):
    async def wrong(servo):
        return servo.query("wings")

    with pytest.raises(DeviceError, match="wings"):
        desk.run(wrong, servo)

    async def waits(servo):
        await servo.reads("position", lambda angle: angle > 1e9, 1e6)

    with pytest.raises(Stuck, match="the scenario has not ended after 30 s of virtual time"):
        desk.run(waits, servo, within=30.0)
    # The guard has ended with the host, and the next guard finds the port free.
    assert desk.run(moves, servo) > 0.0


def test_a_missing_device_is_reported_as_by_lfield_kit(desk, servo):
    unused = bind(PLUGIN, "Dynamixel", endpoint="serial:/dev/none:57600", options={"id": 1})
    with pytest.raises(DevicesError, match="No such file or directory"):
        desk.try_kit(unused)


def test_two_fakes_cannot_have_one_port(desk, fake):
    with pytest.raises(MissionTestError, match="dynamixel-2: cannot use /dev/ttyDXL: File exists"):
        desk.fake("dynamixel", *SERVO)
    other = desk.fake("dynamixel", *SERVO, "--listen", "/dev/other")
    assert (fake.endpoint, other.endpoint) == ("serial:/dev/ttyDXL:1000000", "serial:/dev/other:1000000")


def test_a_kit_runs_its_silences_and_dead_guards_on_virtual_time(desk, servo):
    found = {finding.check: finding for finding in desk.try_kit(servo)}
    unlimited = "a profile above its speed limit is refused"
    assert [check for check, finding in found.items() if finding.outcome != "passed"] == [unlimited]
    assert "because its guard died" in found["the safe state follows the death of a guard"].seen
    assert found["its own watchdog"].outcome == "passed"
    assert len(found) == 21


@pytest.mark.few(0)
def test_a_device_left_unsafe_is_reported(desk, fake, servo):
    async def act(bench):
        await bench.call("torque", True)
        fake.fault("dead=true")
        return "dead now"

    (done, left) = desk.try_kit(servo, checks=[Check("dies", act, moves=False)])
    assert done.outcome == "passed"
    assert (left.check, left.outcome) == ("left safe and at rest", "failed")


@pytest.mark.parametrize(
    ("sim", "options", "error", "words"),
    [
        ("pigeon", (), PluginError, r"there is no simulated device 'pigeon' \(installed: can, dynamixel"),
        ("dynamixel", ("--wings", "2"), MissionTestError, "unrecognized arguments: --wings 2"),
        (
            "dynamixel",
            ("--servo", "1:XM999"),
            MissionTestError,
            "there is no simulation of the servo 'XM999'",
        ),
        ("can", ("--fault", "wings=2"), MissionTestError, "there is no fault 'wings'"),
    ],
)
def test_a_fake_that_does_not_start_is_reported_with_the_reason(desk, sim, options, error, words):
    with pytest.raises(error, match=words):
        desk.fake(sim, *options)


def test_an_unknown_fault_is_refused_where_it_is_set(desk, fake, servo):
    with pytest.raises(MissionTestError, match="the simulated device 'dynamixel': there is no fault 'wings'"):
        fake.fault("wings=true")

    async def scenario(servo):
        with pytest.raises(MissionTestError, match="there is no device '9'"):
            fake.fault("stuck@9=true")

    desk.run(scenario, servo)


def test_a_fake_without_serve_and_a_failing_fake_are_reported(desk):
    class Old:
        name, help = "old", "it has its own loop"

        def add_arguments(self, parser):
            pass

        def arguments(self, devices):
            return []

        def run(self, args):
            return 0

    with pytest.raises(
        PluginError, match="simulated device 'old' cannot run on virtual time: it has no `serve`"
    ):
        desk.fake(Old())

    class Broken(Old):
        async def serve(self, args):
            raise ZeroDivisionError("a bug")

    with pytest.raises(
        MissionTestError, match="the simulated device of old-1 has failed: ZeroDivisionError: a bug"
    ):
        desk.fake(Broken())


def test_a_real_endpoint_is_refused(desk):
    async def scenario():
        with socket.socket() as listener:
            listener.connect(("127.0.0.1", 9))

    with pytest.raises(RealEndpoint, match="it tried to connect"):
        desk.run(scenario)


def test_a_closed_desk_frees_its_simulated_devices(desk, fake, servo):
    desk.run(moves, servo)
    machines = [desk._computer.machine, *(device.computer.machine for device in desk._fakes)]
    assert any(machine.pinned for machine in machines)
    desk.close()
    assert not any(machine.pinned for machine in machines)
