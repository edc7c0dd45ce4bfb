"""The heartbeats of the vehicle are lost for a long time; the other telemetry arrives."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect


def without_heartbeats(link, packet):
    """Delivers every packet except heartbeats."""
    if not any(m.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT for m in Reader().feed(packet)):
        link.on_data(packet)


@on_bench("bench", flavour="px4")
async def test_flight_without_heartbeats_lands_and_is_reported_at_rest(b, fc, /):
    await up(fc)
    b.filter = without_heartbeats
    await fc.execute("goTo", [3.0, 0.0, -5.0])
    await asyncio.sleep(7.0)
    report = fc.moving()
    assert report.startswith("no heartbeat for "), report
    assert ", motor state unknown; last reported 5." in report
    await fc.execute("land", [])
    assert not b.autopilot.armed
    await fc.execute("disarm", [])
    assert fc.moving() == ""
    await asyncio.sleep(7.0)
    await fc.make_safe()
    assert fc.moving() == ""


@on_bench("bench", flavour="px4")
async def test_arming_without_heartbeats_is_unconfirmed_not_failed(b, fc, /):
    b.filter = without_heartbeats
    with pytest.raises(DeviceError, match=r"arm was accepted but it cannot be confirmed: no heartbeat for"):
        await fc.execute("arm", [])
