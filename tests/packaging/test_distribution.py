"""The wheel and the editable install: their contents, and a run of each."""

from __future__ import annotations

import email
import os
import subprocess
import sys
import zipfile
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import pytest

from lfield.driver.plugins import discover
from lfield.driver.sims import discover_sims

pytestmark = pytest.mark.process

ROOT = Path(__file__).parents[2]
PROGRAM = 'coordinator Hello { init(string[] arg) { print("hello " + arg[0]); } }\n'


def run(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
        **options,
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of this checkout, built as a user's pip would; isolated if hatchling is missing."""
    folder = tmp_path_factory.mktemp("wheel")
    isolation = ["--no-build-isolation"] if find_spec("hatchling") else []
    built = run("-m", "pip", "wheel", "--quiet", "--no-deps", *isolation, "-w", folder, ROOT, cwd=folder)
    assert built.returncode == 0, built.stderr
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> dict[str, str]:
    """The environment of a Python that imports the wheel before any other lfield."""
    folder = tmp_path_factory.mktemp("installed")
    done = run("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", folder, wheel)
    assert done.returncode == 0, done.stderr
    return {**os.environ, "PYTHONPATH": str(folder)}


def test_wheel_contains_the_packages_and_their_data(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "lfield/py.typed",
        "lfield/cli/main.py",
        "lfield/driver/skeleton/manifest.yaml.in",
        "lfield/driver/skeleton/sensor/manifest.yaml.in",
        "lfield_can/axis.yaml",
        "lfield_can/drone_can/servo.yaml",
        "lfield_can/L/winch.L",
        "lfield_dynamixel/servo.yaml",
        "lfield_mavlink/__init__.py",
        "lfield_mavlink/manifest.yaml",
        "lfield_sim/__init__.py",
        "lfield_sim/mavlink/__init__.py",
    } <= names
    tops = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert tops == {"lfield", "lfield_can", "lfield_dynamixel", "lfield_mavlink", "lfield_sim"}
    assert not [name for name in names if "__pycache__" in name or "/tests/" in name]


def test_wheel_contains_no_developer_tool_and_no_page(wheel):
    """Scenarios, invariants, fault injection, the fuzzer and the pages are in the clone only."""
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {name for name in names if name.startswith("lfield/simulate/") and "/computers/" not in name} == {
        f"lfield/simulate/{name}.py"
        for name in ("__init__", "hardware", "host_fleet", "journal_disk", "jumping_loop")
    }
    tools = {"docs", "fuzz", "engine_fuzzer", "simulation_testing", "invariants", "scenarios"}
    assert [name for name in names if tools & set(name.split("/"))] == []


def test_wheel_contains_every_file_of_the_packages(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for base in (ROOT / "lfield", *(ROOT / "drivers").glob("lfield_*"), ROOT / "sim-adapters/lfield_sim"):
        for path in base.rglob("*"):
            if path.is_relative_to(ROOT / "lfield/docs"):
                continue
            if path.suffix in (".py", ".yaml", ".typed", ".in", ".L", ".toml", ".dbc", ".js", ".css", ".svg"):
                assert f"{base.name}/{path.relative_to(base).as_posix()}" in names


def _metadata(wheel: Path, name: str) -> str:
    archive = zipfile.ZipFile(wheel)
    (found,) = [n for n in archive.namelist() if n.endswith(f".dist-info/{name}")]
    return archive.read(found).decode()


def test_metadata_names_licence_extras_and_entry_points(wheel):
    metadata = email.message_from_string(_metadata(wheel, "METADATA"))
    assert metadata["Name"] == "lfield"
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Requires-Python"] == ">=3.11"
    assert {"mavlink", "can", "dynamixel", "fast", "watch", "all", "test", "bench"} <= set(
        metadata.get_all("Provides-Extra")
    )
    needed = metadata.get_all("Requires-Dist")
    core = [requirement for requirement in needed if "extra ==" not in requirement]
    assert sorted(word.split(">")[0].strip() for word in core) == [
        "cryptography",
        "msgspec",
        "platformdirs",
        "pyyaml",
        "rich",
    ]
    assert any(word.startswith("pymavlink") and "'mavlink'" in word for word in needed)
    assert "Apache License" in _metadata(wheel, "licenses/LICENSE")
    points = _metadata(wheel, "entry_points.txt")
    assert "lfield = lfield.__main__:main" in points
    for name in ("can", "dynamixel", "mavlink"):
        assert f"{name} = lfield_{name}:PLUGIN" in points
        assert f"{name} = lfield_sim.{name}:SIM" in points


@pytest.mark.few(0)
def test_installed_wheel_runs(installed, tmp_path):
    (tmp_path / "hello.L").write_text(PROGRAM)
    (tmp_path / "hello.dL").write_text("//Hello:tom@alpha\n")

    def lfield(*arguments):
        return run("-P", "-m", "lfield", *arguments, env=installed, cwd=tmp_path)

    where = run("-P", "-c", "import lfield; print(lfield.__file__)", env=installed, cwd=tmp_path)
    assert where.stdout.startswith(installed["PYTHONPATH"])
    assert lfield("--version").stdout.startswith("lfield 0.")
    checked = lfield("check", "hello.L", "hello.dL")
    assert (checked.returncode, checked.stderr) == (0, "")
    done = lfield("up", "--deploy", "hello.dL", "--all", "--until-done")
    assert done.returncode == 0, done.stderr
    assert "alpha | tom: hello tom" in done.stderr


@pytest.mark.few(0)
def test_installed_wheel_finds_its_plugins(installed, tmp_path):
    script = (
        "from lfield.driver.plugins import discover; from lfield.driver.sims import discover_sims; "
        "import lfield_mavlink; print(lfield_mavlink.__file__); "
        "print(sorted(discover().device_types), sorted(discover_sims()))"
    )
    done = run("-P", "-c", script, env=installed, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    place, found = done.stdout.splitlines()
    assert place.startswith(installed["PYTHONPATH"])
    nodes = "'DroneCanBattery', 'DroneCanEsc', 'DroneCanServo'"
    types = f"['CanAxis', 'CanSignals', {nodes}, 'Dynamixel', 'DynamixelGroup', 'Mavlink']"
    assert found == f"{types} ['can', 'dynamixel', 'mavlink']"


def test_editable_install_finds_its_plugins():
    assert [point.value for point in entry_points(group="console_scripts", name="lfield")] == [
        "lfield.__main__:main"
    ]
    plugins = discover()
    assert sorted(plugins.by_driver) == ["can", "dynamixel", "mavlink"]
    assert plugins.problems == []
    assert sorted(discover_sims()) == ["can", "dynamixel", "mavlink"]
    script = Path(sys.executable).with_name("lfield")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.startswith("lfield ")
