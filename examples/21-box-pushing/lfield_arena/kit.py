"""Conformance checks of an Omni, in addition to the standard ones."""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit, cancelled, held, rested

KIT = Kit()

#: Metres: length of a short move, and its tolerance. Seconds: its time-out.
LENGTH, TOLERANCE, MOVE_TIMEOUT = 0.2, 0.03, 10.0


@KIT.check("moves and reports its position", moves=True)
async def moves(bench: Bench) -> str:
    """The telemetry shows a short move."""
    north, east, *_ = bench.query("position")
    if not await bench.call("driveTo", north + LENGTH, east, MOVE_TIMEOUT):
        raise CheckFailed(f"it was not {LENGTH:g} m to the north within {MOVE_TIMEOUT:g} s")
    place = bench.query("position")
    await bench.until(
        lambda: math.dist(bench.query("position"), (north + LENGTH, east)) < TOLERANCE, 1.0, "it there"
    )
    return f"({north:.2f}, {east:.2f}) to ({place[0]:.2f}, {place[1]:.2f})"


@KIT.check("a move that takes too long is ended", moves=True)
async def times_out(bench: Bench) -> str:
    """The robot is at rest when the time of a move is over."""
    north, east, *_ = bench.query("position")
    if await bench.call("driveTo", north, east + 3.0, 0.5):
        raise CheckFailed("it moved 3 m within 0.5 s")
    await bench.until(lambda: not bench.query("moving"), 1.0, "it to come to rest")
    return "it is at rest after 0.5 s"


@KIT.check("a cancelled move ends", moves=True)
async def cancels(bench: Bench) -> str:
    """A cancelled move ends as the manifest defines, and the robot comes to rest."""
    north, east, *_ = bench.query("position")
    outcome = await cancelled(
        bench, lambda: bool(bench.query("moving")), "driveTo", north, east + 3.0, MOVE_TIMEOUT
    )
    await bench.until(lambda: not bench.query("moving"), 1.0, "it to come to rest")
    return outcome


@KIT.check("a velocity that is not renewed ends", moves=True)
async def expires(bench: Bench) -> str:
    """After the time-to-live of a velocity, the robot is at rest in its safe state."""
    await bench.call("setVelocity", 0.0, 0.1)
    await bench.until(lambda: bool(bench.latched), 5.0 + bench.binding.ttl, "the guard to end it")
    await rested(bench)
    return await held(bench, 0.0)
