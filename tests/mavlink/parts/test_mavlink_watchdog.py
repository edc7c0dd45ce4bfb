"""The autopilot's own failsafes: set, read back, refused when too slow, and left alone to do their work."""

from __future__ import annotations

import asyncio

import pytest

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.parts.watchdog import SETTINGS
from lfield_sim.mavlink.link.codec import Writer


def read(b, *names):
    return [b.autopilot.parameters[name] for name in names]


def without(b, name):
    """The vehicle says nothing that has this name in it, as one that does not have the parameter."""
    deliver = b.filter
    b.filter = lambda link, packet: None if name in packet else deliver(link, packet)


@pytest.mark.parametrize(("state", "action"), [("land", 5), ("hold", 7), ("return", 1)])
def test_a_copter_does_by_itself_what_its_safe_state_is(bench, state, action):
    b = bench(safe_state=state, ttl=1.0, waivers=())
    b.run(lambda fc: asyncio.sleep(0.1))
    assert read(b, "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "GUID_TIMEOUT", "FS_OPTIONS") == [action, 2, 2, 24]
    assert b.values["gcsFailsafe"] is True


def test_times_that_are_short_enough_are_left_as_they_are(bench):
    b = bench(ttl=2.0, waivers=())
    b.autopilot.parameters.update(
        {"FS_GCS_TIMEOUT": 3, "GUID_TIMEOUT": 1, "FS_GCS_ENABLE": 5, "FS_OPTIONS": 8}
    )
    b.run(lambda fc: asyncio.sleep(0.1))
    assert read(b, "FS_GCS_TIMEOUT", "GUID_TIMEOUT") == [3, 1]
    assert [note for note in b.notes if "is now" in note] == []


def test_a_shorter_time_to_live_than_the_autopilot_can_keep_needs_a_waiver(bench):
    b = bench(ttl=0.5, waivers=())

    async def mission(fc):
        with pytest.raises(DeviceError, match="watchdog of 2 s: nothing stops it sooner") as error:
            await fc.open()
        return error.value.reason

    assert "waivers: [device_watchdog]" in b.run(mission, opened=False)
    assert read(b, "FS_GCS_TIMEOUT", "GUID_TIMEOUT") == [2, 1]


def test_a_rover_stops(bench):
    b = bench(kind="rover", ttl=1.5, waivers=())
    b.run(lambda fc: asyncio.sleep(0.1))
    assert read(b, "FS_GCS_ENABLE", "FS_ACTION", "FS_GCS_TIMEOUT", "FS_TIMEOUT") == [1, 2, 2, 1]


def test_a_failsafe_that_cannot_be_set_is_an_error_at_opening(bench):
    b = bench()

    class Fixed(dict):
        def __setitem__(self, name, value):
            if name != "FS_GCS_ENABLE":
                super().__setitem__(name, value)

    b.autopilot.parameters = Fixed(b.autopilot.parameters)

    async def mission(fc):
        with pytest.raises(DeviceError, match="FS_GCS_ENABLE could not be set to 5: it is 0"):
            await fc.open()

    b.run(mission, opened=False)


def test_a_failsafe_that_is_not_told_is_an_error_at_opening(bench):
    b = bench()
    without(b, b"FS_GCS_ENABLE")

    async def mission(fc):
        with pytest.raises(DeviceError, match="it does not tell FS_GCS_ENABLE") as error:
            await fc.open()
        assert error.value.kind == "DeviceTimeoutException"

    b.run(mission, opened=False)


def test_an_older_name_of_a_parameter_is_found(bench):
    b = bench()
    without(b, b"MAV_GCS_SYSID")
    older = dialect.MAVLink_param_value_message(b"SYSID_MYGCS", 1.0, dialect.MAV_PARAM_TYPE_INT16, 1, 0)

    async def mission(fc):
        asyncio.get_running_loop().call_later(4.0, b.links[0].on_data, Writer(1, 1).pack(older))
        return await fc.watchdog.find(SETTINGS[ARDUPILOT, "copter"][2])

    name, found = b.run(mission, opened=False)
    assert (name, found) == ("SYSID_MYGCS", 1)


def test_a_failsafe_that_somebody_has_changed_since_is_set_again_before_arming(bench):
    b = bench(ttl=1.0, waivers=())

    async def mission(fc):
        b.autopilot.parameters["FS_GCS_ENABLE"] = 0
        b.autopilot.parameters["FS_GCS_TIMEOUT"] = 60
        await fc.execute("arm", [])

    b.run(mission)
    assert read(b, "FS_GCS_ENABLE", "FS_GCS_TIMEOUT") == [5, 2]


@pytest.mark.parametrize(("flavour", "within"), [("ardupilot", 3.5), ("px4", 12.0)])
def test_when_we_are_quiet_the_autopilot_acts_by_itself(bench, flavour, within):
    b = bench(flavour=flavour, ttl=1.0, waivers=())

    async def mission(fc):
        await fc.execute("arm", [])
        await fc.execute("takeoff", [5.0])
        b.driver.quiet()
        sent = len(b.sent)
        await asyncio.sleep(within)
        assert b.autopilot.mode in ("LAND", "AUTO.LAND")
        assert len(b.sent) == sent
        # The safe state is still sent, and heartbeats come again when the owner does.
        await fc.make_safe()
        b.driver.resume()
        await asyncio.sleep(1.0)
        assert len(b.sent) > sent

    b.run(mission)


def test_our_heartbeats_keep_it_flying(bench):
    b = bench(ttl=1.0, waivers=(), faults=("loss=0.2",))

    async def mission(fc):
        await fc.execute("arm", [])
        await fc.execute("takeoff", [5.0])
        await asyncio.sleep(60.0)
        assert b.autopilot.mode == "GUIDED"

    b.run(mission)


def test_every_kind_has_a_time_that_counts():
    for (stack, kind), settings in SETTINGS.items():
        clocks = {setting.clock for setting in settings}
        assert ("setpoint" if stack == PX4 else "link") in clocks, kind
