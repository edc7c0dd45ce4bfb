"""Failsafe settings of the autopilot for a binding: read, not written, refused if wrong or too slow."""

from __future__ import annotations

import asyncio
import itertools

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.driver.settings import mismatched
from lfield.errors import DeviceError, DeviceNotSetUp
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.watchdog import NEEDS
from lfield_sim.mavlink.link.codec import PacketWriter
from lfield_sim.mavlink.telemetry.message_table import MESSAGES

SET = dialect.MAVLINK_MSG_ID_PARAM_SET
EACH = list(itertools.product(("ardupilot", "px4"), ("copter", "rover"), ("land", "hold", "return")))


def read(b, *names):
    return [b.autopilot.parameters[name] for name in names]


def written(b):
    """The names of the parameters that the driver has set."""
    reader = Reader()
    return [m.param_id for data in b.sent for m in reader.feed(data) if m.get_msgId() == SET]


def without(b, name):
    """Drops packets with this name, like a vehicle without the parameter."""
    deliver = b.filter
    b.filter = lambda link, packet: None if name in packet else deliver(link, packet)


async def set_up(fc):
    """The steps of `lfield setup` for one device."""
    await fc.find()
    for setting in mismatched(await fc.settings()):
        await fc.write_setting(setting.name, setting.wanted)


def board_report(uid, uid2):
    """A report of the fake with another board id."""
    return lambda autopilot, place: dialect.MAVLink_autopilot_version_message(
        autopilot.flavour.capabilities, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid, uid2
    )


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", board=0x3F21, faults=("loss=0.2",), given="flavour")
async def test_serial_is_the_board_uid_also_after_a_reboot(b, fc, /, flavour):
    first = await fc.serial()
    b.autopilot.reboot()
    await fc.find()
    assert {first, await fc.serial()} == {"uid 000000000000000000003f21"}


@pytest.mark.parametrize(
    ("uid", "uid2", "serial"),
    [
        (0xAB, [1, 2, *[0] * 16], "uid 0102"),
        (0xAB, [0] * 18, "uid ab"),
        (0, [0] * 18, ""),
    ],
)
def test_longer_board_uid_is_preferred(bench, monkeypatch, uid, uid2, serial):
    monkeypatch.setitem(MESSAGES, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, board_report(uid, uid2))

    async def scenario(fc):
        return await fc.serial()

    assert bench().run(scenario) == serial


@pytest.mark.few(6)
@pytest.mark.parametrize(("flavour", "kind", "state"), EACH)
@on_bench("bench", limits={"speed": 1.5}, set_up=False, given="flavour kind safe_state=state", opened=False)
async def test_stock_vehicle_is_refused_then_set_up_and_opened(b, fc, /, flavour, kind, state):
    with pytest.raises(DeviceNotSetUp, match="it is not set up for its binding: ") as refused:
        await fc.open()
    assert written(b) == []
    named = [setting.name for setting in mismatched(await fc.settings())]
    assert f"{named[0]} is " in refused.value.reason
    mismatches = [note for note in b.notes if note.code == "setting-mismatch"]
    assert all(any(f" {name} is " in note for note in mismatches) for name in named)
    await set_up(fc)
    assert sorted(written(b)) == sorted(named)
    await fc.open()
    assert b.values["gcsFailsafe"] is True
    assert dict.fromkeys(named)
    assert written(b).count("NAV_DLL_ACT" if flavour == "px4" else "FS_GCS_ENABLE") == 1


@pytest.mark.few(4)
@pytest.mark.parametrize(("flavour", "kind", "state"), EACH)
@pytest.mark.parametrize("ttl", [0.1, 4.0])
def test_fakes_of_a_mission_need_no_setup(bench, flavour, kind, state, ttl):
    b = bench(flavour=flavour, kind=kind, safe_state=state, ttl=ttl, limits={"speed": 1.5})
    b.run(lambda fc: asyncio.sleep(0.1))
    assert written(b) == []


@pytest.mark.parametrize(("state", "action"), [("land", 5), ("hold", 7), ("return", 1)])
def test_copter_setup_maps_the_safe_state_to_its_failsafe(bench, state, action):
    b = bench(safe_state=state, ttl=1.0, waivers=(), set_up=False)
    b.run(set_up, opened=False)
    assert read(b, "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "GUID_TIMEOUT", "FS_OPTIONS") == [action, 2, 2, 24]


def test_short_enough_failsafe_times_are_accepted(bench):
    b = bench(ttl=2.0, waivers=(), set_up=False)
    b.autopilot.parameters.update(
        {
            "FS_GCS_TIMEOUT": 2,
            "GUID_TIMEOUT": 1,
            "FS_GCS_ENABLE": 5,
            "FS_OPTIONS": 8,
            "MAV_GCS_SYSID": 128,
        }
    )
    b.run(lambda fc: asyncio.sleep(0.1))


@pytest.mark.parametrize(
    ("flavour", "kind", "least"),
    [("ardupilot", "copter", 2), ("ardupilot", "rover", 3)],
)
def test_ttl_below_the_autopilot_minimum_needs_a_waiver(bench, flavour, kind, least):
    def opened(ttl):
        b = bench(flavour=flavour, kind=kind, ttl=ttl, waivers=())
        b.run(lambda fc: asyncio.sleep(0.1))

    opened(least / 2)
    with pytest.raises(DeviceError, match=f"watchdog too slow: {least} s, limit 1 s") as error:
        opened(0.5)
    assert f"set 'ttl: {least / 2:g}'" in error.value.reason
    assert "waivers: [device_watchdog]" in error.value.reason


@pytest.mark.parametrize(("waived", "seconds"), [((), 1.0), (("autonomous_motion",), 7.0)])
def test_px4_with_setpoints_only_needs_no_watchdog_waiver(bench, waived, seconds):
    b = bench(flavour="px4", ttl=0.5, waivers=(*waived, "device_watchdog"))

    async def scenario(fc):
        return await fc.watchdog.seconds(1.0)

    assert b.run(scenario) == seconds
    if not waived:
        bench(flavour="px4", ttl=0.5, waivers=()).run(lambda fc: asyncio.sleep(0.1))


@pytest.mark.parametrize(
    ("ttl", "setpoints", "lost"),
    [(0.1, 0.25, 5), (0.5, 1.0, 5), (4.0, 1.0, 6), (7.0, 1.0, 10)],
)
@pytest.mark.parametrize("state", ["land", "hold", "return"])
def test_px4_setup_acts_on_lost_setpoints_and_permits_a_pilot(bench, state, ttl, setpoints, lost):
    b = bench(flavour="px4", ttl=ttl, safe_state=state, set_up=False)
    b.run(set_up, opened=False)
    assert read(b, "COM_FAIL_ACT_T", "COM_OF_LOSS_T", "COM_DL_LOSS_T") == [0, setpoints, lost]
    assert read(b, "COM_RC_OVERRIDE", "COM_DLL_EXCEPT") == [3, 0]
    assert (
        read(b, "COM_OBL_RC_ACT", "NAV_DLL_ACT") == {"land": [4, 3], "hold": [5, 1], "return": [3, 2]}[state]
    )


def test_px4_setup_keeps_an_enabled_stick_override(bench):
    b = bench(flavour="px4", set_up=False)
    b.autopilot.parameters["COM_RC_OVERRIDE"] = 2
    b.run(set_up, opened=False)
    assert read(b, "COM_RC_OVERRIDE") == [2]


def test_ardupilot_setup_sets_its_station_and_mission_failsafe(bench):
    b = bench(set_up=False, ttl=9.0)
    b.autopilot.parameters.update({"FS_OPTIONS": 2 | 16, "MAV_GCS_SYSID_HI": 255})
    b.run(set_up, opened=False)
    assert read(b, "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "FS_OPTIONS", "FS_GCS_TIMEOUT") == [128, 0, 24, 2]


def test_rover_setup_holds_on_a_failsafe(bench):
    b = bench(kind="rover", ttl=1.5, waivers=(), set_up=False)
    b.run(set_up, opened=False)
    assert read(b, "FS_GCS_ENABLE", "FS_ACTION", "FS_GCS_TIMEOUT", "FS_TIMEOUT") == [1, 2, 2, 1]


def test_setup_writes_the_speed_limit_to_the_autopilot(bench):
    b = bench(limits={"speed": 3.0}, set_up=False)
    b.autopilot.parameters.update({"WPNAV_SPEED": 1000, "RTL_SPEED": 400})
    b.run(set_up, opened=False)
    # RTL_SPEED 0: a return uses WPNAV_SPEED.
    assert read(b, "WPNAV_SPEED", "RTL_SPEED") == [300, 0]
    faster = bench(limits={"speed": 12.0}, set_up=False)
    faster.autopilot.parameters.update({"WPNAV_SPEED": 1000, "RTL_SPEED": 400})
    faster.run(set_up, opened=False)
    assert read(faster, "WPNAV_SPEED", "RTL_SPEED") == [1000, 400]


@on_bench("bench", set_up=False, opened=False)
async def test_setup_reports_a_parameter_that_cannot_be_written(b, fc, /):
    class Fixed(dict):
        def __setitem__(self, name, value):
            if name != "FS_GCS_ENABLE":
                super().__setitem__(name, value)

    b.autopilot.parameters = Fixed(b.autopilot.parameters)
    with pytest.raises(DeviceError, match="FS_GCS_ENABLE could not be set to 5: it is 0"):
        await set_up(fc)


@on_bench("bench")
async def test_settings_are_not_written_while_armed(b, fc, /):
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match="nothing was written: its motors are on"):
        await fc.write_setting("FS_GCS_TIMEOUT", 5.0)
    assert written(b) == []


@on_bench("bench", opened=False)
async def test_open_fails_without_a_reported_failsafe_parameter(b, fc, /):
    without(b, b"FS_GCS_ENABLE")
    with pytest.raises(DeviceError, match="it does not report FS_GCS_ENABLE") as error:
        await fc.open()
    assert error.value.kind == "DeviceTimeoutException"


def test_older_parameter_name_is_found(bench):
    b = bench(set_up=False)
    without(b, b"MAV_GCS_SYSID")
    older = dialect.MAVLink_param_value_message(b"SYSID_MYGCS", 1.0, dialect.MAV_PARAM_TYPE_INT16, 1, 0)

    async def mission(fc):
        loop = asyncio.get_running_loop()
        await fc.find()
        loop.call_later(1.0, lambda: b.links[0].on_data(PacketWriter(1, 1).pack(older)))
        return [str(s) for s in await fc.settings() if "GCS" in s.name]

    assert "SYSID_MYGCS is 1 and must be 128" in b.run(mission, opened=False)


@on_bench("bench", ttl=1.0, waivers=())
async def test_changed_failsafe_parameter_blocks_arming(b, fc, /):
    b.autopilot.parameters["FS_GCS_ENABLE"] = 0
    b.autopilot.parameters["FS_GCS_TIMEOUT"] = 60
    with pytest.raises(DeviceError, match="FS_GCS_ENABLE is 0 and must be 5, and 1 more"):
        await fc.execute("arm", [])
    mismatches = [note for note in b.notes if note.code == "setting-mismatch"]
    assert any("FS_GCS_TIMEOUT is 60 and must be 2" in note for note in mismatches)
    assert not b.autopilot.armed
    assert b.values["gcsFailsafe"] is False
    assert written(b) == []


@pytest.mark.parametrize(("flavour", "ttl", "within"), [("ardupilot", 1.0, 3.0), ("px4", 0.5, 2.0)])
@on_bench("bench", waivers=(), given="flavour ttl")
async def test_autopilot_failsafe_acts_when_the_driver_is_silent(b, fc, /, flavour, ttl, within):
    await up(fc)
    b.driver.quiet()
    sent = len(b.sent)
    await asyncio.sleep(within)
    assert b.autopilot.mode in ("LAND", "AUTO.LAND")
    assert len(b.sent) == sent
    # The safe state is still sent, and heartbeats resume with the owner.
    await fc.make_safe()
    b.driver.resume()
    await asyncio.sleep(1.0)
    assert len(b.sent) > sent


@on_bench("bench", ttl=1.0, waivers=(), faults=("loss=0.2",))
async def test_driver_heartbeats_prevent_the_failsafe_with_losses(b, fc, /):
    await up(fc)
    await asyncio.sleep(60.0)
    assert b.autopilot.mode == "GUIDED"


def test_every_vehicle_kind_has_a_link_timeout():
    for kind, needs in NEEDS.items():
        assert "link" in {need.clock for need in needs}, kind
