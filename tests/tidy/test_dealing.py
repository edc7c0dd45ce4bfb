"""The run of these tests itself: who gets which test when a worker has crashed, and which cases are a few."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from types import SimpleNamespace

import pytest


@pytest.fixture
def run(pytestconfig):
    """The conftest of all tests."""
    return pytestconfig.pluginmanager.get_plugin(str(Path(__file__).parents[1] / "conftest.py"))


@pytest.fixture
def dealing(run):
    """Of three files one is with a worker, done in part, and another whole."""
    made = object.__new__(run.Dealing)
    made.workqueue = OrderedDict(c={"c::1": False})
    made.assigned_work = {
        "gone": {"a": {"a::1": True}, "b": {"b::1": True, "b::2": False, "b::3": False}},
        "other": {},
    }
    made.asked = []
    made._reschedule = made.asked.append
    return made


def test_only_what_a_crashed_worker_has_left_is_dealt_again(dealing):
    assert dealing.remove_node("gone") == "b::2"
    assert dealing.workqueue == {"c": {"c::1": False}, "b": {"b::3": False}}
    assert dealing.asked == ["other"]


def test_a_worker_that_crashed_in_its_last_test_leaves_nothing_that_tells_nobody_anything(dealing):
    dealing.assigned_work["gone"]["b"]["b::3"] = True
    assert dealing.remove_node("gone") == "b::2"
    assert dealing.workqueue == {"c": {"c::1": False}}


def test_a_worker_that_has_done_its_work_has_not_crashed(dealing):
    dealing.assigned_work["gone"] = {"a": {"a::1": True}}
    assert dealing.remove_node("gone") is None
    assert dealing.asked == []


def test_a_few_cases_have_each_value_once_if_they_can(run):
    cases = [
        SimpleNamespace(
            nodeid=f"test[{kind}-{seed}]", callspec=SimpleNamespace(indices={"kind": kind, "seed": seed})
        )
        for kind in range(3)
        for seed in range(20)
    ]
    found = run.chosen(cases, 3)
    assert sorted(case.callspec.indices["kind"] for case in found) == [0, 1, 2]
    assert len({case.callspec.indices["seed"] for case in found}) == 3
    assert run.chosen(cases[::-1], 3) == found
    assert run.chosen(cases, 0) == []
    assert sorted(case.nodeid for case in run.chosen(cases, 99)) == sorted(case.nodeid for case in cases)
