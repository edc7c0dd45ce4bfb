"""Control tables and units: the table of every model is consistent, and conversions are reversible."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lfield_dynamixel.bus.error_text import fault_text, has_alert, refusal_text
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.bus.servo_chain import Chain, Node
from lfield_dynamixel.control_tables import Item, Model, models
from lfield_dynamixel.servo import Servo, condition, present

X = models()[2, 1200]
AX = models()[1, 12]
STS = models()[0, 777]
EVERY = pytest.mark.parametrize("model", models().values(), ids=lambda model: model.name)


@EVERY
def test_control_table_is_complete_and_without_overlaps(model: Model):
    vendor = "http://doc.feetech.cn/" if model.protocol == 0 else "https://emanual.robotis.com/docs/en/dxl/"
    assert model.manual.startswith(vendor)
    # In a Feetech servo, goal velocity and profile velocity are the same register.
    places = sorted({(item.address, item.address + item.size) for item in model.items.values()})
    assert all(end <= start for (_, end), (start, _) in pairwise(places))
    needed = {"model_number", "firmware_version", "torque_enable", "goal_position", "profile_velocity"}
    assert needed <= model.items.keys()
    for area, names in ((model.state, ["torque_enable"]), (model.present, ["present_position", "moving"])):
        for item in (model.items[name] for name in names):
            assert area[0] <= item.address
            assert item.address + item.size <= area[0] + area[1]
    assert model.items["torque_enable"].address == model.ram
    assert bool(model.current) == model.has("present_current")
    assert model.has("present_current") == (model.has("goal_current") or model.protocol == 0)


@EVERY
def test_goal_and_profile_are_adjacent_registers(model: Model):
    names = ("profile_acceleration", "profile_velocity", "goal_time", "goal_position")
    items = sorted((model.items[name] for name in names if model.has(name)), key=lambda item: item.address)
    assert all(a.address + a.size == b.address for a, b in pairwise(items))


@pytest.mark.few(4)
@EVERY
@given(angle=st.floats(-2.6, 2.6))
def test_angle_conversion_is_reversible(model: Model, angle: float):
    assert abs(model.to_angle(model.to_counts(angle)) - angle) <= model.position / 2 + 1e-12


@given(st.sampled_from([1, 2, 4]), st.sampled_from(["", "signed"]), st.data())
def test_item_encoding_is_reversible(size, sign, data):
    low, high = (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1) if sign else (0, (1 << 8 * size) - 1)
    value, item = data.draw(st.integers(low, high)), Item(10, size, sign)
    assert item.decode(b"\0\0\0" + item.encode(value), 7) == value
    with pytest.raises(ValueError, match="does not fit"):
        item.encode(high + 1)


@given(
    st.integers(-1023, 1023),
    st.sampled_from([(AX, "present_velocity", 10), (STS, "homing_offset", 11), (STS, "goal_velocity", 15)]),
)
def test_sign_bit_values_are_encoded_and_decoded(value, place):
    model, name, bit = place
    item, raw = model.items[name], value if value >= 0 else -value | 1 << bit
    assert item.decode(raw.to_bytes(2, "little"), item.address) == value
    assert item.encode(value) == raw.to_bytes(2, "little")
    with pytest.raises(ValueError, match="does not fit"):
        item.encode(-(1 << bit))


@pytest.mark.few(4)
@EVERY
@given(data=st.data(), error=st.integers(0, 255))
def test_any_register_bytes_are_decoded(model: Model, data, error):
    size = model.present[1]
    reading = present(model, Status(1, error, data.draw(st.binary(min_size=size, max_size=size))))
    assert math.isfinite(reading.position)
    assert math.isnan(reading.current) == (model.current == 0.0)
    size = model.state[1]
    condition(model, Status(1, error, data.draw(st.binary(min_size=size, max_size=size))))


@given(
    st.floats(-2.0, 2.0), st.floats(0.0, 4.0), st.floats(0.0, 50.0), st.floats(0.0, 500.0), st.booleans(),
    st.sampled_from([X, AX, STS]),
)  # fmt: skip
@example(0.0, 0.0, 1.0, 5e-324, True, X)
def test_any_motion_fits_into_the_registers(angle, distance, speed, acceleration, time_based, model):
    servo = Servo(Chain(None), Node(1))  # type: ignore[arg-type]  # this test sends no packet
    servo.model, servo.time_based = model, time_based and model is X
    start, data = servo.motion(angle, distance, speed, acceleration)
    assert model.items["goal_position"].decode(data, start) == model.to_counts(angle)
    profile = model.items["profile_velocity"].decode(data, start)
    assert 1 <= profile <= model.fastest, "0 would mean no limit"


def test_units_equal_those_of_the_manual():
    # Units of XL330-M288: 0.229 rev/min, 1 mA, 0.1 V; half a turn is 2048.
    data = bytearray(25)
    for name, value in (("present_velocity", -100), ("present_current", 500), ("present_position", 4096)):
        item = X.items[name]
        data[item.address - 122 : item.address - 122 + item.size] = item.encode(value)
    data[22:24] = (74).to_bytes(2, "little")
    data[24] = 41
    reading = present(X, Status(1, 0, bytes(data)))
    assert reading.velocity == pytest.approx(-22.9 * 2 * math.pi / 60)
    assert reading.current == pytest.approx(0.5)
    assert reading.position == pytest.approx(math.pi)
    assert (reading.voltage, reading.temperature) == (pytest.approx(7.4), 41)
    assert AX.to_angle(1023) - AX.to_angle(0) == pytest.approx(math.radians(300))


@given(st.integers(0, 255))
def test_every_error_byte_is_described(error):
    status = Status(1, error, b"")
    assert bool(refusal_text(2, status)) == bool(error & 0x7F)
    assert isinstance(refusal_text(1, status), str)
    assert has_alert(1, status) == bool(error & 0b100101)
    assert has_alert(0, status) == bool(error & 0b101111)
    assert refusal_text(0, status) == ""
    assert has_alert(2, status) == (error >= 0x80)
    assert "overload" in fault_text(2, error | 0x20)


def test_operating_modes_equal_those_of_the_manual():
    assert X.modes == {
        "current": 0,
        "velocity": 1,
        "position": 3,
        "extended": 4,
        "currentPosition": 5,
        "pwm": 16,
    }
