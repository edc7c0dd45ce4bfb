"""The client with real hosts: calls, cancellation, events, and a thousand clients at a time."""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import suppress

import pytest

from lfield.client import connect
from lfield.errors import LfieldError, PortalCallRefused, PortalFailed, ProgramError, UsageError

pytestmark = pytest.mark.process

PROGRAM = """
resource Arm {
    real width;
    init(string[] arg) { }
    portal home() { width = 0.0; }
    portal grab(real to) emit real { width = to; return width; }
    portal where() emit real { return width; }
    portal slow(real seconds) { sleep(seconds); width = 99.0; }
}
coordinator Loader {
    init(string[] arg) {
        Arm far = findArm("arm2");
        for (int n = 1; n < 100000; n = n + 1) { far.where(); print("tick " + i2s(n)); sleep(0.5); }
    }
}
"""
DEPLOYMENT = "//Arm:arm1@alpha\n//Arm:arm2@bravo\n//Loader:loader@alpha\n"
ACCESS = "calls:\n  others: {Arm: [grab, where, slow]}\n"


@pytest.fixture
def team(lfield, alone, monkeypatch):
    lfield.write("mission.access.yaml", ACCESS)
    mission = lfield.mission(PROGRAM, DEPLOYMENT)
    process = lfield.start("up", "--all", "--sim", mission, env=alone)
    process.wait_for("tick 1$")
    monkeypatch.setenv("XDG_RUNTIME_DIR", alone["XDG_RUNTIME_DIR"])
    process.mission = mission
    return process


def test_calls_status_and_events(team) -> None:
    async def work() -> None:
        async with connect(team.mission) as found:
            assert await found.call("arm1", "grab", 2) == 2.0
            assert await found.call("arm2", "where") == 0.0
            with pytest.raises(PortalCallRefused) as refused:
                await found.call("arm1", "home")
            assert refused.value.as_data()["kind"] == "not-permitted"
            unknown = [("arm9", "home"), ("arm1", "w" * 5000), ("arm1", "\ud800"), ("", "where"), (None, 5)]
            cases = [*((words, "no-portal") for words in unknown), (("arm1", "grab", "x"), "arguments")]
            for words, kind in cases:
                with pytest.raises(PortalCallRefused) as refused:
                    await found.call(*words)
                assert refused.value.kind == kind
            with pytest.raises(PortalFailed) as failed:
                await found.call("arm1", "slow", 60.0, timeout=0.5)
            assert failed.value.kind == "TimeLimitException"
            with pytest.raises(UsageError):
                await found.call("arm1", "where", timeout=0.0)
            assert set(await found.status()) == {"alpha", "bravo"}
            for wrong in ({"kinds": ["nothing"]}, {"since": -1}, {"since": 2**63}, {"rate": -1.0}):
                with pytest.raises(UsageError):
                    found.events(**wrong)
            for size in (-1, 0, 10**6):
                with pytest.raises(UsageError):
                    await found.query("Lift", size=size)
            with pytest.raises(ProgramError):
                await found.query("Nothing")
            calls = [
                event
                async for event in _first(found.events(since=0, kinds=["logged"], hosts=["alpha"]), 6)
                if event["code"] == "portal-called"
            ]
            assert calls

    asyncio.run(work())
    team.wait_for(r"arm1.grab\(\) called by user .* ended: returned")


async def _first(stream, most: int):
    number = 0
    async for each in stream:
        yield each
        number += 1
        if number == most:
            return


def test_a_cancelled_task_cancels_the_portal(team) -> None:
    async def work() -> object:
        async with connect(team.mission) as found:
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(found.call("arm1", "slow", 60.0), 1.0)
            return await found.call("arm1", "where")

    assert asyncio.run(work()) == 0.0
    team.wait_for(r"arm1.slow\(\) called by user .* ended: CancelledException")


@pytest.mark.few(0)
def test_a_thousand_clients_are_answered_or_refused_and_the_mission_runs(team) -> None:
    async def one(found) -> str:
        try:
            await found.call("arm1", "grab", 1.0, timeout=5.0)
        except LfieldError as error:
            return f"{error.code} {getattr(error, 'kind', '')}".strip()
        return "returned"

    async def work() -> Counter[str]:
        clients = [connect(team.mission) for _ in range(1000)]
        teams = [await client.__aenter__() for client in clients]
        outcomes = Counter(await asyncio.gather(*(one(found) for found in teams)))
        for client in clients:
            await client.__aexit__(None, None, None)
        return outcomes

    outcomes = asyncio.run(work())
    assert outcomes.total() == 1000
    assert outcomes["returned"] > 0
    clear = {
        "returned",
        "portal-call-refused busy",
        "handshake",
        "address",
        "portal-call-unknown unreachable",
    }
    assert set(outcomes) <= clear, outcomes
    ticks = sum("tick" in line for line in list(team.out))
    team.wait_for(f"tick {ticks + 2}$")

    async def later() -> object:
        """Repeat the call until it is accepted: the host refuses calls while many requests arrive."""
        async with connect(team.mission) as found:
            for _ in range(100):
                with suppress(PortalCallRefused):
                    return await found.call("arm1", "where")
                await asyncio.sleep(0.1)
        raise AssertionError("refused for 10 s after the last of the thousand")

    assert asyncio.run(later()) == 1.0
