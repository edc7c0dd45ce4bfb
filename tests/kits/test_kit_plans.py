"""The plan checks restore the vehicle's plan after success, failure and cancellation."""

from __future__ import annotations

import asyncio

import pytest

from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import run_kit
from lfield.errors import DeviceError
from lfield_mavlink.kit.plan_checks import PLANS

#: The name of a check, and the instructions by which it reads, writes and clears its plan.
MISSION = (
    "a mission is uploaded, read back and cleared",
    *("missionWaypoints", "uploadMission", "clearMission"),
)
RALLY = (
    "rally points are set, read back and cleared",
    *("rallyPoints", "setRallyPoints", "clearRallyPoints"),
)
HELD = [47.0, 8.0, 30.0, 47.001, 8.0, 40.0]


class Vehicle:
    """A bench with a vehicle that stores one plan, with an optional `fault`; `written` are the uploads."""

    binding = DeviceBinding(
        agent="alpha", field="fc", type="Copter", driver="mavlink", endpoint="here", safe_state="hold"
    )
    confirmed = False

    def __init__(self, plan, held, fault=""):
        _, self.read, self.write, self.clear = plan
        self.held, self.fault = list(held), fault
        self.written = []

    def query(self, quantity):
        assert quantity == "globalPosition"
        return [47.5, 8.5, 400.0]

    async def call(self, instruction, *arguments):
        if instruction == self.read:
            shifted = self.fault == "differs" and self.held != HELD
            return [value + 0.5 for value in self.held] if shifted else list(self.held)
        if instruction == self.clear:
            self.held = self.held if self.fault == "keeps" else []
        elif instruction == self.write:
            await self._take(*arguments)
        else:
            raise AssertionError(f"unexpected call of {instruction}()")
        return None

    async def _take(self, values):
        if self.fault == "limits" and values == HELD:
            raise DeviceError("fc", "waypoint 0 is above the limit")
        if self.fault == "forgets" and self.written and values == HELD and self.held != HELD:
            raise DeviceError("fc", "no room")
        self.written.append(values)
        self.held = list(values)
        if self.fault == "hangs" and values != HELD:
            await asyncio.Event().wait()


def tried(plan, vehicle, *, cancelled=False):
    """The finding of a plan check; None if it was cancelled at its first wait."""
    checks = [check for check in PLANS.checks if check.name == plan[0]]

    async def check():
        return [finding async for finding in run_kit(vehicle, checks, True)]

    async def story():
        running = asyncio.ensure_future(check())
        for _ in range(10):
            await asyncio.sleep(0)
        if cancelled:
            running.cancel()
            await asyncio.wait([running])
            assert running.cancelled()
            return None
        (finding,) = await running
        return finding

    return asyncio.run(story())


@pytest.mark.parametrize("plan", [MISSION, RALLY])
@pytest.mark.parametrize("held", [HELD, []])
def test_plan_check_passes_and_restores_the_plan(plan, held):
    vehicle = Vehicle(plan, held)
    finding = tried(plan, vehicle)
    assert finding.outcome == "passed"
    assert f"now it holds {len(held) // 3}, as before" in finding.seen
    assert vehicle.held == held


@pytest.mark.parametrize("plan", [MISSION, RALLY])
@pytest.mark.parametrize("held", [HELD, []])
@pytest.mark.parametrize(("fault", "words"), [("differs", "read back"), ("keeps", "remained after")])
def test_failed_plan_check_restores_the_plan(plan, held, fault, words):
    vehicle = Vehicle(plan, held, fault)
    finding = tried(plan, vehicle)
    assert finding.outcome == "failed"
    assert words in finding.seen
    if held or fault != "keeps":
        assert vehicle.held == held


@pytest.mark.parametrize("plan", [MISSION, RALLY])
def test_cancelled_plan_check_restores_the_plan(plan):
    vehicle = Vehicle(plan, HELD, "hangs")
    assert tried(plan, vehicle, cancelled=True) is None
    assert len(vehicle.written) == 3
    assert vehicle.held == HELD


def test_plan_that_cannot_be_restored_is_not_changed():
    vehicle = Vehicle(MISSION, HELD, "limits")
    finding = tried(MISSION, vehicle)
    assert finding.outcome == "not run"
    assert finding.seen == "the stored plan could not be restored: waypoint 0 is above the limit"
    assert vehicle.written == []
    assert vehicle.held == HELD


def test_plan_that_was_not_restored_fails_the_check():
    finding = tried(MISSION, Vehicle(MISSION, HELD, "forgets"))
    assert finding.outcome == "failed"
    assert finding.seen == "its 2 waypoints were not given back: no room"
