"""Joints: names, directions, offsets, bounds, and calibration files of LeRobot."""

from __future__ import annotations

import json
import math

import msgspec
import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call
from hypothesis import given
from hypothesis import strategies as st

from lfield.driver import DeviceBinding
from lfield.errors import DeviceError, DeviceNotSetUp
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.control_tables import models
from lfield_dynamixel.joints.calibration import JointCalibration, parsed
from lfield_dynamixel.joints.mounting import Joint

COUNT = math.tau / 4096
PAN = {"id": 1, "drive_mode": 0, "homing_offset": 120, "range_min": 1000, "range_max": 3000}
LIFT = {"id": 2, "drive_mode": 0, "homing_offset": -300, "range_min": 1200, "range_max": 2500}
BOTH = {"pan": PAN, "lift": LIFT}


@pytest.fixture
def file(tmp_path):
    """A function that writes a calibration file and returns its path."""

    def write(joints: object) -> str:
        path = tmp_path / "arm.json"
        path.write_text(json.dumps(joints))
        return str(path)

    return write


def arm(
    calibration: str = "", *, set_up: object = None, fake: str = "STS3215", protocol: int = 0, **more
) -> Bench:
    """A bench with two servos. `set_up` contains calibration entries that the servos have stored."""
    bench = Bench(
        1, 2, fake=fake, protocol=protocol, waivers=["device_watchdog"], calibration=calibration, **more
    )
    for entry in set_up or ():
        values = entry["drive_mode"], entry["homing_offset"], entry["range_min"], entry["range_max"]
        bench.servos[entry["id"]].calibrate(*values)
    return bench


# ---- files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joints", "sentence"),
    [
        ({"pan": PAN | {"range_min": 3000, "range_max": 1000}}, "joint 'pan': its range is reversed"),
        ({"pan": PAN | {"range_max": 1000}}, "joint 'pan': its range is empty"),
        ({"pan": PAN, "lift": LIFT | {"id": 1}}, "two joints have the servo id 1"),
        ({"pan": {**PAN, "speed": 1}}, "unknown field `speed`"),
        ({"pan": {"id": 1}}, "missing required field `drive_mode`"),
        ({"pan": PAN | {"id": "1"}}, "Expected `int`, got `str` - at `$[...].id`"),
        ({"pan": PAN | {"drive_mode": 2}}, "Expected `int` <= 1"),
        ({"pan\x1b[2J": PAN}, r"joint 'pan\x1b[2J': its name is not printable"),
        ({}, "it has no joints"),
        ([], "Expected `object`, got `array`"),
        (
            {"motor_names": ["pan"], "homing_offset": [1]},
            "it is of an older LeRobot: run lerobot-calibrate again",
        ),
    ],
)
def test_invalid_calibration_file_is_refused(joints, sentence):
    with pytest.raises(DeviceError) as error:
        parsed("arm.json", json.dumps(joints).encode())
    assert sentence in error.value.reason


def test_all_errors_of_a_calibration_are_reported_at_once():
    wrong = {"pan": PAN | {"range_min": 3000, "range_max": 1}, "lift": LIFT | {"range_max": 1200, "id": 1}}
    with pytest.raises(DeviceError) as error:
        parsed("arm.json", json.dumps(wrong).encode())
    assert error.value.reason.count(";") == 4


def test_repeated_joint_is_refused_and_a_byte_order_mark_is_accepted():
    entry = b'{"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 1, "range_max": 9}'
    assert set(parsed("arm.json", b'\xef\xbb\xbf{"pan": ' + entry + b"}")) == {"pan"}
    with pytest.raises(DeviceError, match="'pan' is written twice"):
        parsed("arm.json", b'{"pan": ' + entry + b', "pan": ' + entry.replace(b"1,", b"2,", 1) + b"}")


@given(st.binary() | st.text().map(str.encode))
def test_any_bytes_are_a_calibration_or_an_error(data):
    try:
        joints = parsed("arm.json", data)
    except DeviceError:
        return
    assert all(entry.range_min < entry.range_max for entry in joints.values())


# ---- bindings ---------------------------------------------------------------------------------------------


def conflicts(*bindings: DeviceBinding) -> list[str]:
    return [conflict for _, conflict in PLUGIN.conflicts_of(bindings)]


def bound(calibration: str = "", **options) -> DeviceBinding:
    return arm(calibration, **options).binding


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"names": ["pan"]}, "'names' must be 2 different names, one for each id"),
        ({"names": ["pan", "pan"]}, "'names' must be 2 different names"),
        ({"offset": [0.1, 0.2, 0.3]}, "'offset' must be one value for all, or 2, one for each id, not 3"),
        ({"direction": [1, 0]}, "servo 2: 'direction' must be 1 or -1"),
        ({"lowest": [0.0, 1.0], "highest": [0.5]}, "'lowest' not above 'highest'; they are 1, 0, 1 and 0.5"),
        ({"offset": [math.inf]}, "'offset' a number"),
        ({"ids": [1, 1]}, "its binding names servo 1 twice; give each servo its own id"),
    ],
)
def test_invalid_joint_option_is_a_conflict(options, sentence):
    (conflict,) = conflicts(bound(**options))
    assert sentence in conflict


def test_calibration_that_does_not_match_the_joints_is_a_conflict(file):
    (conflict,) = conflicts(bound(file({"pan": PAN})))
    assert conflict.endswith("arm.json: it has no joint of servo 2")
    (conflict,) = conflicts(bound(file(BOTH), names=["lift", "pan"]))
    assert "servo 1 is the joint 'pan' in it, but the binding says 'lift'" in conflict
    (conflict,) = conflicts(bound("/nowhere/arm.json"))
    assert conflict == "/nowhere/arm.json cannot be read: No such file or directory"
    assert conflicts(bound(file(BOTH), names=["pan", "lift"])) == []


def test_servo_in_two_bindings_is_a_conflict():
    first = bound()
    other = msgspec.structs.replace(first, field="hand")
    assert conflicts(first, other) == [
        f"servo {number} on {first.endpoint} already belongs to alpha.joint" for number in (1, 2)
    ]
    assert conflicts(first, msgspec.structs.replace(first, agent="bravo")) == [], (
        "agents of different hosts may use the same endpoint"
    )


# ---- servos -----------------------------------------------------------------------------------------------


@given(
    st.sampled_from([1, -1]), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)
)  # fmt: skip
def test_joint_angles_are_reversible(direction, zero, offset, angle):
    joint = Joint(1, "pan", direction, zero, offset)
    assert joint.to_joint(joint.to_servo(angle)) == pytest.approx(angle, abs=1e-9)


@on_bench(
    arm, names=["pan", "lift"], direction=[1, -1], offset=[0.0, 0.3], lowest=[-1.0, -0.5], highest=[1.0, 0.9],
    limits={"speed": 3.0},
)  # fmt: skip
async def test_each_joint_has_its_own_direction_offset_and_bounds(bench, group, /):
    await call(group, "torque", True)
    await call(group, "moveTo", [0.5, 0.8])
    assert bench.values["positions"] == pytest.approx([0.5, 0.8], abs=0.01)
    assert [servo.table["goal_position"] for servo in bench.servos.values()] == [
        2048 + round(0.5 / COUNT), 2048 - round(0.5 / COUNT),
    ]  # fmt: skip
    with pytest.raises(
        DeviceError, match=r"moveTo refused: servo 2 \(lift\): 0.95 rad is outside -0.5 to 0.9 rad"
    ):
        await call(group, "moveTo", [0.5, 0.95])
    with pytest.raises(DeviceError, match=r"servo 1 \(pan\): -1.1 rad is outside -1 to 1 rad"):
        await call(group, "setPositions", [-1.1, 0.0])
    await call(group, "moveJoint", "lift", -0.4)
    assert bench.values["positions"] == pytest.approx([0.5, -0.4], abs=0.01)
    assert bench.values["velocities"] == pytest.approx([0.0, 0.0], abs=0.1)
    with pytest.raises(DeviceError, match=r"there is no joint 'elbow'; there are: pan, lift"):
        await call(group, "moveJoint", "elbow", 0.0)


def reversed_servo(**more) -> Bench:
    return Bench(
        1, fake="XL330-M288", direction=-1, offset=0.2, limits={"current": 0.5, "speed": 3.0}, **more
    )


@on_bench(reversed_servo)
async def test_all_quantities_of_a_reversed_servo_are_reversed(bench, servo, /):
    await call(servo, "setRange", -1.0, 0.5)
    table = bench.servos[1].table
    assert (table["min_position_limit"], table["max_position_limit"]) == (
        2048 + round(-0.3 / COUNT), 2048 + round(1.2 / COUNT),
    )  # fmt: skip
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=r"only moves from -1.000 to 0.501"):
        await call(servo, "moveTo", 0.7)
    await call(servo, "moveTo", 0.4)
    assert bench.values["position"] == pytest.approx(0.4, abs=0.02)
    await call(servo, "calibrate", 0.0)
    assert (await servo.servo.present()).position == pytest.approx(0.0, abs=0.02)
    await call(servo, "mode", "velocity")
    for _ in range(5):
        await call(servo, "setVelocity", 1.0)
        await servo.poll()
    assert bench.values["velocity"] == pytest.approx(1.0, abs=0.1)
    assert table["goal_velocity"] < 0


def test_calibrated_angles_and_bounds_equal_those_of_lerobot(file):
    async def scenario(group):
        assert [servo.joint.name for servo in group.servos.values()] == ["pan", "lift"]
        start = await group.observe()
        assert [value.position for value in start.values()] == pytest.approx([0.0, 0.0], abs=COUNT)
        await call(group, "torque", True)
        await call(group, "moveTo", [0.5, -0.5])
        counts = [servo.table["present_position"] for servo in bench.servos.values()]
        assert counts == pytest.approx([2000 + 0.5 / COUNT, 1850 - 0.5 / COUNT], abs=2)
        bounds = [(joint.lowest, joint.highest) for joint in (s.joint for s in group.servos.values())]
        assert bounds == [
            pytest.approx((-1000 * COUNT, 1000 * COUNT)),
            pytest.approx((-650 * COUNT, 650 * COUNT)),
        ]
        with pytest.raises(
            DeviceError, match=r"servo 2 \(lift\): 1 rad is outside -0.997088 to 0.997088 rad"
        ):
            await call(group, "moveTo", [0.0, 1.0])

    bench = arm(file(BOTH), set_up=BOTH.values())
    bench.run(scenario)


def test_reversed_joint_turns_in_the_other_direction(file):
    async def scenario(group):
        await call(group, "torque", True)
        await call(group, "moveTo", [0.0, 0.5])
        assert bench.servos[2].table["present_position"] == pytest.approx(1850 - 0.5 / COUNT, abs=2)

    joints = {"pan": PAN, "lift": LIFT | {"drive_mode": 1}}
    bench = arm(file(joints), set_up=joints.values())
    bench.run(scenario)


@pytest.mark.parametrize(("fake", "protocol"), [("STS3215", 0), ("XL330-M288", 2)])
def test_calibration_of_another_arm_is_refused_and_set_up_writes_it(file, fake, protocol):
    bench = arm(file(BOTH), fake=fake, protocol=protocol)

    async def scenario(group):
        with pytest.raises(
            DeviceNotSetUp, match=r"homing_offset of servo 1 is 0 and must be 120, and 5 more"
        ):
            await group.open()
        assert any(
            "calibration of lift in arm.json; check that the file is of this servo" in n for n in bench.notes
        )
        for setting in await group.settings():
            await group.write_setting(setting.name, setting.wanted)
        await group.open()
        assert [servo.table["max_position_limit"] for servo in bench.servos.values()] == [3000, 2500]

    bench.run(scenario, opened=False)


def test_drive_mode_of_a_reversed_dynamixel_servo_is_checked(file):
    joints = {"pan": PAN | {"drive_mode": 1}, "lift": LIFT}
    bench = arm(file(joints), set_up=joints.values(), fake="XL330-M288", protocol=2)
    bench.servos[1].table.put("drive_mode", 0)

    async def scenario(group):
        with pytest.raises(DeviceNotSetUp, match=r"drive_mode of servo 1 is 0 and must be 1$"):
            await group.open()

    bench.run(scenario, opened=False)


@pytest.mark.parametrize(
    ("fake", "protocol", "entry"),
    [
        ("STS3215", 0, {"range_max": 5000}),
        ("STS3215", 0, {"homing_offset": 2048}),
        ("AX-12A", 1, {"range_max": 900, "range_min": 10}),
    ],
)
def test_calibration_of_another_model_is_refused(file, fake, protocol, entry):
    bench = arm(file({"pan": PAN | entry, "lift": LIFT}), fake=fake, protocol=protocol)

    async def scenario(group):
        with pytest.raises(DeviceError, match=rf"servo 1 \(pan\): its calibration is not of a {fake}"):
            await group.open()

    bench.run(scenario, opened=False)


def test_calibration_narrows_the_bounds_of_the_binding():
    entry = JointCalibration(id=1, drive_mode=0, homing_offset=0, range_min=1048, range_max=3048)
    fitted = Joint(1, lowest=-0.2, highest=9.0, calibration=entry).fitted(models()[0, 777])
    assert (fitted.lowest, fitted.highest) == (-0.2, pytest.approx(1000 * COUNT))
