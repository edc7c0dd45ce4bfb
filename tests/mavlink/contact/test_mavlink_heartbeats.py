"""Only the heartbeats of the vehicle are lost, for long: the rest of its telemetry flows."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect


def unbeaten(link, packet):
    """What passes: all but heartbeats."""
    if not any(m.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT for m in Reader().feed(packet)):
        link.on_data(packet)


@on_bench("bench", flavour="px4")
async def test_a_flight_without_heartbeats_ends_well_and_is_at_rest(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("takeoff", [5.0])
    b.filter = unbeaten
    await fc.execute("goTo", [3.0, 0.0, -5.0])
    await asyncio.sleep(7.0)
    told = fc.moving()
    assert told.startswith("no heartbeat for "), told
    assert ", motor state unknown; last reported 5." in told
    await fc.execute("land", [])
    assert not b.autopilot.armed
    await fc.execute("disarm", [])
    assert fc.moving() == ""
    await asyncio.sleep(7.0)
    await fc.make_safe()
    assert fc.moving() == ""


@on_bench("bench", flavour="px4")
async def test_what_only_a_heartbeat_shows_is_not_said_to_have_failed(b, fc, /):
    b.filter = unbeaten
    with pytest.raises(DeviceError, match=r"arm was accepted but it cannot be confirmed: no heartbeat for"):
        await fc.execute("arm", [])
