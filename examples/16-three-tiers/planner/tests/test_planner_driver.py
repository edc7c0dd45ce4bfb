"""The planner's driver, with the optimiser and with faulty programs in its process."""

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
from lfield_planner.device import tour_error
from lfield_planner.driver import PlannerDriver
from lfield_planner.fake import invalid_answer
from lfield_planner.planning import answer, plan

from lfield.driver import DeviceError
from lfield.testing.driver_bench import DriverBench, bind, running_fake

HOME = (0.0, 0.0)

#: A planner that writes its process id to a file, and answers each line with its first argument.
STUB = """
import json, os, sys, time
open(sys.argv[2], "w").write(str(os.getpid()))
for line in sys.stdin:
    request = json.loads(line)
    if not request["sites"]:
        print('{"tour": []}', flush=True)
    elif request["reach"] == 13.0:
        time.sleep(1000)
    else:
        print(sys.argv[1], flush=True)
        if not sys.argv[1]:
            raise RuntimeError("a planner with a bug")
"""


def length(start, sites, tour):
    """The length of the path from the start to the sites of a tour and home."""
    path = [start, *(sites[site] for site in tour), HOME]
    return sum(math.dist(a, b) for a, b in itertools.pairwise(path))


@pytest.mark.parametrize("seed", range(10))
def test_planned_route_is_optimal(seed):
    rng = random.Random(seed)
    sites = [(rng.uniform(-40, 40), rng.uniform(-40, 40)) for _ in range(rng.randint(0, 5))]
    worth = [rng.choice((1.0, 3.0)) for _ in sites]
    start = rng.choice((HOME, (rng.uniform(-20, 20), 5.0)))
    reach = rng.uniform(math.dist(start, HOME) + 0.1, 250.0)
    counts = range(len(sites) + 1)
    tours = [tour for count in counts for tour in itertools.permutations(range(len(sites)), count)]
    best = max(
        (sum(worth[site] for site in tour), -length(start, sites, tour))
        for tour in tours
        if length(start, sites, tour) <= reach
    )
    tour = plan(sites, worth, start, reach)
    assert tour_error(tour, sites, start, reach) == ""
    assert (sum(worth[site] for site in tour), -length(start, sites, tour)) == pytest.approx(best)


def test_range_shorter_than_the_way_home_is_an_error():
    assert answer('{"sites": [], "worth": [], "start": [30, 40], "reach": 49}') == (
        '{"error": "ValueError: there is no way home of 49.0 m"}'
    )
    assert "JSONDecodeError" in answer("what?")


def planner(*command):
    """A bench with a planner process: the optimiser, or another command.

    The timeout is long, because a Python process may need seconds to start on a loaded computer.
    """
    binding = bind(PLUGIN, "Planner", field="planner", endpoint="process:", options={"patience": 120.0})
    make = partial(PlannerDriver, command=command) if command else None
    return DriverBench(PLUGIN, binding, make=make)


@pytest.mark.process
def test_planner_runs_in_its_own_process():
    bench = planner()

    async def scenario(device):
        tour = ([10.0, 0.0, 0.0, 10.0, 90.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0], 40.0)
        assert await device.execute("tour", tour) == [0, 1]
        await bench.until(lambda: bench.values["plans"] == 2)  # the first plan is that of the opening
        assert bench.values["failures"] == 0

    bench.run_real(scenario)


SITES = [10.0, 0.0, 0.0, 10.0], [1.0, 1.0], [0.0, 0.0]


@pytest.mark.process
@pytest.mark.parametrize(
    ("answer", "message"),
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
def test_failing_or_invalid_planner_answer_is_rejected(answer, message, tmp_path):
    bench = planner(sys.executable, "-c", STUB, answer, str(tmp_path / "pid"))

    async def scenario(device):
        for _ in range(2):
            with pytest.raises(DeviceError, match=message):
                await device.execute("tour", (*SITES, 30.0))
        await bench.until(lambda: bench.values["failures"] == 2)

    bench.run_real(scenario)


@contextmanager
def short_timeout(device):
    """The device waits at most 0.5 s for an answer."""
    before = device.binding
    device.binding = msgspec.structs.replace(before, options={**before.options, "patience": 0.5})
    yield
    device.binding = before


@pytest.mark.process
@pytest.mark.parametrize("cancelled", [False, True])
def test_planner_without_an_answer_is_ended_and_replaced(cancelled, tmp_path):
    bench = planner(sys.executable, "-c", STUB, '{"tour": [0]}', str(tmp_path / "pid"))

    async def scenario(device):
        await bench.until(lambda: (tmp_path / "pid").exists() and bool((tmp_path / "pid").read_text()))
        first = int((tmp_path / "pid").read_text())
        if cancelled:
            # A guard cancels the call when the program's time limit expires.
            call = asyncio.ensure_future(device.execute("tour", (*SITES, 13.0)))
            await asyncio.sleep(0.1)
            call.cancel()
            with pytest.raises(asyncio.CancelledError):
                await call
        else:
            with short_timeout(device), pytest.raises(DeviceError) as raised:
                await device.execute("tour", (*SITES, 13.0))
            assert "no plan within 0.5 s; the request was cancelled" in str(raised.value)
        await bench.until(lambda: not is_running(first))
        assert await device.execute("tour", (*SITES, 30.0)) == [0]
        assert int((tmp_path / "pid").read_text()) != first

    bench.run_real(scenario)


def is_running(pid):
    try:
        os.kill(pid, 0)
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

    async def scenario(device):
        with pytest.raises(DeviceError, match=r"a tour is of|must be finite"):
            await device.execute("tour", arguments)

    bench.run_real(scenario)


def test_other_endpoint_is_refused():
    binding = bind(PLUGIN, "Planner", endpoint="unknown:")

    async def scenario(device):
        pass

    with pytest.raises(DeviceError, match="not an endpoint; write process: or tcp:HOST:PORT"):
        DriverBench(PLUGIN, binding).run(scenario)


@pytest.mark.process
def test_simulated_planner_has_the_faults_of_the_real_one():
    with running_fake("planner") as fake:
        bench = DriverBench(
            PLUGIN, bind(PLUGIN, "Planner", endpoint=fake.endpoint, options={"patience": 120.0})
        )

        async def scenario(device):
            for fault, message in (
                ("silent=true", "it ended without an answer"),
                ("fails=no licence", "it failed: no licence"),
                ("nonsense=unknown", "there is no site 2"),
                ("nonsense=repeated", "it visits a site twice"),
                ("nonsense=long", "it is 34 m long"),
                ("nonsense=42", "its answer is invalid"),
            ):
                fake.fault(fault)
                with pytest.raises(DeviceError, match=message):
                    await device.execute("tour", (*SITES, 30.0))
                fake.fault("silent=false", "fails=", "nonsense=", "slow=0")
                assert await device.execute("tour", (*SITES, 35.0)) == [0, 1]
            fake.fault("slow=1e6")
            with short_timeout(device), pytest.raises(DeviceError, match=r"no plan within 0.5 s"):
                await device.execute("tour", (*SITES, 30.0))

        bench.run_real(scenario)
    assert invalid_answer("unknown", '{"sites": []}') == '{"tour": [0]}'
