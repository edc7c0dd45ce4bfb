"""The error for a fake that does not start names the missing extra, or has the last output of the fake."""

from __future__ import annotations

import asyncio
import sys
import textwrap
from pathlib import Path

import pytest

from lfield.devices.fake_processes import FakeProcess, bind_to_fakes, start_fake
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import discover
from lfield.driver.sims import Sims, discover_sims
from lfield.errors import PluginError

pytestmark = pytest.mark.process

#: A `sitecustomize.py` that simulates a computer without the extras: Python does not find these modules.
WITHOUT_MODULES = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
PathFinder.find_spec = classmethod(
    lambda cls, name, *rest: None if name.partition(".")[0] in {missing!r} else find(name, *rest)
)
"""
VENDORS = {
    "mavlink": ("pymavlink", "serial"),
    "can": ("can", "canopen", "cantools"),
    "dynamixel": ("dynamixel_sdk", "serial"),
}
OPTIONS = {
    "mavlink": ("Mavlink", {"system": 1, "kind": "copter"}),
    "can": ("CanSignals", {"dbc": "x.dbc", "commands": []}),
    "dynamixel": ("Dynamixel", {"id": 1, "model": "", "protocol": 2}),
}


def binding(driver: str) -> DeviceBinding:
    """A device of a driver on a fake."""
    kind, options = OPTIONS[driver]
    return DeviceBinding(
        agent="sky",
        field="fc",
        type=kind,
        driver=driver,
        endpoint="sim:x",
        safe_state="hold",
        options=options,
    )


def start_error(sims: Sims, driver: str) -> str:
    """The error text of a fake that does not start."""
    with pytest.raises(PluginError) as error:
        asyncio.run(start_fake(sims, [binding(driver)]))
    return str(error.value)


@pytest.fixture
def without_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that this test starts do not find the libraries of the vendors."""
    missing = {name for names in VENDORS.values() for name in names}
    (tmp_path / "sitecustomize.py").write_text(WITHOUT_MODULES.format(missing=missing), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def test_a_first_line_without_end_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("print('x' * (1 << 17), flush=True)", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert start_error(discover_sims(), "dynamixel").startswith("sky.fc: the simulated device ")


def test_a_process_that_cannot_be_started_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/none/python")
    problems: list[str] = []
    asyncio.run(bind_to_fakes([binding("dynamixel")], [], problems))
    assert [problem.startswith("sky.fc: ") for problem in problems] == [True]


#: A `sitecustomize.py` with which the fake of CAN writes its process id and does not become ready.
HANGS_FOR_CAN = """
import os, pathlib, sys, time
if "lfield_sim.can:SIM" in sys.orig_argv:
    pathlib.Path({path!r}).write_text(str(os.getpid()))
    time.sleep(600)
"""


def test_a_cancelled_start_leaves_no_process_without_an_owner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hanging = tmp_path / "pid"
    (tmp_path / "sitecustomize.py").write_text(HANGS_FOR_CAN.format(path=str(hanging)), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    running: list[FakeProcess] = []

    async def cancel_when_one_is_ready() -> None:
        start = asyncio.create_task(bind_to_fakes([binding("dynamixel"), binding("can")], running, []))
        async with asyncio.timeout(60):
            while not running or not hanging.exists() or not hanging.read_text():
                await asyncio.sleep(0.01)
        start.cancel()
        with pytest.raises(asyncio.CancelledError):
            await start
        await running[0].stop()

    asyncio.run(cancel_when_one_is_ready())
    assert len(running) == 1
    assert not Path(f"/proc/{hanging.read_text()}").exists()


@pytest.mark.parametrize("driver", ["mavlink", "can"])
def test_error_of_a_fake_without_its_library_names_the_extra(without_libraries: None, driver: str) -> None:
    output = start_error(discover_sims(), driver)
    assert output.startswith("sky.fc: the simulated device ")
    assert output.endswith(f"pip install 'lfield[{driver}]'")


@pytest.mark.few(3)
@pytest.mark.parametrize("driver", VENDORS)
@pytest.mark.parametrize("command", ["kit", "sim", "doctor"])
def test_error_of_each_command_without_a_library_names_the_extra(
    without_libraries: None, lfield_here, driver: str, command: str
) -> None:
    kind = OPTIONS[driver][0]
    device = {"can": "--set=dbc=x.dbc"}.get(driver, "--set=ttl=1")
    (lfield_here.folder / "x.dbc").touch()
    words = {
        "kit": ["kit", driver, "--type", kind, "--endpoint", "serial:/none:57600", device],
        "sim": ["sim", driver, *(["--device", "dbc:x.dbc"] if driver == "can" else [])],
        "doctor": ["doctor"],
    }[command]
    if (command, driver) == ("sim", "dynamixel"):
        pytest.skip("this fake needs no library")
    status, output = lfield_here(*words)
    # Without a mission a missing library is only a warning, because a mission may not need it.
    assert status == (0 if command == "doctor" else 69)
    assert f"pip install 'lfield[{driver}]'" in output
    assert "Traceback" not in output


@pytest.fixture
def lfield_here(tmp_path: Path):
    """`lfield_here(*words)` runs a command and returns its exit status and its output."""
    import subprocess

    def run(*arguments: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "lfield", *arguments], cwd=tmp_path, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout

    run.folder = tmp_path  # type: ignore[attr-defined]
    return run


def sims_with(folder: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> Sims:
    """A fake that executes `body` when it runs."""
    text = f"""
    import sys
    class Odd:
        name = "mavlink"
        help = "odd"
        def add_arguments(self, parser): parser.add_argument("--until-stdin-closes", action="store_true")
        def arguments(self, devices): return []
        def run(self, args):
            {body}
            return 1
    SIM = Odd()
    """
    (folder / "odd.py").write_text(textwrap.dedent(text), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.syspath_prepend(folder)
    sys.modules.pop("odd", None)
    sims = Sims()
    sims.add("odd:SIM")
    return sims


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError('the wing is bent')", "; it said: ValueError: the wing is bent"),
        ("print('no port', 5, file=sys.stderr)", "; it said: no port 5"),
        ("print('nothing is ready')", "; it said: nothing is ready"),
        ("pass", ", without output"),
    ],
)
def test_error_has_the_last_output_of_the_fake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, words: str
) -> None:
    output = start_error(sims_with(tmp_path, body, monkeypatch), "mavlink")
    assert output == f"sky.fc: the simulated device 'mavlink' did not start{words}"


async def test_later_output_of_a_fake_is_forwarded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    body = "print('early', file=sys.stderr); print('ready here', flush=True); sys.stdin.read(); "
    sims = sims_with(tmp_path, body + "print('late', file=sys.stderr)", monkeypatch)

    await (await start_fake(sims, [binding("mavlink")])).stop()
    assert capsys.readouterr().err == "early\nlate\n"


def test_every_driver_declares_its_required_libraries() -> None:
    for name, installed in discover().by_driver.items():
        assert installed.plugin.requires == VENDORS[name]
        assert installed.plugin.extra == name
