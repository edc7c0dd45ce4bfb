"""Simulators for `make test-sitl`, and a table of their results, printed at the end."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from sitl_missions import Command, Mission
from sitl_simulators import KINDS, Kind, Simulator, why_not
from sitl_watcher import Watcher

#: Seconds to wait for a simulator's heartbeat, and between two checks.
CONTACT_TIMEOUT, CHECK_INTERVAL = 60.0, 0.2
#: The share of real time below which a slow simulator may be the reason for a failed check.
SLOW = 0.95
#: Additional vehicles of an example (number), and the fakes of its other devices.
OTHERS: Mapping[str, tuple[int, Sequence[str]]] = {
    "01-first-flight": (1, ()),
    "02-equivalent-lift": (
        0,
        (
            "can --listen socketcand:127.0.0.1:29536 --device cia402:5,counts=10000",
            "dynamixel --servo 1:XM540-W270 --servo 2:XM540-W270 --listen /tmp/lfield-arm",
            "dynamixel --servo 1:XM430-W350 --listen /tmp/lfield-hand --fault obstacle=-0.1",
        ),
    ),
    "03-mixed-team": (
        0,
        (
            "can --listen socketcand:127.0.0.1:29536 --device cia402:5,counts=10000",
            "dynamixel --servo 1:XM430-W350 --listen /tmp/lfield-hand --fault obstacle=-0.1",
        ),
    ),
}

#: `make test` has no simulators: it ignores these files.
collect_ignore_glob = [] if os.environ.get("LFIELD_SITL") else ["test_sitl.py"]
given = [kind for kind in KINDS if os.environ.get(kind.variable)]
_rows: list[tuple[str, str, str, str]] = []


class Field:
    """A running simulator of one kind, set up for the bindings of these tests, with its watcher."""

    def __init__(self, kind: Kind, folder: Path) -> None:
        self.kind, self._folder, self._count = kind, folder, 0
        self.simulators: list[Simulator] = []
        self._watcher: Watcher | None = None

    def open(self) -> None:
        """Starts it, and waits for its heartbeat. Fails with one sentence if there is none."""
        simulator, end = self.another(), time.monotonic() + CONTACT_TIMEOUT
        while self._watcher is None or not self._watcher.mode:
            if simulator.trouble:
                pytest.fail(simulator.trouble, pytrace=False)
            if time.monotonic() > end:
                place = (
                    f"{self.kind.name} sends no heartbeat at {simulator.second} within {CONTACT_TIMEOUT:g} s"
                )
                output = f"; its output:\n{simulator.words}" if simulator.words else ""
                pytest.fail(f"{place}{output}", pytrace=False)
            time.sleep(CHECK_INTERVAL)
            if self._watcher is None:
                # A simulator takes a while to listen.
                with suppress(OSError):
                    self._watcher = Watcher(simulator.second, simulator.system)

    @property
    def first(self) -> Simulator:
        """The watched vehicle."""
        return self.simulators[0]

    @property
    def watcher(self) -> Watcher:
        """The watcher of the vehicle."""
        assert self._watcher is not None
        return self._watcher

    def folder(self) -> Path:
        """A new folder."""
        self._count += 1
        return self._folder / str(self._count)

    def another(self) -> Simulator:
        """One more vehicle of this kind, with the next system id."""
        simulator = Simulator(self.kind, os.environ[self.kind.variable], len(self.simulators))
        try:
            simulator.start(self.folder())
        except OSError as error:
            pytest.fail(f"{self.kind.variable}: {why_not(simulator.given, error)}", pytrace=False)
        self.simulators.append(simulator)
        return simulator

    def mission(self, program: str, agents: str, endpoint: str = "") -> Mission:
        """A mission for the first vehicle."""
        return Mission.on(self.first, self.folder(), program, agents, endpoint)

    def lfield(self, *words: str | Path) -> Command:
        """A started command of lfield."""
        for simulator in self.simulators:
            assert not simulator.trouble, simulator.trouble
        return Command(self.folder(), *words)

    def up(self, mission: Mission, *options: str) -> Command:
        """The started host of a mission."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        words = ("--deploy", mission.deploy, "--host", "here", "--map", f"here=127.0.0.1:{port}")
        return self.lfield("up", *words, *options)

    @contextmanager
    def others(self, example: str) -> Iterator[None]:
        """The rest of an example's team: vehicles of this kind, and fakes."""
        vehicles, fakes = OTHERS[example]
        while len(self.simulators) <= vehicles:
            self.another()
        started = [self.lfield("sim", *fake.split()) for fake in fakes]
        try:
            for fake in started:
                fake.wait_for("ready ", CONTACT_TIMEOUT)
            yield
        finally:
            for fake in started:
                fake.end()

    def close(self) -> None:
        """Ends everything that this object has started."""
        if self._watcher is not None:
            self._watcher.close()
        for simulator in self.simulators:
            simulator.end()


@pytest.fixture(scope="module", params=given, ids=lambda kind: kind.name)
def field(request, tmp_path_factory) -> Iterator[Field]:
    """Each given kind."""
    made = Field(request.param, tmp_path_factory.mktemp(request.param.name))
    try:
        made.open()
        yield made
    finally:
        made.close()


def pytest_collection_modifyitems(config, items) -> None:
    """With ONLY, the checks that have one of its words in their names, and the set-up that all need."""
    words = [word.strip() for word in os.environ.get("ONLY", "").split(",") if word.strip()]
    checks = [item for item in items if item.path.name == "test_sitl.py"]
    if not words or not checks:
        return
    unknown = [word for word in words if not any(word in item.name for item in checks)]
    if unknown:
        known = sorted({item.originalname.removeprefix("test_") for item in checks})
        pytest.exit(f"ONLY: there is no check '{unknown[0]}'; there are {', '.join(known)}", returncode=2)
    chosen = [i for i in checks if i.originalname == "test_set_up" or any(word in i.name for word in words)]
    config.hook.pytest_deselected(items=[item for item in checks if item not in chosen])
    items[:] = [item for item in items if item not in checks or item in chosen]


@pytest.fixture
def figure(request) -> Callable[[str], None]:
    """Adds a figure to the table."""
    return lambda text: request.node.user_properties.append(("figure", text))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Stores a row for each executed check."""
    report = yield
    counts = call.when == "call" or (call.when == "setup" and not report.passed)
    if counts and item.path.name == "test_sitl.py":
        _rows.append(_row(item, report, call))
    return report


def _row(item, report, call) -> tuple[str, str, str, str]:
    """The simulator, the check, its outcome, and figures or the first line of the failure."""
    details = [str(value) for name, value in item.user_properties if name == "figure"]
    if call.excinfo is not None:
        details.append(str(call.excinfo.value).partition("\n")[0])
        field = getattr(item, "funcargs", {}).get("field")
        pace = field.watcher.pace(call.duration) if field is not None else None
        if pace is not None and pace < SLOW:
            details.append(f"its time ran at {pace:.2f} of real time: the computer is too slow or too busy")
    simulator = item.callspec.id if hasattr(item, "callspec") else ""
    check = item.originalname.removeprefix("test_").replace("_", " ")
    return simulator, check, report.outcome, "; ".join(details)


def pytest_terminal_summary(terminalreporter) -> None:
    """The table."""
    if not _rows:
        return
    terminalreporter.section("simulators")
    for simulator, check, outcome, details in dict.fromkeys(_rows):
        terminalreporter.write_line(f"{outcome:8} {simulator:28} {check:34} {details}")
