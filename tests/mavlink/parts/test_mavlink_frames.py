"""Position in the team's frame: geodetic, by a pose, before the origin is known, after a restart."""

from __future__ import annotations

import math

import pytest
from coroutine_tests import on_bench
from hypothesis import given
from hypothesis import strategies as st

from lfield.driver import DeviceError, Origin, Placement, Pose
from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.frames import GeodeticFrame, HomeFrame, frame_of
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4, RADII

#: WGS 84 ellipsoid: semi-major axis in metres, squared eccentricity.
AXIS, ECCENTRICITY = 6378137.0, 6.69437999014e-3

latitudes, longitudes = st.floats(-75.0, 75.0), st.floats(-180.0, 180.0)
metres = st.floats(-2000.0, 2000.0)
ways = st.tuples(metres, metres, st.floats(-100.0, 100.0))
radii = st.sampled_from(sorted(RADII.values()))


def in_space(latitude, longitude):
    """Cartesian metres from the centre of the Earth."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    n = AXIS / math.sqrt(1.0 - ECCENTRICITY * math.sin(phi) ** 2)
    across = n * math.cos(phi)
    return (across * math.cos(lam), across * math.sin(lam), n * (1.0 - ECCENTRICITY) * math.sin(phi))


@given(latitude=latitudes, longitude=longitudes, off=ways, place=ways, radius=radii)
def test_conversion_to_the_team_frame_and_back_is_exact(latitude, longitude, off, place, radius):
    team = Origin(latitude, longitude, 100.0)
    frame = GeodeticFrame(team, Place(latitude, longitude, 100.0).shifted(off), radius)
    assert frame.from_team(frame.to_team(place)) == pytest.approx(place, abs=1e-5)


@given(latitude=latitudes, longitude=longitudes, place=ways, radius=radii)
def test_team_frame_metres_are_true_distances(latitude, longitude, place, radius):
    """Compared with straight-line distances, which are at most 1 mm shorter than over ground."""
    team, origin = Origin(latitude, longitude, 0.0), Place(latitude, longitude, 0.0)
    north, east, down = GeodeticFrame(team, origin, radius).to_team(place)
    there = origin.shifted(place, radius)
    straight = math.dist(in_space(latitude, longitude), in_space(there.latitude, there.longitude))
    assert math.hypot(north, east) == pytest.approx(straight, abs=0.001)
    assert down == pytest.approx(place[2])
    assert math.dist((north, east), place[:2]) <= 0.01 * math.hypot(*place[:2]) + 1e-6


@given(latitude=latitudes, longitude=longitudes, spots=st.tuples(ways, ways), place=ways)
def test_autopilots_with_different_radii_agree_on_a_position(latitude, longitude, spots, place):
    team, base = Origin(latitude, longitude, 50.0), Place(latitude, longitude, 50.0)
    one, other = (
        GeodeticFrame(team, base.shifted(position), r)
        for position, r in zip(spots, RADII.values(), strict=True)
    )
    own, others = one.from_team(place), other.from_team(place)
    ones, their = one.origin.shifted(own, one.radius), other.origin.shifted(others, other.radius)
    assert (
        math.dist(in_space(ones.latitude, ones.longitude), in_space(their.latitude, their.longitude)) < 1e-4
    )
    assert ones.altitude == pytest.approx(their.altitude)


def test_heading_is_corrected_for_converging_meridians():
    team = Origin(60.0, 10.0, 0.0)
    east = GeodeticFrame(team, Place(60.0, 10.1, 0.0), AXIS)
    assert east.heading == pytest.approx(-math.radians(0.1) * math.sin(math.radians(60.0)), rel=1e-3)
    ahead, here = east.to_team((100.0, 0.0, 0.0)), east.to_team((0.0, 0.0, 0.0))
    way = math.atan2(ahead[1] - here[1], ahead[0] - here[0])
    assert way == pytest.approx(east.heading, abs=1e-4)


def test_team_frame_crosses_the_date_line():
    frame = GeodeticFrame(Origin(-17.0, 179.9999, 0.0), Place(-17.0, -179.9999, 0.0), AXIS)
    north, east, _ = frame.to_team((0.0, 0.0, 0.0))
    assert (north, east) == pytest.approx((0.0, 21.3), abs=0.1)


def test_invalid_position_stays_invalid():
    frame = HomeFrame(GeodeticFrame(Origin(47.0, 8.0, 0.0), Place(47.0, 8.0, 0.0), AXIS), (0.0, 0.0, 0.0))
    assert not any(map(math.isfinite, frame.from_team((math.nan, math.nan, math.nan))))
    assert frame.from_team((math.inf, 0.0, 0.0))[0] == math.inf


# -- reports of a vehicle --------------------------------------------------------------

TEAM = Placement(Origin(47.0, 8.0, 400.0))


def apply(state, *messages):
    for message in messages:
        state.update(message, 0.0)


def origin(north=0.0, east=0.0):
    place = Place(47.0, 8.0, 400.0).shifted((north, east, 0.0))
    return dialect.MAVLink_gps_global_origin_message(
        round(place.latitude * 1e7), round(place.longitude * 1e7), 400_000, 0
    )


def home(north, east, down):
    place = Place(47.0, 8.0, 400.0).shifted((north, east, down))
    return dialect.MAVLink_home_position_message(
        round(place.latitude * 1e7), round(place.longitude * 1e7), round(place.altitude * 1000),
        0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0,
    )  # fmt: skip


def local(booted, north, east, down):
    return dialect.MAVLink_local_position_ned_message(booted, north, east, down, 0.0, 0.0, 0.0)


@pytest.fixture
def state():
    state = VehicleState("copter")
    state.autopilot = ARDUPILOT
    return state


def test_home_and_origin_may_be_different_positions(state):
    apply(state, origin(100.0, 0.0), home(103.0, 4.0, -2.0), local(5000, 10.0, 0.0, -6.0))
    assert state.position == pytest.approx((7.0, -4.0, -4.0), abs=0.05)
    frame = frame_of(TEAM, state)
    assert frame.to_team(state.position) == pytest.approx((110.0, 0.0, -6.0), abs=0.35)
    moved = frame.to_team(state.position)
    apply(state, home(60.0, 0.0, 0.0))
    assert frame_of(TEAM, state).to_team(state.position) == pytest.approx(moved, abs=0.02)


def test_pose_is_relative_to_the_origin(state):
    placed = Placement(pose=Pose(1.0, 2.0, 3.0))
    apply(state, origin(100.0, 0.0), home(103.0, 4.0, -2.0), local(5000, 10.0, 0.0, -6.0))
    assert frame_of(placed, state).to_team(state.position) == pytest.approx((11.0, 2.0, -3.0))


def test_vehicle_without_reported_origin_has_no_team_position(state):
    apply(state, home(0.0, 0.0, 0.0), local(5000, 10.0, 0.0, 0.0))
    assert frame_of(TEAM, state) is None
    assert frame_of(Placement(pose=Pose(1.0, 2.0)), state) is not None
    apply(state, origin())
    assert frame_of(TEAM, state) is not None


def test_origin_from_before_a_restart_is_discarded(state):
    placed = Placement(pose=Pose(1.0, 2.0))
    apply(state, origin(), home(0.0, 0.0, 0.0), local(60_000, 20.0, 0.0, 0.0))
    # After a restart ArduRover sends positions 11 s before its new origin.
    apply(state, local(900, 0.0, 0.0, 0.0))
    assert frame_of(TEAM, state) is None
    assert frame_of(placed, state) is None
    assert not state.knows_frames
    apply(state, origin(20.0, 0.0), home(20.0, 0.0, 0.0), local(2000, 0.0, 0.0, 0.0))
    assert frame_of(TEAM, state).to_team((0.0, 0.0, 0.0)) == pytest.approx((20.0, 0.0, 0.0), abs=0.1)
    assert frame_of(placed, state).to_team((0.0, 0.0, 0.0)) == pytest.approx((21.0, 2.0, 0.0), abs=0.1)


def test_reordered_packet_is_no_restart(state):
    apply(state, origin(), home(0.0, 0.0, 0.0), local(60_000, 20.0, 0.0, 0.0), local(59_900, 19.0, 0.0, 0.0))
    assert state.knows_frames
    assert frame_of(TEAM, state) is not None


# -- on the wire ----------------------------------------------------------------------


#: 300 m south of the start of the fakes, and 20 m below.
SOUTH = Placement(Origin(47.395044, 8.545594, 468.0))


@pytest.mark.parametrize("stack", ["ardupilot", "px4"])
@on_bench("bench", frame=SOUTH, limits={"radius": 60.0, "altitude": 20.0}, given="flavour=stack")
async def test_goto_uses_the_team_frame(flight, device, /, stack):
    await flight.until(lambda: "position" in flight.values)
    assert flight.values["position"] == pytest.approx([300.0, 0.0, -20.0], abs=0.5)
    assert flight.values["altitude"] == pytest.approx(0.0, abs=0.1)
    await device.execute("arm", [])
    await device.execute("takeoff", [5.0])
    await device.execute("goTo", [310.0, 12.0, -28.0])
    assert flight.autopilot.vehicle.place == pytest.approx((10.0, 12.0, -8.0), abs=0.7)
    assert flight.values["position"] == pytest.approx([310.0, 12.0, -28.0], abs=0.7)
    # Its limits are still relative to home.
    with pytest.raises(DeviceError, match="from home is beyond the limit of 60 m"):
        await device.execute("goTo", [0.0, 0.0, -28.0])


def test_goto_is_refused_until_the_origin_is_reported(bench):
    flight = bench(flavour="px4", frame=SOUTH)
    passed = flight.filter
    hidden = [True]

    def without_origin(link, packet):
        if not (hidden[0] and packet[7] == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN):
            passed(link, packet)

    flight.filter = without_origin

    async def scenario(device):
        await flight.until(lambda: "armed" in flight.values)
        assert "position" not in flight.values
        assert "heading" not in flight.values
        assert any("frame origin unknown" in note for note in flight.notes)
        await device.execute("arm", [])
        await device.execute("takeoff", [4.0])
        with pytest.raises(DeviceError, match="goTo refused: the position in the team's frame is not"):
            await device.execute("goTo", [300.0, 0.0, -24.0])
        hidden[0] = False
        await flight.until(lambda: "position" in flight.values)
        await device.execute("goTo", [304.0, 0.0, -24.0])
        assert flight.values["position"] == pytest.approx([304.0, 0.0, -24.0], abs=0.7)

    flight.run(scenario)


def test_px4_uses_its_own_earth_radius():
    state = VehicleState("copter")
    state.autopilot = PX4
    assert state.radius == 6371000.0
