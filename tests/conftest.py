"""What holds for all tests: how many run at a time, none meets another, none is judged by a busy computer."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("any computer", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any computer")

#: What tests build is kept for this run only, and found in no other.
_CACHE = tempfile.TemporaryDirectory(prefix="lfield-tests-", ignore_cleanup_errors=True)
os.environ["XDG_CACHE_HOME"] = _CACHE.name
#: Nor is what hosts keep of their starts.
os.environ["XDG_STATE_HOME"] = os.path.join(_CACHE.name, "state")
#: Nor do the commands of tests find, or stop, what else runs on this computer.
os.environ["LFIELD_RUNS"] = "here"


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two workers for each core, since many tests wait for processes; none for a few files or one test."""
    if config.option.keyword or any(word.partition("::")[0].endswith(".py") for word in config.args):
        return 0
    return 2 * len(os.sched_getaffinity(0))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with tests of real processes begin first, long ones before all; the rest fills their waiting."""
    long, process = (
        {item.path for item in items if item.get_closest_marker(name)} for name in ("long", "process")
    )
    items.sort(key=lambda item: (item.path not in long, item.path not in process))


@pytest.fixture(scope="session", autouse=True)
def _own_doors() -> Iterator[None]:
    """The running teams and fakes that a worker's commands find are its own."""
    # Not pytest's folder: the path of a socket may have 107 bytes.
    with tempfile.TemporaryDirectory(prefix="lf-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield
