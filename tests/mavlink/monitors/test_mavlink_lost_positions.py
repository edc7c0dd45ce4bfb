"""A lost position: ended and refused motions, a fix lost for one second, a second receiver."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from test_mavlink_flight_faults import STACKS, at, fails, up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.monitors.position_monitor import LASTS, PositionMonitor
from lfield_sim.mavlink.telemetry import message_table, motion_messages

GPS2_RAW = int(dialect.MAVLINK_MSG_ID_GPS2_RAW)


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", limits={"speed": 3.0}, given="flavour")
async def test_fix_lost_for_one_second_does_not_end_a_motion(b, fc, /, flavour):
    await up(fc)
    at(4.0, lambda: b.faults.apply(["gps_loss=true"]))
    at(5.0, lambda: b.faults.apply(["gps_loss=false"]))
    await fc.execute("goTo", [25.0, 0.0, -8.0])


@pytest.mark.few(0)
@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", limits={"speed": 3.0}, faults=("loss=0.2", "delay=0.5"), ttl=1.0, given="flavour")
async def test_fix_loss_over_a_slow_radio_ends_a_motion_within_two_seconds(b, fc, /, flavour):
    await up(fc)
    started = at(5.0, lambda: b.faults.apply(["gps_loss=true"]))
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert ended - started < 2.0
    assert "its GNSS fix is lost" in reason
    assert b.values["gpsFix"] < 3, "the value is current where the exception is caught"


@pytest.mark.parametrize(("flavour", "refused", "taken"), [
    ("ardupilot", "RTL", "ALT_HOLD"), ("px4", "AUTO.RTL", "AUTO.LAND"),
])  # fmt: skip
@on_bench("bench", given="flavour")
async def test_mode_that_needs_a_position_is_refused_without_a_fix(b, fc, /, flavour, refused, taken):
    await up(fc)
    b.faults.apply(["gps_loss=true"])
    await asyncio.sleep(1.6)
    with pytest.raises(DeviceError, match=f"mode {refused} refused: its GNSS fix is lost"):
        await fc.execute("setMode", [refused])
    await fc.execute("setMode", [taken])


@on_bench("bench", kind="rover", safe_state="return")
async def test_rover_without_position_holds_instead_of_returning(b, fc, /):
    await fc.execute("arm", [])
    started = at(5.0, lambda: b.faults.apply(["gps_loss=true"]))
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, 0.0]))
    assert ended - started < 2.0
    assert "hold() needs no position" in reason
    await fc.make_safe()
    assert b.autopilot.mode == "HOLD"


@pytest.fixture
def second(monkeypatch):
    """A second receiver in the fakes; `first` and `second` are the fixes of both."""
    fixes = {"first": 3, "second": 3}
    has_fix = motion_messages.has_fix
    monkeypatch.setattr(motion_messages, "has_fix", lambda pilot: fixes["first"] >= 3 and has_fix(pilot))

    def gps2_raw(pilot, place):
        here = place.at(*pilot.vehicle.place[:2])
        return dialect.MAVLink_gps2_raw_message(0, fixes["second"], *here, 0, 90, 90, 0, 0, 14, 0, 0)

    monkeypatch.setitem(message_table.MESSAGES, GPS2_RAW, gps2_raw)
    return fixes


@on_bench("bench", limits={"speed": 3.0}, safe_state="hold")
async def test_motion_continues_until_both_receivers_have_no_fix(b, fc, /, second):
    await up(fc)
    second["first"] = 1
    await asyncio.sleep(3.0)
    await fc.execute("goTo", [8.0, 0.0, -8.0])
    await fc.make_safe()
    assert b.autopilot.mode == "BRAKE", "no landing"
    await fc.execute("release", [])
    started = at(3.0, second.update, {"second": 1})
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    # The second receiver is polled every 0.4 s.
    assert 0.0 < ended - started < 2.0
    assert "its GNSS fix is lost (GPS_FIX_TYPE 1)" in reason


def test_fix_is_lost_only_after_one_and_only_on_all_receivers():
    monitor = PositionMonitor()
    monitor.on_fix(0, 1, 0.0)
    assert monitor.lost(10.0) == ""
    monitor.on_fix(0, 3, 10.0)
    monitor.on_fix(0, 1, 10.2)
    assert monitor.lost(10.0 + LASTS - 0.01) == ""
    assert monitor.lost(10.0 + LASTS) != ""
    monitor.on_fix(1, 4, 11.4)
    assert monitor.lost(12.0) == ""
    monitor.restart()
    monitor.on_fix(0, 1, 20.0)
    assert monitor.lost(30.0) == ""
