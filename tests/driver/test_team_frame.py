"""The frame of the team: conversion of poses, telemetry and arguments of a device."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.clock import ManualClock
from lfield.driver import Device, DeviceBinding, DeviceError, Placement, Pose
from lfield.driver.frame import rotated
from lfield.driver.manifest_file import load_manifest
from lfield.errors import PluginError
from lfield.testing.kept_reports import KeptReports

MANIFEST = b"""
driver: cart
type: Cart
meaning: a cart on a floor
safe_states: [stop]
instructions:
  goTo:
    parameters: {north: {type: real, unit: m, frame: place}, east: {type: real, unit: m, frame: place}}
    blocking: true
    cancel: never
  fly:
    parameters:
      speed: {type: real}
      north: {type: real, unit: m, frame: place}
      east: {type: real, unit: m, frame: place}
      down: {type: real, unit: m, frame: place}
      heading: {type: real, unit: rad, frame: heading}
      drift: {type: "real[]", unit: m/s, frame: direction}
      path: {type: "real[]", unit: m, frame: place}
    blocking: true
    cancel: never
  wait: {parameters: {seconds: {type: real}}, blocking: true, cancel: never}
telemetry:
  position: {type: "real[]", unit: m, frame: place}
  velocity: {type: "real[]", unit: m/s, frame: direction}
  attitude: {type: "real[]", unit: rad, frame: heading}
  heading: {type: real, unit: rad, frame: heading}
  battery: {type: real}
"""

#: The device's north is the team's east.
EAST = Pose(10.0, 20.0, -1.0, math.pi / 2)


class Cart(Device):
    """A device that stores the arguments of its last instruction."""

    def __init__(self, placement):
        binding = DeviceBinding(
            agent="a", field="f", type="Cart", driver="cart", endpoint="x", safe_state="stop", frame=placement
        )
        self.reports = KeptReports()
        self.arguments = None
        super().__init__(binding, load_manifest("cart.yaml", MANIFEST), ManualClock(), self.reports)

    async def do_go_to(self, north, east):
        self.arguments = (north, east)

    async def do_fly(self, *values):
        self.arguments = values

    async def do_wait(self, seconds):
        self.arguments = (seconds,)


def run(cart, name, *values):
    asyncio.run(cart.execute(name, values))
    return cart.arguments


metres = st.floats(-1e4, 1e4)
vectors = st.tuples(metres, metres, metres)
poses = st.builds(Pose, metres, metres, metres, st.floats(-math.tau, math.tau))


@given(pose=poses, place=vectors)
def test_pose_conversion_and_back_is_exact(pose, place):
    assert pose.from_team(pose.to_team(place)) == pytest.approx(place, abs=1e-8)


@given(pose=poses, one=vectors, other=vectors)
def test_pose_keeps_distances(pose, one, other):
    assert math.dist(pose.to_team(one), pose.to_team(other)) == pytest.approx(math.dist(one, other), abs=1e-8)


@given(vector=vectors, heading=st.floats(-math.tau, math.tau))
def test_rotation_turns_a_vector_by_the_heading(vector, heading):
    north, east, down = rotated(vector, heading)
    assert math.hypot(north, east) == pytest.approx(math.hypot(*vector[:2]), abs=1e-8)
    assert down == vector[2]
    if math.hypot(north, east) > 1e-3:
        turn = math.atan2(east, north) - math.atan2(vector[1], vector[0]) - heading
        assert math.remainder(turn, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_arguments_are_converted_from_the_team_frame():
    cart = Cart(Placement(pose=EAST))
    # The point 3 m east of (10, 20) in the team's frame is 3 m north of the device in its own frame.
    assert run(cart, "goTo", 10.0, 23.0) == pytest.approx((3.0, 0.0))
    arguments = run(
        cart, "fly", 0.5, 10.0, 20.0, -6.0, math.pi, [1.0, 0.0, 2.0], [10.0, 21.0, -1.0, 9.0, 20.0, 0.0]
    )
    assert arguments[:5] == pytest.approx((0.5, 0.0, 0.0, -5.0, math.pi / 2))
    assert arguments[5] == pytest.approx([0.0, -1.0, 2.0])
    assert arguments[6] == pytest.approx([1.0, 0.0, 0.0, 0.0, 1.0, 1.0])
    assert run(cart, "wait", 2.5) == (2.5,)


def test_telemetry_is_converted_to_the_team_frame():
    cart = Cart(Placement(pose=EAST))
    cart.publish(position=[3.0, 0.0, 0.0], velocity=[1.0, 0.0, 0.5], heading=6.0, battery=0.5)
    cart.publish(attitude=[0.1, 0.2, math.pi - 0.1])
    found = cart.reports.values
    assert found["position"] == pytest.approx([10.0, 23.0, -1.0])
    assert found["velocity"] == pytest.approx([0.0, 1.0, 0.5])
    assert found["heading"] == pytest.approx((6.0 + math.pi / 2) % math.tau)
    assert found["attitude"] == pytest.approx([0.1, 0.2, -math.pi / 2 - 0.1])
    assert found["battery"] == 0.5


@given(pose=poses, place=vectors)
def test_position_of_another_device_as_a_goal_is_the_same_point(pose, place):
    one, other = Cart(Placement(pose=EAST)), Cart(Placement(pose=pose))
    one.publish(position=list(place))
    arguments = run(other, "goTo", *one.reports.values["position"][:2])
    goal = pose.to_team((*arguments, 0.0))
    assert goal[:2] == pytest.approx(EAST.to_team(place)[:2], abs=1e-7)


def test_values_without_a_frame_are_unchanged():
    cart = Cart(None)
    cart.publish(position=[3.0, 0.0, 0.0], heading=6.0)
    assert cart.reports.values == {"position": [3.0, 0.0, 0.0], "heading": 6.0}
    assert run(cart, "goTo", 10.0, 23.0) == (10.0, 23.0)


def test_unknown_placement_publishes_no_position_and_refuses_goals():
    cart = Cart(Placement())
    cart.publish(position=[0.0, 0.0, 0.0], heading=0.0, battery=0.5)
    assert cart.reports.values == {"battery": 0.5}
    with pytest.raises(DeviceError, match=r"goTo refused: the position in the team's frame is not known yet"):
        run(cart, "goTo", 0.0, 0.0)
    assert cart.arguments is None
    assert run(cart, "wait", 2.5) == (2.5,)


def test_frame_of_a_non_real_type_is_refused():
    wrong = MANIFEST.replace(b"battery: {type: real}", b"battery: {type: int, frame: place}")
    with pytest.raises(PluginError, match="the type int cannot be a place"):
        load_manifest("cart.yaml", wrong)
    with pytest.raises(PluginError, match="'frame' must be one of place, direction, heading"):
        load_manifest("cart.yaml", MANIFEST.replace(b"frame: heading", b"frame: hedding"))


def test_manifest_reports_whether_it_has_positions():
    assert load_manifest("cart.yaml", MANIFEST).has_places
    assert not load_manifest("cart.yaml", MANIFEST.replace(b", frame: ", b", meaning: ")).has_places
