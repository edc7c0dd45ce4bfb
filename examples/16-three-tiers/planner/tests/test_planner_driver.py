"""The planner's driver with the optimiser in its process, and with faulty programs instead."""

from __future__ import annotations

import asyncio
import itertools
import math
import os
import random
import sys
from contextlib import contextmanager
from functools import partial

import msgspec
import pytest
from lfield_planner import PLUGIN
from lfield_planner.device import mistake
from lfield_planner.driver import PlannerDriver
from lfield_planner.fake import nonsense
from lfield_planner.planning import answer, plan

from lfield.driver import DeviceError
from lfield.testing.driver_bench import DriverBench, bind, running_fake

HOME = (0.0, 0.0)

#: Writes its process id, and then a fixed answer to each line.
STUB = """
import json, os, sys, time
open(sys.argv[2], "w").write(str(os.getpid()))
for line in sys.stdin:
    asked = json.loads(line)
    if not asked["sites"]:
        print('{"tour": []}', flush=True)
    elif asked["reach"] == 13.0:
        time.sleep(1000)
    else:
        print(sys.argv[1], flush=True)
        if not sys.argv[1]:
            raise RuntimeError("a planner with a bug")
"""


def length(start, sites, tour):
    """The length of the path from the start by these sites home."""
    way = [start, *(sites[site] for site in tour), HOME]
    return sum(math.dist(a, b) for a, b in itertools.pairwise(way))


@pytest.mark.parametrize("seed", range(10))
def test_planned_route_is_optimal(seed):
    rng = random.Random(seed)
    sites = [(rng.uniform(-40, 40), rng.uniform(-40, 40)) for _ in range(rng.randint(0, 5))]
    worth = [rng.choice((1.0, 3.0)) for _ in sites]
    start = rng.choice((HOME, (rng.uniform(-20, 20), 5.0)))
    reach = rng.uniform(math.dist(start, HOME) + 0.1, 250.0)
    ways = (
        way for count in range(len(sites) + 1) for way in itertools.permutations(range(len(sites)), count)
    )
    best = max(
        (sum(worth[site] for site in way), -length(start, sites, way))
        for way in ways
        if length(start, sites, way) <= reach
    )
    found = plan(sites, worth, start, reach)
    assert mistake(found, sites, start, reach) == ""
    assert (sum(worth[site] for site in found), -length(start, sites, found)) == pytest.approx(best)


def test_vehicle_that_cannot_return_is_reported():
    assert answer('{"sites": [], "worth": [], "start": [30, 40], "reach": 49}') == (
        '{"error": "ValueError: there is no way home of 49.0 m"}'
    )
    assert "JSONDecodeError" in answer("what?")


def planner(*command):
    """A bench with a planner in a process: the driver's own, or another program.

    A Python process may take seconds to start on a loaded computer: the timeout is far longer.
    """
    binding = bind(PLUGIN, "Planner", field="planner", endpoint="process:", options={"patience": 120.0})
    make = partial(PlannerDriver, command=command) if command else None
    return DriverBench(PLUGIN, binding, make=make)


@pytest.mark.process
def test_planner_runs_in_its_own_process():
    bench = planner()

    async def story(device):
        tour = ([10.0, 0.0, 0.0, 10.0, 90.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0], 40.0)
        assert await device.execute("tour", tour) == [0, 1]
        await bench.until(lambda: bench.values["plans"] == 2)  # the first one on opening
        assert bench.values["failures"] == 0

    bench.run_real(story)


SITES = [10.0, 0.0, 0.0, 10.0], [1.0, 1.0], [0.0, 0.0]


@pytest.mark.process
@pytest.mark.parametrize(
    ("said", "problem"),
    [
        ("", "process:: it ended without an answer|its answer is invalid: ''"),
        ('{"error": "out of memory"}', "it failed: out of memory"),
        ("Segmentation fault", "its answer is invalid: 'Segmentation fault'"),
        ('{"tour": [true]}', "its answer is invalid"),
        ('{"tour": [0, 2]}', "its plan is invalid: there is no site 2"),
        ('{"tour": [1, 1]}', r"its plan is invalid: it visits a site twice: \[1, 1\]"),
        ('{"tour": [0, 1]}', "its plan is invalid: it is 34 m long, more than 30 m"),
    ],
)
def test_failing_or_invalid_planner_answer_is_rejected(said, problem, tmp_path):
    bench = planner(sys.executable, "-c", STUB, said, str(tmp_path / "pid"))

    async def story(device):
        for _ in range(2):
            with pytest.raises(DeviceError, match=problem):
                await device.execute("tour", (*SITES, 30.0))
        await bench.until(lambda: bench.values["failures"] == 2)

    bench.run_real(story)


@contextmanager
def short_timeout(device):
    """The device waits 0.5 s for an answer that never comes; otherwise its timeout allows slow starts."""
    before = device.binding
    device.binding = msgspec.structs.replace(before, options={**before.options, "patience": 0.5})
    yield
    device.binding = before


@pytest.mark.process
@pytest.mark.parametrize("cancelled", [False, True])
def test_planner_without_an_answer_is_ended_and_replaced(cancelled, tmp_path):
    bench = planner(sys.executable, "-c", STUB, '{"tour": [0]}', str(tmp_path / "pid"))

    async def story(device):
        # A new process of Python may take a while on a loaded computer.
        await bench.until(lambda: (tmp_path / "pid").exists() and bool((tmp_path / "pid").read_text()))
        first = int((tmp_path / "pid").read_text())
        if cancelled:
            # The guard cancels it, since the program's time limit has expired.
            thinking = asyncio.ensure_future(device.execute("tour", (*SITES, 13.0)))
            await asyncio.sleep(0.1)
            thinking.cancel()
            with pytest.raises(asyncio.CancelledError):
                await thinking
        else:
            with short_timeout(device), pytest.raises(DeviceError) as ended:
                await device.execute("tour", (*SITES, 13.0))
            assert "no plan within 0.5 s; the request was cancelled" in str(ended.value)
        await bench.until(lambda: not alive(first))
        assert await device.execute("tour", (*SITES, 30.0)) == [0]
        assert int((tmp_path / "pid").read_text()) != first

    bench.run_real(story)


def alive(number):
    """Whether the process exists."""
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.process
@pytest.mark.parametrize("arguments", [
    ([1.0], [1.0], [0.0, 0.0], 9.0),
    ([1.0, 2.0], [1.0], [0.0], 9.0),
    ([1.0, 2.0], [0.0], [0.0, 0.0], 9.0),
    ([1.0, math.nan], [1.0], [0.0, 0.0], 9.0),
    ([1.0] * 26, [1.0] * 13, [0.0, 0.0], 9.0),
])  # fmt: skip
def test_invalid_request_is_not_sent_to_the_planner(arguments, tmp_path):
    bench = planner(sys.executable, "-c", STUB, "never", str(tmp_path / "pid"))

    async def story(device):
        with pytest.raises(DeviceError, match=r"a tour is of|must be finite"):
            await device.execute("tour", arguments)

    bench.run_real(story)


def test_other_endpoint_is_refused():
    binding = bind(PLUGIN, "Planner", endpoint="thought:")

    async def story(device):
        pass

    with pytest.raises(DeviceError, match="not an endpoint; write process: or tcp:HOST:PORT"):
        DriverBench(PLUGIN, binding).run(story)


@pytest.mark.process
def test_simulated_planner_has_the_faults_of_the_real_one():
    with running_fake("planner") as fake:
        bench = DriverBench(
            PLUGIN, bind(PLUGIN, "Planner", endpoint=fake.endpoint, options={"patience": 120.0})
        )

        async def story(device):
            for fault, problem in (
                ("silent=true", "it ended without an answer"),
                ("fails=no licence", "it failed: no licence"),
                ("nonsense=unknown", "there is no site 2"),
                ("nonsense=repeated", "it visits a site twice"),
                ("nonsense=long", "it is 34 m long"),
                ("nonsense=42", "its answer is invalid"),
            ):
                fake.fault(fault)
                with pytest.raises(DeviceError, match=problem):
                    await device.execute("tour", (*SITES, 30.0))
                fake.fault("silent=false", "fails=", "nonsense=", "slow=0")
                assert await device.execute("tour", (*SITES, 35.0)) == [0, 1]
            fake.fault("slow=1e6")
            with short_timeout(device), pytest.raises(DeviceError, match=r"no plan within 0.5 s"):
                await device.execute("tour", (*SITES, 30.0))

        bench.run_real(story)
    assert nonsense("unknown", '{"sites": []}') == '{"tour": [0]}'
