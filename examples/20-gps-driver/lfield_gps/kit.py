"""Conformance checks of a Gps, in addition to the standard ones."""

from __future__ import annotations

import asyncio

from lfield.driver.kit import Bench, CheckFailed, Kit

KIT = Kit()

#: Seconds: time-out of a fix under an open sky; interval between two positions. Degrees: maximum change.
FIX_TIMEOUT, INTERVAL, MAX_CHANGE = 60.0, 1.5, 0.01


@KIT.check("it has a fix", moves=False)
async def fix(bench: Bench) -> str:
    """Under an open sky, the receiver has a fix with at least three satellites."""
    if not await bench.call("waitFix", FIX_TIMEOUT):
        raise CheckFailed(f"no fix within {FIX_TIMEOUT:g} s: does it see the sky?")
    if bench.query("satellites") < 3:
        raise CheckFailed(f"a fix by {bench.query('satellites')} satellites")
    return f"{bench.query('fix')} by {bench.query('satellites')} satellites"


@KIT.check("its positions are consistent", moves=False)
async def positions(bench: Bench) -> str:
    """The positions at two times are near each other."""
    before = bench.query("position")
    await asyncio.sleep(INTERVAL)
    after = bench.query("position")
    if max(abs(a - b) for a, b in zip(before[:2], after[:2], strict=True)) > MAX_CHANGE:
        raise CheckFailed(f"it jumps from {before} to {after}")
    return f"{after[0]:.6f}° {after[1]:.6f}° {after[2]:.1f} m at {bench.query('utc')}"


@KIT.check("its sentences arrive undamaged", moves=False)
async def sentences(bench: Bench) -> str:
    """No sentences are damaged, except those received while the port was opened."""
    before = bench.query("malformed")
    await asyncio.sleep(INTERVAL)
    damaged = bench.query("malformed") - before
    if damaged:
        raise CheckFailed(
            f"{damaged} sentences were damaged in {INTERVAL:g} s: check the wires and the baud rate"
        )
    return f"none damaged in {INTERVAL:g} s, {before} before"
