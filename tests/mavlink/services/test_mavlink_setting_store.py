"""A parameter file compared with a vehicle: both fakes, in virtual time."""

from __future__ import annotations

import pytest
from coroutine_tests import on_bench

from lfield.driver.settings import StoredSettings
from lfield.errors import MissionFileError

#: A parameter that no binding needs, by autopilot.
FREE = {"ardupilot": "PILOT_TKOFF_ALT", "px4": "MIS_TAKEOFF_ALT"}
LIMITS = {"altitude": 40.0, "speed": 4.0}


async def compare(fc, text):
    await fc.find()
    assert isinstance(fc, StoredSettings)
    return await fc.compare_settings("f.param", text.encode())


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", given="flavour")
async def test_differences_are_reported_in_file_order(b, fc, /, flavour):
    free, present = FREE[flavour], b.autopilot.parameters[FREE[flavour]]
    system = {"ardupilot": "FS_GCS_ENABLE", "px4": "COM_RC_OVERRIDE"}[flavour]
    same = f"{system},{b.autopilot.parameters[system]:g}\n"
    found = await compare(fc, f"NO_SUCH_NAME,1\n{same}{free},{present + 1:g}\n")
    assert [(change.name, change.present, change.value) for change in found.changes] == [
        (free, present, present + 1)
    ]
    assert found.unknown == ("NO_SUCH_NAME",)
    assert (found.refusals, found.kept) == ((), ())
    assert await fc.stored_settings([free, "NO_SUCH_NAME"]) == {free: present}
    every = list(b.autopilot.parameters)[:40]
    assert await fc.stored_settings(every) == pytest.approx(
        {name: b.autopilot.parameters[name] for name in every}, rel=1e-6
    )


FORBIDDEN = [
    ("ardupilot", "FS_GCS_ENABLE,0"),
    ("ardupilot", "FS_GCS_TIMEOUT,10"),
    ("ardupilot", "MAV_GCS_SYSID,255"),
    ("ardupilot", "WPNAV_SPEED,500"),
    ("ardupilot", "RTL_ALT,6000"),
    ("ardupilot", "FS_GCS_ENABLE,2.5"),
    ("px4", "COM_OBL_RC_ACT,0"),
    ("px4", "COM_OF_LOSS_T,5"),
    ("px4", "MPC_XY_VEL_MAX,12"),
    ("px4", "RTL_RETURN_ALT,60"),
    ("px4", "MAV_SYS_ID,7"),
    ("px4", "COM_DL_LOSS_T,6.5"),
]


@pytest.mark.parametrize(("flavour", "line"), FORBIDDEN)
@on_bench("bench", limits=LIMITS, ttl=1.0, given="flavour")
async def test_value_forbidden_by_the_binding_is_refused(b, fc, /, flavour, line):
    name = line.partition(",")[0]
    found = await compare(fc, line)
    assert [reason for reason in found.refusals if reason.startswith(name)], found


@pytest.mark.parametrize(("flavour", "line"), [("ardupilot", "WPNAV_SPEED,300"), ("px4", "MPC_XY_CRUISE,3")])
@on_bench("bench", limits=LIMITS, given="flavour")
async def test_value_within_the_limits_is_permitted(b, fc, /, flavour, line):
    found = await compare(fc, line)
    assert found.refusals == ()
    assert len(found.changes) == 1


HEADER = "# Stack: {}\n# Vehicle: {}\n"


@pytest.mark.parametrize(
    ("flavour", "head", "is_foreign"),
    [
        ("ardupilot", HEADER.format("PX4 Pro", "Quadrotor"), True),
        ("ardupilot", HEADER.format("ArduPilot", "Ground rover"), True),
        ("ardupilot", HEADER.format("ArduPilot", "Quadrotor"), False),
        ("px4", HEADER.format("ArduPilot", "Quadrotor"), True),
        ("px4", HEADER.format("PX4 Pro", "Fixed Wing"), True),
        ("px4", HEADER.format("PX4 Pro", "Multi-Rotor"), False),
        ("px4", "", False),
        ("px4", "PILOT_TKOFF_ALT,1\nWPNAV_SPEED,1\n", True),
        ("ardupilot", "MPC_XY_CRUISE,1\nMIS_TAKEOFF_ALT,1\n", True),
    ],
)
@on_bench("bench", given="flavour")
async def test_file_of_another_firmware_or_vehicle_is_refused(b, fc, /, flavour, head, is_foreign):
    found = await compare(fc, f"{head}{FREE[flavour]},7\n")
    assert bool(found.refusals) == is_foreign


@on_bench("bench")
async def test_autopilot_owned_and_read_only_values_are_kept(b, fc, /):
    found = await compare(fc, "STAT_BOOTCNT,77\nPILOT_TKOFF_ALT,99 @READONLY\nSERIAL1_PROTOCOL,10\n")
    assert set(found.kept) == {"STAT_BOOTCNT", "PILOT_TKOFF_ALT"}
    assert [change.name for change in found.changes] == ["SERIAL1_PROTOCOL"]
    assert found.restart == ("SERIAL1_PROTOCOL",)


@on_bench("bench")
async def test_malformed_file_is_refused(b, fc, /):
    await fc.find()
    with pytest.raises(MissionFileError):
        await fc.compare_settings("f.param", b"PILOT_TKOFF_ALT,high\n")
