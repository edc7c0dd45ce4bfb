"""Conformance checks of an Omni, in addition to the standard ones."""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit, cancelled, held, rested

KIT = Kit()

#: Metres of a short move, its tolerance; seconds for it.
WAY, NEAR, PATIENCE = 0.2, 0.03, 10.0


@KIT.check("moves and reports its position", moves=True)
async def goes(bench: Bench) -> str:
    """A short move, seen in the telemetry."""
    north, east, *_ = bench.query("position")
    if not await bench.call("driveTo", north + WAY, east, PATIENCE):
        raise CheckFailed(f"it was not {WAY:g} m to the north within {PATIENCE:g} s")
    there = bench.query("position")
    await bench.until(lambda: math.dist(bench.query("position"), (north + WAY, east)) < NEAR, 1.0, "it there")
    return f"({north:.2f}, {east:.2f}) to ({there[0]:.2f}, {there[1]:.2f})"


@KIT.check("a move that takes too long is ended", moves=True)
async def ended(bench: Bench) -> str:
    """It is at rest when the time of a move is over."""
    north, east, *_ = bench.query("position")
    if await bench.call("driveTo", north, east + 3.0, 0.5):
        raise CheckFailed("it moved 3 m within 0.5 s")
    await bench.until(lambda: not bench.query("moving"), 1.0, "it to come to rest")
    return "it is at rest after 0.5 s"


@KIT.check("a cancelled move ends", moves=True)
async def cancels(bench: Bench) -> str:
    """It ends as the manifest defines for a cancel."""
    north, east, *_ = bench.query("position")
    outcome = await cancelled(
        bench, lambda: bool(bench.query("moving")), "driveTo", north, east + 3.0, PATIENCE
    )
    await bench.until(lambda: not bench.query("moving"), 1.0, "it to come to rest")
    return outcome


@KIT.check("a velocity that is not renewed ends", moves=True)
async def ends(bench: Bench) -> str:
    """After its time-to-live the robot is at rest in its safe state."""
    await bench.call("setVelocity", 0.0, 0.1)
    await bench.until(lambda: bool(bench.latched), 5.0 + bench.binding.ttl, "the guard to end it")
    await rested(bench)
    return await held(bench, 0.0)
