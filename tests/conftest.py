"""Settings of all tests: number of workers, isolation from each other and from the user, and no deadlines."""

from __future__ import annotations

import asyncio
import gc
import inspect
import os
import signal
import sys
import tempfile
import weakref
import zlib
from collections.abc import Callable, Coroutine, Iterator
from types import FrameType
from typing import Any

import coroutine_tests
import parametrized_cases
import pytest
from _pytest.unittest import TestCaseFunction
from hypothesis import HealthCheck, is_hypothesis_test, settings
from hypothesis.internal.conjecture import providers
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

settings.register_profile("any computer", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any computer")
#: Hypothesis would read all modules of lfield for constants. This takes seconds in each worker, and the
#: examples would depend on the modules that earlier tests imported, even with derandomize.
assert hasattr(providers, "is_local_module_file")
providers.is_local_module_file = lambda path: False
#: The part of the examples of each property that a run without `--every-case` makes, and the minimum.
_EXAMPLES, _LEAST_EXAMPLES = 0.3, 12

#: Built files are kept for this run only, and not used by any other. The workers share them.
_OWN = tempfile.TemporaryDirectory(prefix="lfield-tests-", ignore_cleanup_errors=True)
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XDG_CACHE_HOME"] = os.path.join(_OWN.name, "cache")
#: Each worker has its own keys and its own record of the starts of hosts.
os.environ["XDG_CONFIG_HOME"] = os.path.join(_OWN.name, "config")
os.environ["XDG_STATE_HOME"] = os.path.join(_OWN.name, "state")
#: Commands of tests do not find or stop other teams that run on this computer.
os.environ["LFIELD_RUNS"] = "here"
#: They do not reach the hosts in the inventory of this computer.
os.environ["LFIELD_INVENTORY"] = ""
#: Python caches compiled modules in any environment: a run starts a thousand interpreters.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
#: A shell that runs the tests in the background may ignore Ctrl-C; processes of the tests would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

#: Files and folders whose tests share nothing and mostly wait for processes.
WAITING = (
    "tests/cli/run/test_thesis_and_examples.py",
    "tests/cli/run/test_up_",
    "tests/cli/stops/",
    "tests/cli/operations/test_estop.py",
    "tests/mavlink/client/",
)


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two workers for each core, since many tests wait for processes; none for single files or tests."""
    if config.option.keyword or any(word.partition("::")[0].endswith(".py") for word in config.args):
        return 0
    return 2 * len(os.sched_getaffinity(0))


class Dealing(LoadFileScheduling):
    """Keeps the tests of a file on one worker, since they may share expensive fixtures, except WAITING."""

    def _split_scope(self, nodeid: str) -> str:
        return nodeid if nodeid.startswith(WAITING) else super()._split_scope(nodeid)

    def remove_node(self, node: WorkerController) -> str | None:
        """Distribute the remaining tests of a worker that ended, except for the test in which it crashed.

        xdist would also distribute the crashed test, which would crash the next worker, and the finished
        ones: a worker that gets only finished tests receives no further command, so the run would never end.
        """
        left = {
            scope: [test for test, done in tests.items() if not done]
            for scope, tests in self.assigned_work.pop(node).items()
        }
        crashed = next((test for tests in left.values() for test in tests), None)
        for scope, tests in left.items():
            if rest := {test: False for test in tests if test != crashed}:
                self.workqueue[scope] = rest
        if crashed:
            for other in self.assigned_work:
                self._reschedule(other)
        return crashed


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Dealing:
    """Use `Dealing` to distribute the tests."""
    return Dealing(config, log)


#: Tests in which software of others uses our fakes, or takes the place of devices of our drivers.
FOREIGN = {
    "tests/sim/mavlink/test_sim_foreign.py": "pymavlink: mavutil, mavwp, mavftp; dronekit's way",
    "tests/mavlink/client/test_mavsdk_client.py": "MAVSDK",
    "tests/mavlink/client/test_mavsdk_payload.py": "MAVSDK's gimbal and camera",
    "tests/mavlink/client/test_mavsdk_vehicle.py": "a vehicle made of MAVSDK",
    "tests/can/fake/test_can_fake_foreign.py": "canopen's client of CiA 402",
    "tests/can/foreign/test_foreign_drives.py": "drives made of canopen's node",
    "tests/can/fake/test_can_fake_odrive.py": "frames as ODrive's scripts send them",
    "tests/dynamixel/fake/test_dynamixel_fake_sdk.py": "the Dynamixel SDK",
    "tests/dynamixel/fake/test_dynamixel_fake_feetech.py": "Feetech's SDK",
}


def needs_namespaces(report: pytest.TestReport) -> bool:
    """Whether the report is of a test that needs network namespaces, which few computers offer."""
    return report.nodeid.startswith(("tests/radio/", "tests/provision/"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print notes of tests and reasons for skips; with -s also the tests with software of others."""
    for reason in sorted(
        {skip.longrepr[2] for skip in terminalreporter.stats.get("skipped", []) if needs_namespaces(skip)}
    ):
        terminalreporter.write_line(f"NOT TESTED: {reason.removeprefix('Skipped: ')}")
    for report in terminalreporter.stats.get("passed", []):
        for name, note in report.user_properties:
            if name == "note":
                terminalreporter.write_line(note)
    if terminalreporter.config.option.capture != "no":
        return
    for file, client in FOREIGN.items():
        passed, failed = (
            sum(report.nodeid.startswith(file) for report in terminalreporter.stats.get(key, []))
            for key in ("passed", "failed")
        )
        if passed + failed:
            terminalreporter.write_line(f"{client}: {passed + failed} tried, {passed} passed")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--every-case", action="store_true", help="all cases of the tests marked few(COUNT)")
    parser.addoption("--rewrite", action="store_true", help="rewrite the golden files of tests/oracles")


def _named(config: pytest.Config) -> bool:
    """Whether the command names tests; then each case of them runs as an item of its own."""
    return bool(config.option.keyword) or any("::" in word for word in config.args)


class EveryTest:
    """Hooks for the tests of the examples too, since hooks of a conftest apply only to its own folder."""

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> Iterator[None]:
        """Take a sample of the cases, and merge cases that need no fixture of their own into one item."""
        yield
        if not (metafunc.config.option.every_case or _named(metafunc.config)):
            parametrized_cases.take_sample(metafunc)
            parametrized_cases.merge(metafunc)

    def pytest_pyfunc_call(self, pyfuncitem: pytest.Function) -> bool | None:
        """Check all cases of a merged item, and run coroutine functions."""
        merged = getattr(pyfuncitem, "callspec", None)
        check = coroutine_tests.synchronous(pyfuncitem)
        if isinstance(merged, parametrized_cases.MergedCases):
            parametrized_cases.check_all(pyfuncitem, merged, check)
            return True
        if check is pyfuncitem.obj:
            return None
        check(**{name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames})
        return True


class FleetCleanup:
    """Closes the simulated fleets that a test leaves running.

    The tasks of a killed process must not be unwound, so they stay in memory until `Fleet.close`. Without it,
    the fleets of all tests would fill gigabytes, and each garbage collection would visit them.
    """

    FOLDERS = ("tests/simulate/", "tests/testing/")

    def __init__(self) -> None:
        #: Weak references: a fleet that the test has closed itself is freed at once.
        self._created: weakref.WeakSet[Any] = weakref.WeakSet()
        self._is_recording = self._is_installed = False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Close the fleets after the test. Tests of other folders share fleets."""
        self._install()
        self._is_recording = item.nodeid.startswith(FleetCleanup.FOLDERS)
        try:
            return (yield)
        finally:
            self._is_recording = False
            for fleet in list(self._created):
                fleet.close()
            self._created.clear()

    def _install(self) -> None:
        # Only where a test has imported the module, which loads slowly.
        module = sys.modules.get("lfield.simulate.host_fleet")
        if self._is_installed or module is None:
            return
        self._is_installed = True
        make = module.Fleet.__init__

        def record(fleet: Any, *given: Any, **options: Any) -> None:
            make(fleet, *given, **options)
            if self._is_recording:
                self._created.add(fleet)

        module.Fleet.__init__ = record


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(EveryTest())
    config.pluginmanager.register(FleetCleanup())


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(name: str, obj: object) -> None:
    """Mark coroutine functions to use the fixture `runner`."""
    if name.startswith("test_") and inspect.iscoroutinefunction(obj):
        pytest.mark.usefixtures("runner")(obj)


def _make_fewer_examples(function: Any) -> None:
    """Reduce the random examples of a property; other runs make other examples."""
    made = getattr(function, "_hypothesis_internal_use_settings", None) or settings.default
    function._hypothesis_internal_use_settings = _with_fewer_examples(made)


def _with_fewer_examples(made: settings) -> settings:
    least = min(_LEAST_EXAMPLES, made.max_examples)
    return settings(made, max_examples=max(least, int(_EXAMPLES * made.max_examples)))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort long files first and mix the others, so that tests that compute run beside tests that wait."""
    if not (config.option.every_case or _named(config)):
        # The cases of tests with parameters were sampled before.
        out = {item for item in items if any(mark.args == (0,) for mark in item.iter_markers("few"))}
        config.hook.pytest_deselected(items=[item for item in items if item in out])
        items[:] = [item for item in items if item not in out]
        functions = {item.function for item in items if isinstance(item, pytest.Function)}
        for function in filter(is_hypothesis_test, functions):
            _make_fewer_examples(function)
        # A state machine of Hypothesis has its settings at its class.
        for machine in {item.cls for item in items if isinstance(item, TestCaseFunction)}:
            if isinstance(made := getattr(machine, "settings", None), settings):
                machine.settings = _with_fewer_examples(made)
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    long = {item.path for item in items if item.get_closest_marker("long")}
    items.sort(key=lambda item: (item.path not in long, zlib.crc32(item.path.name.encode())))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Freeze the collected items, so that the garbage collector never visits them in a test.

    Also make it visit new objects less often.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def _own_doors() -> Iterator[None]:
    """Give each worker its own folder for the sockets of running teams and fakes."""
    # Not pytest's folder: the path of a socket is limited to 107 bytes.
    with tempfile.TemporaryDirectory(prefix="lf-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield


@pytest.fixture(scope="session")
def runner() -> Callable[[Callable[[], Coroutine[Any, Any, object]]], object]:
    """Runs tests that are coroutine functions, unless their folder or file has a `runner` of its own."""
    return lambda test: asyncio.run(test())


def _steps_of(work: Callable[[], object]) -> int:
    count = 0

    def line(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        count += event == "line"
        return line

    before = sys.gettrace()
    sys.settrace(line)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


@pytest.fixture
def steps() -> Callable[[Callable[[], object]], int]:
    """A function that counts the lines of Python that a call executes: a repeatable measure of time."""
    return _steps_of
