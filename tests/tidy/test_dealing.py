"""The test run itself: redistribution after a worker crash, and selection of few cases."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from pathlib import Path
from types import SimpleNamespace

import pytest
from _pytest.python import CallSpec
from coroutine_tests import on_bench, synchronous
from parametrized_cases import failures_of, sample


@pytest.fixture
def run(pytestconfig):
    """The conftest of all tests."""
    return pytestconfig.pluginmanager.get_plugin(str(Path(__file__).parents[1] / "conftest.py"))


@pytest.fixture
def dealing(run):
    """Of three files one is partly done by a worker, and another is waiting."""
    made = object.__new__(run.Dealing)
    made.workqueue = OrderedDict(c={"c::1": False})
    made.assigned_work = {
        "gone": {"a": {"a::1": True}, "b": {"b::1": True, "b::2": False, "b::3": False}},
        "other": {},
    }
    made.asked = []
    made._reschedule = made.asked.append
    return made


def test_only_unfinished_tests_of_a_crashed_worker_are_redistributed(dealing):
    assert dealing.remove_node("gone") == "b::2"
    assert dealing.workqueue == {"c": {"c::1": False}, "b": {"b::3": False}}
    assert dealing.asked == ["other"]


def test_worker_that_crashed_in_its_last_test_leaves_no_rest(dealing):
    dealing.assigned_work["gone"]["b"]["b::3"] = True
    assert dealing.remove_node("gone") == "b::2"
    assert dealing.workqueue == {"c": {"c::1": False}}


def test_finished_worker_has_not_crashed(dealing):
    dealing.assigned_work["gone"] = {"a": {"a::1": True}}
    assert dealing.remove_node("gone") is None
    assert dealing.asked == []


def cases(**counts):
    """The cases of a test with two parameters, with this many values of each."""
    return [
        CallSpec(
            params={"kind": kind, "seed": seed},
            indices={"kind": kind, "seed": seed},
            _idlist=(f"{kind}-{seed}",),
        )
        for kind in range(counts["kinds"])
        for seed in range(counts["seeds"])
    ]


def test_few_cases_have_each_value_once_if_possible():
    every = cases(kinds=3, seeds=20)
    found = sample("test", every, 3)
    assert sorted(case.indices["kind"] for case in found) == [0, 1, 2]
    assert len({case.indices["seed"] for case in found}) == 3
    assert sample("test", every[::-1], 3) == found
    assert sample("test", every, 0) == []
    assert sorted(case.id for case in sample("test", every, 99)) == sorted(case.id for case in every)


def test_all_merged_cases_are_checked_and_each_failure_is_reported():
    def check(kind, seed, shared):
        assert shared == "module"
        observed.append((kind, seed))
        if seed == 1:
            pytest.skip("not here")
        assert kind != 2, "wrong kind"

    observed: list[tuple[int, int]] = []
    failed = failures_of(cases(kinds=3, seeds=3), check, {"shared": "module"})
    assert len(observed) == 9
    assert [error.__notes__ for error in failed] == [["in case [2-0]"], ["in case [2-2]"]]
    assert all("wrong kind" in str(error) for error in failed)


def test_merged_cases_that_all_skip_are_skipped():
    with pytest.raises(pytest.skip.Exception, match="nothing"):
        failures_of(cases(kinds=2, seeds=1), lambda kind, seed: pytest.skip("nothing"), {})


def test_time_limit_ends_merged_cases():
    observed = []

    def check(kind, seed):
        observed.append(kind)
        pytest.fail("Timeout (>240.0s) from pytest-timeout.")

    with pytest.raises(pytest.fail.Exception, match="Timeout"):
        failures_of(cases(kinds=2, seeds=1), check, {})
    assert observed == [0]


class Bench:
    """Runs a scenario with the name of a device."""

    def __init__(self, *given, **options):
        self.given, self.options = given, options

    def run(self, scenario, *, opened):
        asyncio.run(scenario("fc", opened))


@pytest.fixture
def bench():
    return Bench


@pytest.mark.parametrize("speed", [1, 2])
@on_bench("bench", 7, given="speed", opened=False, kind="rover")
async def test_bench_test_gets_bench_and_devices(b, device, opened, /, speed, tmp_path):
    assert (b.given, b.options) == ((7,), {"kind": "rover", "speed": speed})
    assert (device, opened, tmp_path.is_dir()) == ("fc", False, True)


def test_failing_bench_test_fails():
    @on_bench(Bench)
    async def test(b, device, opened, /):
        await asyncio.sleep(0)
        assert device != "fc"

    with pytest.raises(AssertionError):
        test()


def test_coroutine_test_gets_its_arguments_and_can_fail():
    async def test(team, /, number):
        await asyncio.sleep(0)
        assert (team, number) == ("alpha", 1)

    item = SimpleNamespace(obj=test, funcargs={"runner": lambda test: asyncio.run(test("alpha"))})
    synchronous(item)(number=1)
    with pytest.raises(AssertionError):
        synchronous(item)(number=2)


@pytest.mark.parametrize("divisor", [1, 2])
async def test_coroutine_cases_are_checked_in_one_item(divisor):
    await asyncio.sleep(0)
    assert 2 % divisor == 0
