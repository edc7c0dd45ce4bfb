"""The start of a flight: arm and take off."""

from __future__ import annotations


async def up(fc, height: float = 5.0) -> None:
    await fc.execute("arm", [])
    await fc.execute("takeoff", [height])
