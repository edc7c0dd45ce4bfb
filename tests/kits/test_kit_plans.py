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
STORED_PLAN = [47.0, 8.0, 30.0, 47.001, 8.0, 40.0]


class Vehicle:
    """A vehicle that stores one plan, with an optional `fault`; `written` has the uploaded plans."""

    binding = DeviceBinding(
        agent="alpha", field="fc", type="Copter", driver="mavlink", endpoint="here", safe_state="hold"
    )
    confirmed = False

    def __init__(self, plan, stored, fault=""):
        _, self.read, self.write, self.clear = plan
        self.stored, self.fault = list(stored), fault
        self.written = []

    def query(self, quantity):
        assert quantity == "globalPosition"
        return [47.5, 8.5, 400.0]

    async def call(self, instruction, *arguments):
        if instruction == self.read:
            shifted = self.fault == "shifted" and self.stored != STORED_PLAN
            return [value + 0.5 for value in self.stored] if shifted else list(self.stored)
        if instruction == self.clear:
            self.stored = self.stored if self.fault == "not_cleared" else []
        elif instruction == self.write:
            await self._take(*arguments)
        else:
            raise AssertionError(f"unexpected call of {instruction}()")
        return None

    async def _take(self, values):
        if self.fault == "above_limit" and values == STORED_PLAN:
            raise DeviceError("fc", "waypoint 0 is above the limit")
        if self.fault == "no_space" and self.written and values == STORED_PLAN and self.stored != STORED_PLAN:
            raise DeviceError("fc", "no room")
        self.written.append(values)
        self.stored = list(values)
        if self.fault == "never_returns" and values != STORED_PLAN:
            await asyncio.Event().wait()


def finding_of(plan, vehicle, *, cancelled=False):
    """The finding of a plan check; None with `cancelled`, which cancels the check while it runs."""
    checks = [check for check in PLANS.checks if check.name == plan[0]]

    async def check():
        return [finding async for finding in run_kit(vehicle, checks, True)]

    async def scenario():
        task = asyncio.ensure_future(check())
        for _ in range(10):
            await asyncio.sleep(0)
        if cancelled:
            task.cancel()
            await asyncio.wait([task])
            assert task.cancelled()
            return None
        (finding,) = await task
        return finding

    return asyncio.run(scenario())


@pytest.mark.parametrize("plan", [MISSION, RALLY])
@pytest.mark.parametrize("stored", [STORED_PLAN, []])
def test_plan_check_passes_and_restores_the_plan(plan, stored):
    vehicle = Vehicle(plan, stored)
    finding = finding_of(plan, vehicle)
    assert finding.outcome == "passed"
    assert f"now it holds {len(stored) // 3}, as before" in finding.seen
    assert vehicle.stored == stored


@pytest.mark.parametrize("plan", [MISSION, RALLY])
@pytest.mark.parametrize("stored", [STORED_PLAN, []])
@pytest.mark.parametrize(("fault", "words"), [("shifted", "read back"), ("not_cleared", "remained after")])
def test_failed_plan_check_restores_the_plan(plan, stored, fault, words):
    vehicle = Vehicle(plan, stored, fault)
    finding = finding_of(plan, vehicle)
    assert finding.outcome == "failed"
    assert words in finding.seen
    if stored or fault != "not_cleared":
        assert vehicle.stored == stored


@pytest.mark.parametrize("plan", [MISSION, RALLY])
def test_cancelled_plan_check_restores_the_plan(plan):
    vehicle = Vehicle(plan, STORED_PLAN, "never_returns")
    assert finding_of(plan, vehicle, cancelled=True) is None
    assert len(vehicle.written) == 3
    assert vehicle.stored == STORED_PLAN


def test_plan_that_cannot_be_restored_is_not_changed():
    vehicle = Vehicle(MISSION, STORED_PLAN, "above_limit")
    finding = finding_of(MISSION, vehicle)
    assert finding.outcome == "not run"
    assert finding.seen == "the stored plan could not be restored: waypoint 0 is above the limit"
    assert vehicle.written == []
    assert vehicle.stored == STORED_PLAN


def test_plan_that_was_not_restored_fails_the_check():
    finding = finding_of(MISSION, Vehicle(MISSION, STORED_PLAN, "no_space"))
    assert finding.outcome == "failed"
    assert finding.seen == "its 2 waypoints were not restored: no room"
