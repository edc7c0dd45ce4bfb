"""A fake that does not start says why: the extra that is missing, or its own last words."""

from __future__ import annotations

import asyncio
import sys
import textwrap
from pathlib import Path

import pytest

from lfield.devices.fake_processes import start_fake
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import discover
from lfield.driver.sims import Sims, discover_sims
from lfield.errors import PluginError

pytestmark = pytest.mark.process

#: As on a computer where the extras were not installed: these modules are nowhere to be found.
WITHOUT = """
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


def refused(sims: Sims, driver: str) -> str:
    """What is said of a fake that does not start."""
    with pytest.raises(PluginError) as told:
        asyncio.run(start_fake(sims, [binding(driver)]))
    return str(told.value)


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that are started find no vendor library."""
    missing = {name for names in VENDORS.values() for name in names}
    (tmp_path / "sitecustomize.py").write_text(WITHOUT.format(missing=missing), encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


@pytest.mark.parametrize("driver", ["mavlink", "can"])
def test_a_fake_without_its_library_names_the_extra(bare: None, driver: str) -> None:
    said = refused(discover_sims(), driver)
    assert said.startswith("sky.fc: the simulated device ")
    assert said.endswith(f"pip install 'lfield[{driver}]'")


@pytest.mark.few(3)
@pytest.mark.parametrize("driver", VENDORS)
@pytest.mark.parametrize("command", ["kit", "sim", "doctor"])
def test_every_command_names_the_extra(bare: None, lfield_here, driver: str, command: str) -> None:
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
    status, said = lfield_here(*words)
    # Without a mission a missing library is only worth a word: perhaps nothing needs it.
    assert status == (0 if command == "doctor" else 69)
    assert f"pip install 'lfield[{driver}]'" in said
    assert "Traceback" not in said


@pytest.fixture
def lfield_here(tmp_path: Path):
    """`lfield_here(*words)`: the status of a command, and all that it says."""
    import subprocess

    def run(*words: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "lfield", *words], cwd=tmp_path, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout

    run.folder = tmp_path  # type: ignore[attr-defined]
    return run


def made(folder: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> Sims:
    """A fake of our own that does this when it runs."""
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
def test_its_last_words_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, words: str
) -> None:
    said = refused(made(tmp_path, body, monkeypatch), "mavlink")
    assert said == f"sky.fc: the simulated device 'mavlink' did not start{words}"


async def test_what_it_says_later_is_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    body = "print('early', file=sys.stderr); print('ready here', flush=True); sys.stdin.read(); "
    sims = made(tmp_path, body + "print('late', file=sys.stderr)", monkeypatch)

    await (await start_fake(sims, [binding("mavlink")])).stop()
    assert capsys.readouterr().err == "early\nlate\n"


def test_every_driver_says_what_it_needs() -> None:
    for name, installed in discover().by_driver.items():
        assert installed.plugin.requires == VENDORS[name]
        assert installed.plugin.extra == name
