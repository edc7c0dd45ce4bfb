"""The public bench for drivers, with the driver that `lfield driver new` writes."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from importlib import import_module

import pytest
from coroutine_tests import on_bench

from lfield.driver import DeviceError
from lfield.driver.kit import CheckFailed
from lfield.driver.skeleton import write
from lfield.errors import DevicesError
from lfield.testing.driver_bench import DriverBench, bind, guarded, running_fake
from lfield_dynamixel import PLUGIN as SERVOS

MINUTE = 60.0


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """The folder of a new driver, which is installed for processes that have the folder in their path."""
    folder = tmp_path_factory.mktemp("project")
    write("lamp", folder)
    info = folder / "lfield_lamp-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lfield-lamp\nVersion: 0.1.0\n")
    (info / "entry_points.txt").write_text(
        "[lfield.drivers.v1]\nlamp = lfield_lamp:PLUGIN\n[lfield.sims.v1]\nlamp = lfield_lamp.fake:SIM\n"
    )
    return folder


@pytest.fixture
def lamp(project, monkeypatch):
    """The module with the tests of the new driver, and its class Fake."""
    monkeypatch.syspath_prepend(str(project))
    monkeypatch.syspath_prepend(str(project / "tests"))
    yield import_module("test_lamp")
    for name in [
        name for name in sys.modules if name.split(".")[0] in ("test_lamp", "memory_wire", "lfield_lamp")
    ]:
        del sys.modules[name]


@pytest.fixture
def fake(lamp):
    return lamp.Fake()


@pytest.fixture
def make_bench(lamp, fake):
    def make(*fields, fakes=(fake.live,), **given):
        bindings = [bind(lamp.PLUGIN, field=field, endpoint=fake.ENDPOINT, **given) for field in fields]
        return DriverBench(lamp.PLUGIN, *bindings, make=fake.driver, fakes=fakes)

    return make


async def nothing(*devices):
    pass


def test_binding_has_the_defaults_of_its_manifest(lamp):
    plain = bind(lamp.PLUGIN)
    assert (plain.name, plain.type, plain.driver, plain.safe_state) == (
        "bench.device",
        "Lamp",
        "lamp",
        "stop",
    )
    assert (plain.ttl, plain.limits, plain.options, plain.waivers) == (0.5, {}, {"connect": 2.0}, [])
    group = bind(SERVOS, "DynamixelGroup", agent="arm", ttl=1.0, options={"ids": [1, 2]})
    assert (group.name, group.type, group.ttl) == ("arm.device", "DynamixelGroup", 1.0)
    assert group.option("ids") == [1, 2]
    assert group.option("tolerance") > 0.0
    with pytest.raises(TypeError, match="speed"):
        bind(lamp.PLUGIN, speed=1.0)


@on_bench("make_bench", "one", "two")
async def test_bench_runs_in_virtual_time(bench, one, two, /):
    start = one.clock.monotonic()
    await asyncio.sleep(MINUTE)
    await two.execute("moveTo", [0.5])
    assert MINUTE < one.clock.monotonic() - start < MINUTE + 1.0
    assert bench.values is bench.reported["bench.one"]
    assert bench.reported["bench.two"]["value"] == pytest.approx(0.5)
    assert bench.crashes == []


@on_bench("make_bench", "device", opened=False)
async def test_devices_may_stay_closed_at_the_start(bench, device, /):
    assert bench.values == {}
    assert await device.open() == "a lamp"


@on_bench("make_bench", "device")
async def test_notes_of_a_driver_are_kept(bench, device, /, fake):
    fake.cut = True
    await bench.until(lambda: bench.notes != [])
    assert bench.notes == ["link lost: tcp:memory:1: no answer"]


def test_until_timeout_reports_the_observed_values(make_bench):
    bench = make_bench("device")

    async def scenario(device):
        await bench.until(lambda: bench.values["value"] > 1.0, 5.0)

    with pytest.raises(
        AssertionError, match=r"did not hold within 5 s: {'bench.device': {'value': 0.0, 'moving': "
    ):
        bench.run(scenario)


def test_failed_background_task_of_a_driver_fails_the_scenario(make_bench):
    bench = make_bench("device")

    async def fail():
        raise ValueError("failed")

    async def scenario(device):
        bench.driver.spawn(fail())
        await asyncio.sleep(1.0)

    with pytest.raises(AssertionError, match=r"failed meanwhile: ValueError\('failed'\)"):
        bench.run(scenario)


def test_failure_of_a_fake_is_added_to_the_error(make_bench, fake):
    async def broken():
        fake.cut = True
        raise ValueError("failed")

    with pytest.raises(DeviceError, match="no answer") as error:
        make_bench("device", fakes=(broken,)).run(nothing)
    assert error.value.__notes__ == ["meanwhile: the simulated device: ValueError('failed')"]


def test_scenario_that_exceeds_its_time_is_cancelled(make_bench):
    async def scenario(device):
        await asyncio.sleep(MINUTE)

    with pytest.raises(TimeoutError):
        make_bench("device").run(scenario, within=10.0)


def test_bench_ends_tasks_and_closes_the_driver(make_bench, fake):
    ended = []

    async def live_fake():
        try:
            await fake.live()
        finally:
            ended.append("fake")

    fake.close = lambda: ended.append("wire")
    make_bench("device", fakes=(live_fake,)).run(nothing)
    assert sorted(ended) == ["fake", "wire"]


@pytest.mark.process
def test_fake_process_with_device_in_real_time_and_behind_a_guard():
    with running_fake("dynamixel", "--servo", "1:XL330-M288:arm.wrist") as fake:
        binding = bind(SERVOS, "Dynamixel", agent="arm", field="wrist", endpoint=fake.endpoint)
        bench = DriverBench(SERVOS, binding)
        assert "XL330-M288" in bench.run_real(lambda wrist: wrist.open(), opened=False)

        async def scenario():
            async with guarded(binding) as (wrist,):
                assert await wrist.reads("torqueOn", lambda on: on is False) is False
                assert fake.fault("hot@arm.wrist=true")["devices"] == {"1": "arm.wrist"}
                with pytest.raises(CheckFailed, match=r"waited 0\.1 s for the note 'no such note'"):
                    await wrist.until_note("no such note", 0.1)
                assert wrist.guard_pid > 0

        asyncio.run(scenario())
        with pytest.raises(AssertionError, match="no device 'leg'"):
            fake.fault("hot@leg=true")
    assert fake.process.returncode == 0


@pytest.mark.process
def test_fake_or_device_that_fails_to_start_reports_the_reason(capfd):
    text = "the simulated device 'dynamixel' did not start"
    with pytest.raises(AssertionError, match=text), running_fake("dynamixel", "--servo", "1:XM999"):
        pass
    assert "there is no simulation of the servo 'XM999'" in capfd.readouterr().err

    async def scenario():
        async with guarded(bind(SERVOS, "Dynamixel", endpoint="serial:/dev/nothing-there:57600")):
            pass

    with pytest.raises(DevicesError, match="cannot open serial:/dev/nothing-there"):
        asyncio.run(scenario())


@pytest.mark.few(0)
@pytest.mark.process
def test_tests_of_a_new_driver_pass(project):
    path = os.pathsep.join([str(project), os.environ.get("PYTHONPATH", "")])
    tests = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=project, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
    )  # fmt: skip
    assert "5 passed" in tests.stdout, tests.stdout
