"""A driver that `lfield driver new` writes compiles and passes the conformance checks on its own fake."""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from lfield.driver import DeviceError
from lfield.driver.plugin import load_plugin
from lfield.driver.plugins import Plugins
from lfield.driver.sims import load_sim
from lfield.driver.skeleton import write
from lfield.lang.frontend import check_text
from lfield.testing.desk import Desk
from lfield.testing.driver_bench import DriverBench, bind

pytestmark = pytest.mark.process

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder for PYTHONPATH with the new driver, installed as pip would have it."""
    folder = tmp_path_factory.mktemp("site")
    new = subprocess.run(
        [sys.executable, "-m", "lfield.cli.main", "driver", "new", "lamp", "--into", str(folder / "project")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "lfield_lamp/L/mover.L" in new.stdout
    (folder / "project" / "lfield_lamp").rename(folder / "lfield_lamp")
    install("lamp", folder)
    return folder


def install(name, folder):
    """Install the driver as pip does."""
    info = folder / f"lfield_{name}-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: lfield-{name}\nVersion: 0.1.0\n")
    (info / "entry_points.txt").write_text(
        f"[lfield.drivers.v1]\n{name} = lfield_{name}:PLUGIN\n"
        f"[lfield.sims.v1]\n{name} = lfield_{name}.fake:SIM\n"
    )


@pytest.fixture(scope="module")
def sensor_site(tmp_path_factory):
    """The same with a driver for a pure sensor."""
    folder = tmp_path_factory.mktemp("sensor")
    assert folder / "tests" / "test_eye.py" in write("eye", folder, sensor=True)
    install("eye", folder)
    return folder


def lfield(site, *arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "lfield.cli.main", *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options,
    )  # fmt: skip


@pytest.fixture
def endpoint(site):
    fake = lfield(
        site, "sim", "lamp", "--listen", "tcp:127.0.0.1:0", "--until-stdin-closes", stdin=subprocess.PIPE
    )
    yield fake.stdout.readline().split()[1]
    fake.stdin.close()
    assert fake.wait(60) == 0
    fake.stdout.close()


@pytest.mark.few(0)
def test_a_new_driver_passes_the_kit_on_its_own_fake(site, endpoint):
    kit = lfield(site, "kit", "lamp", "--endpoint", endpoint, "--yes", "--silence", "2")
    output, _ = kit.communicate()
    assert kit.returncode == 0, output
    assert "13 passed, 0 failed, 0 not run" in output


def test_the_kit_detects_a_fault_of_a_new_driver(site, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    plugins = Plugins()
    plugins.add("lfield_lamp:PLUGIN")
    desk = Desk(plugins=plugins)
    fake = desk.fake(load_sim("lfield_lamp.fake:SIM"), "--fault", "stuck=true")
    found = desk.try_kit(bind(load_plugin("lfield_lamp:PLUGIN"), endpoint=fake.endpoint, ttl=0.2))
    (failed,) = (finding for finding in found if finding.outcome == "failed")
    assert failed.check == "moves and reports its position"
    assert "was not done within 10 s: at 0" in failed.seen


@pytest.mark.few(0)
def test_a_failed_check_sets_the_exit_status(site, endpoint):
    fault = lfield(site, "sim", "fault", endpoint, "stuck=true")
    assert "stuck = true" in fault.communicate()[0]
    # The distance is below the minimum of the check, which is refused immediately.
    short = ("--set", "ttl=0.2", "--set", "limits={value: 0.05}")
    kit = lfield(site, "kit", "lamp", "--endpoint", endpoint, "--yes", *short, "--silence", "0.5")
    output, _ = kit.communicate()
    assert kit.returncode == 1, output
    assert "FAILED  kit.device: moves and reports its position" in output


@pytest.mark.few(0)
def test_without_consent_nothing_moves(site, endpoint):
    kit = lfield(site, "kit", "lamp", "--endpoint", endpoint, "--silence", "2", stdin=subprocess.DEVNULL)
    output, _ = kit.communicate()
    assert kit.returncode == 0, output
    assert "4 passed, 0 failed, 9 not run" in output


def errors(plugins, program):
    """The errors of a program, by the compiler with these drivers."""
    return check_text(program, devices=plugins.device_types, find_include=plugins.find_source).errors


def test_the_stock_resource_of_a_new_driver_compiles(site, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    plugins = Plugins()
    plugins.add("lfield_lamp:PLUGIN")
    assert load_plugin("lfield_lamp:PLUGIN").read_manifests()
    assert not errors(
        plugins,
        "include <lamp/mover.L>;\n"
        'coordinator C { init(string[] arg) { LampMover m = findLampMover("m"); m.moveTo(1.0); } }',
    )


@pytest.mark.few(0)
def test_a_sensor_passes_its_tests_and_the_kit_without_consent(sensor_site, monkeypatch):
    monkeypatch.syspath_prepend(str(sensor_site))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(sensor_site), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "tests"]
    tests = subprocess.run(command, cwd=sensor_site, capture_output=True, text=True)
    assert "4 passed" in tests.stdout, tests.stdout
    plugins = Plugins()
    plugins.add("lfield_eye:PLUGIN")
    desk = Desk(plugins=plugins)
    fake = desk.fake(load_sim("lfield_eye.fake:SIM"))
    binding = bind(load_plugin("lfield_eye:PLUGIN"), endpoint=fake.endpoint)
    found = desk.try_kit(binding, may_move=False)
    assert [f"{f.check}: {f.seen}" for f in found if f.outcome == "failed"] == []
    assert {f.check for f in found if f.outcome == "not run"} == {
        "the safe state is latched until release", "it comes to rest in its safe state",
    }  # fmt: skip
    assert not errors(
        plugins,
        "include <eye/meter.L>;\n"
        'coordinator C { init(string[] arg) { EyeMeter m = findEyeMeter("m"); print(m.value()); } }',
    )


@pytest.fixture
def serial_site(tmp_path, monkeypatch):
    """A driver for a serial port, written and importable."""
    write("bell", tmp_path, serial=True)
    install("bell", tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("lfield_bell")]:
        del sys.modules[name]


@pytest.mark.few(0)
def test_a_serial_driver_passes_its_own_tests_and_type_checks(serial_site):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "tests"]
    tests = subprocess.run(command, cwd=serial_site, capture_output=True, text=True)
    assert "5 passed" in tests.stdout, tests.stdout
    types = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "lfield_bell"],
        cwd=serial_site, capture_output=True, text=True,
    )  # fmt: skip
    assert types.returncode == 0, types.stdout
    project = tomllib.loads((serial_site / "pyproject.toml").read_text())
    assert project["project"]["dependencies"] == ["lfield[serial]"]
    plugin = load_plugin("lfield_bell:PLUGIN")
    assert (plugin.requires, plugin.endpoint) == (("serial",), "lfield.driver.serial:parse_serial_endpoint")


def test_a_serial_driver_moves_its_fake_on_a_pseudo_terminal(serial_site):
    """The test uses real time and the kernel's tty and lock."""
    fake, path = importlib.import_module("lfield_bell.fake"), serial_site / "tty"
    parser = argparse.ArgumentParser()
    fake.SIM.add_arguments(parser)
    args = parser.parse_args(["--listen", str(path)])
    bench = DriverBench(
        load_plugin("lfield_bell:PLUGIN"),
        bind(load_plugin("lfield_bell:PLUGIN"), endpoint=f"serial:{path}:115200", limits={"value": 1.0}),
        fakes=[lambda: fake.SIM.serve(args)],
    )

    async def scenario(device):
        await device.execute("moveTo", [0.05])
        assert bench.values["value"] == pytest.approx(0.05)
        with pytest.raises(DeviceError, match="is beyond the limit of 1"):
            await device.execute("setTarget", [1.1])
        await device.execute("setTarget", [1.0])
        await bench.until(lambda: bench.values["moving"])
        await device.make_safe()
        assert (device.moving(), bench.values["value"] < 1.0) == ("", True)

    bench.run_real(scenario)


def test_a_serial_sensor_is_written(tmp_path):
    written = write("eye", tmp_path, sensor=True, serial=True)
    assert tmp_path / "lfield_eye" / "L" / "meter.L" in written
    assert "SerialLine" in (tmp_path / "lfield_eye" / "driver.py").read_text()
    assert "status" in (tmp_path / "lfield_eye" / "model.py").read_text()


def test_existing_files_are_not_overwritten(site, tmp_path):
    (tmp_path / "mine").mkdir()
    again = lfield(site, "driver", "new", "torch", "--into", str(tmp_path / "mine"))
    assert "exists already; nothing was written" in again.communicate()[0]
    assert again.returncode == 64
