"""Conformance checks of a Gps, in addition to the standard ones."""

from __future__ import annotations

import asyncio

from lfield.driver.kit import Bench, CheckFailed, Kit

KIT = Kit()

#: Seconds for a fix under an open sky, and between two positions. Maximum change in degrees.
FIX, APART, FAR = 60.0, 1.5, 0.01


@KIT.check("it has a fix", moves=False)
async def fix(bench: Bench) -> str:
    """Under an open sky it has a fix with at least three satellites."""
    if not await bench.call("waitFix", FIX):
        raise CheckFailed(f"no fix within {FIX:g} s: does it see the sky?")
    if bench.query("satellites") < 3:
        raise CheckFailed(f"a fix by {bench.query('satellites')} satellites")
    return f"{bench.query('fix')} by {bench.query('satellites')} satellites"


@KIT.check("its positions are consistent", moves=False)
async def place(bench: Bench) -> str:
    """Two successive positions are near each other, and new."""
    before = bench.query("position")
    await asyncio.sleep(APART)
    after = bench.query("position")
    if max(abs(a - b) for a, b in zip(before[:2], after[:2], strict=True)) > FAR:
        raise CheckFailed(f"it jumps from {before} to {after}")
    return f"{after[0]:.6f}° {after[1]:.6f}° {after[2]:.1f} m at {bench.query('utc')}"


@KIT.check("its sentences arrive undamaged", moves=False)
async def whole(bench: Bench) -> str:
    """A line or two may be truncated when the port is opened; later ones not."""
    before = bench.query("malformed")
    await asyncio.sleep(APART)
    damaged = bench.query("malformed") - before
    if damaged:
        raise CheckFailed(
            f"{damaged} sentences were damaged in {APART:g} s: check the wires and the baud rate"
        )
    return f"none damaged in {APART:g} s, {before} before"
