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
from sitl_simulators import KINDS, Kind, Simulator, start_error
from sitl_watcher import Watcher

#: Seconds to wait for a simulator's heartbeat, and between two checks.
CONTACT_TIMEOUT, CHECK_INTERVAL = 60.0, 0.2
#: Below this rate of simulated time to real time, a failed check is reported with the rate.
SLOW = 0.95
#: The number of additional vehicles of an example, and the fakes of its other devices.
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

#: `make test` has no simulators: this file is then ignored.
collect_ignore_glob = [] if os.environ.get("LFIELD_SITL") else ["test_sitl.py"]
configured_kinds = [kind for kind in KINDS if os.environ.get(kind.variable)]
_rows: list[tuple[str, str, str, str]] = []


class Field:
    """Running simulators of one kind, and the watcher of the first vehicle."""

    def __init__(self, kind: Kind, folder: Path) -> None:
        self.kind, self._folder, self._count = kind, folder, 0
        self.simulators: list[Simulator] = []
        self._watcher: Watcher | None = None

    def open(self) -> None:
        """Starts the first vehicle and waits for its heartbeat. Fails with one sentence if there is none."""
        simulator, end = self.start_vehicle(), time.monotonic() + CONTACT_TIMEOUT
        while self._watcher is None or not self._watcher.mode:
            if simulator.failure:
                pytest.fail(simulator.failure, pytrace=False)
            if time.monotonic() > end:
                seconds = f"within {CONTACT_TIMEOUT:g} s"
                place = f"{self.kind.name} sends no heartbeat at {simulator.second_endpoint} {seconds}"
                output = f"; its output:\n{simulator.last_output}" if simulator.last_output else ""
                pytest.fail(f"{place}{output}", pytrace=False)
            time.sleep(CHECK_INTERVAL)
            if self._watcher is None:
                # A new simulator does not listen at once.
                with suppress(OSError):
                    self._watcher = Watcher(simulator.second_endpoint, simulator.system)

    @property
    def vehicle(self) -> Simulator:
        """The first vehicle, which is watched."""
        return self.simulators[0]

    @property
    def watcher(self) -> Watcher:
        """The watcher of the first vehicle."""
        assert self._watcher is not None
        return self._watcher

    def folder(self) -> Path:
        """The path of a new folder."""
        self._count += 1
        return self._folder / str(self._count)

    def start_vehicle(self) -> Simulator:
        """Starts one more vehicle of this kind, with the next system id."""
        simulator = Simulator(self.kind, os.environ[self.kind.variable], len(self.simulators))
        try:
            simulator.start(self.folder())
        except OSError as error:
            pytest.fail(f"{self.kind.variable}: {start_error(simulator.setting, error)}", pytrace=False)
        self.simulators.append(simulator)
        return simulator

    def mission(self, program: str, agents: str, endpoint: str = "") -> Mission:
        """A mission for the first vehicle."""
        return Mission.on(self.vehicle, self.folder(), program, agents, endpoint)

    def lfield(self, *arguments: str | Path) -> Command:
        """Starts a command of lfield."""
        for simulator in self.simulators:
            assert not simulator.failure, simulator.failure
        return Command(self.folder(), *arguments)

    def up(self, mission: Mission, *options: str) -> Command:
        """Starts the host of a mission."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        arguments = ("--deploy", mission.deploy, "--host", "here", "--map", f"here=127.0.0.1:{port}")
        return self.lfield("up", *arguments, *options)

    @contextmanager
    def rest_of_team(self, example: str) -> Iterator[None]:
        """Starts the other vehicles of an example and the fakes of its other devices."""
        vehicles, fakes = OTHERS[example]
        while len(self.simulators) <= vehicles:
            self.start_vehicle()
        started = [self.lfield("sim", *fake.split()) for fake in fakes]
        try:
            for fake in started:
                fake.wait_for("ready ", CONTACT_TIMEOUT)
            yield
        finally:
            for fake in started:
                fake.end()

    def close(self) -> None:
        """Ends the watcher and all simulators."""
        if self._watcher is not None:
            self._watcher.close()
        for simulator in self.simulators:
            simulator.end()


@pytest.fixture(scope="module", params=configured_kinds, ids=lambda kind: kind.name)
def field(request, tmp_path_factory) -> Iterator[Field]:
    """Each simulator kind whose variable is set."""
    opened = Field(request.param, tmp_path_factory.mktemp(request.param.name))
    try:
        opened.open()
        yield opened
    finally:
        opened.close()


def pytest_collection_modifyitems(config, items) -> None:
    """With ONLY, selects the checks with one of its words in their names, and the common set-up."""
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
    """Adds a figure to the row of this check."""
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
    """Prints the table of results."""
    if not _rows:
        return
    terminalreporter.section("simulators")
    for simulator, check, outcome, details in dict.fromkeys(_rows):
        terminalreporter.write_line(f"{outcome:8} {simulator:28} {check:34} {details}")
