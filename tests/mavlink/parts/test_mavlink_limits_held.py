"""Every limit of a binding, on each autopilot, with each motion instruction: the flown values."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError

LIMITS = {"speed": 3.0, "altitude": 12.0, "radius": 40.0}
#: Default tolerance of a binding for gusts and noise.
TOLERANCE = 1.2
#: The parameter of the return height, and a value below the limit.
RETURNS = {"ardupilot": ("RTL_ALT", 1000.0), "px4": ("RTL_RETURN_ALT", 10.0)}


class FlownMaxima:
    """The maximum of each limited quantity that a fake has flown."""

    def __init__(self, vehicle):
        self._vehicle, self.maxima = vehicle, dict.fromkeys(LIMITS, 0.0)

    async def watch(self):
        while True:
            await asyncio.sleep(0.05)
            (north, east, down), velocity = self._vehicle.place, self._vehicle.velocity
            now = {"speed": math.hypot(*velocity[:2]), "altitude": -down, "radius": math.hypot(north, east)}
            self.maxima = {name: max(value, now[name]) for name, value in self.maxima.items()}


async def push(fc, *velocity):
    """Command a velocity until it is refused, then a stop."""

    async def on():
        while True:
            await fc.execute("setVelocity", list(velocity))
            await asyncio.sleep(0.2)

    with pytest.raises(DeviceError, match=r"setVelocity refused: it leads (beyond|above) the limit"):
        await on()
    await asyncio.sleep(0.3)
    await fc.execute("hold", [])
    await asyncio.sleep(6.0)


async def tour(b, fc, *, flies, circles):
    """Execute every motion instruction, up to the limits."""
    down = -8.0 if flies else 0.0
    await fc.execute("arm", [])
    if flies:
        await fc.execute("takeoff", [8.0])
    await fc.execute("goTo", [38.0, 0.0, down])
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("goToGlobal", [latitude - 2e-4, longitude, 8.0])
    if circles:
        await fc.execute("orbit", [10.0, 10.0, down, 5.0, 2.5, 0.3])
    await fc.execute("uploadMission", [[latitude - 1e-4, longitude, 8.0, latitude - 2e-4, longitude, 8.0]])
    await fc.execute("startMission", [])
    await asyncio.sleep(8.0)
    await fc.execute("hold", [])
    await push(fc, 0.0, 3.0, 0.0)
    if flies:
        await push(fc, 0.0, 0.0, -2.0)
    await fc.execute("returnHome", [])


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@pytest.mark.parametrize("kind", ["copter", "rover"])
def test_every_limit_holds_in_every_motion(bench, kind, flavour):
    b = bench(kind=kind, flavour=flavour, limits=LIMITS)
    name, height = RETURNS[flavour]
    b.autopilot.parameters[name] = height
    flown, flies = FlownMaxima(b.autopilot.vehicle), kind == "copter"

    async def mission(fc):
        watching = asyncio.create_task(flown.watch())
        await tour(b, fc, flies=flies, circles=flies or flavour == "ardupilot")
        watching.cancel()

    b.run(mission)
    assert all(flown.maxima[limit] <= LIMITS[limit] * TOLERANCE for limit in LIMITS), flown.maxima
    assert flown.maxima["speed"] > 0.8 * LIMITS["speed"]
    assert flown.maxima["radius"] > 36.0
    assert [note for note in b.notes if "beyond" in note] == []
    assert b.breaches == []


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", limits=LIMITS, given="flavour")
async def test_return_with_a_climb_above_the_limit_is_refused(b, fc, /, flavour):
    name, height = RETURNS[flavour]
    mode = {"ardupilot": "RTL", "px4": "AUTO.RTL"}[flavour]

    await up(fc, 4.0)
    words = rf"refused: it would climb to \d+ m \({name}\), above the limit of 12 m; reduce {name}"
    for order in (["returnHome", []], ["setMode", [mode]]):
        with pytest.raises(DeviceError, match=words):
            await fc.execute(*order)
        assert b.autopilot.mode != mode
    await fc.execute("setParameter", [name, height])
    await fc.execute("setMode", [mode])
