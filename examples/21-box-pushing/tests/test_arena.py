"""Properties of the plane and its robots, and tests of the driver."""

from __future__ import annotations

import asyncio
import math
from functools import partial
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from lfield_arena import PLUGIN
from lfield_arena.ball import Ball
from lfield_arena.box import FRICTION, MASS, Box
from lfield_arena.driver import ArenaDriver
from lfield_arena.fake import SIM
from lfield_arena.field import GRIP, LAYOUTS, RADIUS, Body, Field, Layout
from lfield_arena.plane import TICK
from lfield_arena.robot import MAX_SPEED, Robot
from lfield_arena.world import PREY_RADIUS, PREY_SPEED, World, escape, flight, is_enclosed

from lfield.driver import DeviceError
from lfield.driver.plugins import Plugins
from lfield.testing.desk import Desk
from lfield.testing.driver_bench import DriverBench, bind

SPEEDS = st.floats(-0.5, 0.5)
VELOCITIES = st.lists(st.tuples(SPEEDS, SPEEDS), min_size=3, max_size=3)


def with_velocities(field, velocities):
    for robot, velocity in zip(field.robots.values(), velocities, strict=True):
        robot.velocity = velocity
    return field


def behind(*offsets):
    """A field whose robots touch the back of a box."""
    places = {number: (-0.35, offset) for number, offset in enumerate(offsets, 1)}
    return Field.from_layout(Layout(places, box=(0.0, 0.0, 0.0)))


# --- the physics ----------------------------------------------------------------------------------


@given(st.lists(VELOCITIES, min_size=1, max_size=40))
@settings(max_examples=50)
def test_energy_is_not_created(steps):
    field = behind(-0.4, 0.0, 0.4)
    for velocities in steps:
        with_velocities(field, velocities)
        before, power = field.box.energy, sum(GRIP * math.hypot(*velocity) for velocity in velocities)
        field.step(TICK)
        # The work of the wheels is at most their grip times their speed; friction only reduces the energy.
        assert field.box.energy <= before + power * TICK + 1e-9


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0))
def test_unpushed_box_comes_to_rest(north, east, spin):
    field = Field.from_layout(Layout({}, box=(0.0, 0.0, 0.0)))
    field.box.speed, field.box.spin = (north, east), spin
    last = field.box.energy
    while last > 0.0:
        field.step(TICK)
        assert field.box.energy < last
        last = field.box.energy
    assert field.now <= 2.0 * MASS / FRICTION


@given(st.floats(0.05, 0.5), st.floats(0.1, 0.45))
@settings(max_examples=30)
def test_symmetric_push_moves_straight(speed, offset):
    field = with_velocities(behind(-offset, 0.0, offset), [(speed, 0.0)] * 3)
    for _ in range(100):
        field.step(TICK)
    assert field.box.north > 0.0
    assert field.box.east == pytest.approx(0.0, abs=1e-9)
    assert field.box.heading == pytest.approx(0.0, abs=1e-9)


@given(st.floats(0.1, 0.5))
def test_unequal_push_turns_the_box_away_from_the_stronger_side(offset):
    field = with_velocities(behind(-offset, 0.0, offset), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.0)])
    for _ in range(100):
        field.step(TICK)
    assert field.box.heading < 0.0, "a push at the right side must turn the box to the left"


def test_push_below_the_friction_moves_nothing():
    field = with_velocities(behind(0.0), [(0.1, 0.0)])
    for _ in range(100):
        field.step(TICK)
    assert (field.box.north, field.box.heading) == (0.0, 0.0)
    assert GRIP < FRICTION


@given(
    st.sampled_from(["box", "hunt"]), st.lists(st.tuples(SPEEDS, SPEEDS), min_size=4, max_size=4), st.data()
)
@settings(max_examples=40, deadline=None)
def test_objects_do_not_overlap(layout, velocities, data):
    field = Field.from_layout(LAYOUTS[layout])
    for prey in field.all_prey:
        prey.place = data.draw(st.tuples(st.floats(0.6, 1.2), st.floats(-1.0, 1.0)))
    for _ in range(300):
        # All robots drive towards the first object.
        for robot, velocity in zip(field.robots.values(), velocities, strict=False):
            goal = field.targets[0]
            robot.velocity = (
                velocity[0] + 0.5 * (goal[0] - robot.place[0]),
                velocity[1] + 0.5 * (goal[1] - robot.place[1]),
            )
        field.step(TICK)
        bodies = [*field.robots.values(), *field.all_prey]
        for index, first in enumerate(bodies):
            for second in bodies[index + 1 :]:
                assert math.dist(first.place, second.place) > first.radius + second.radius - 1e-4
            if field.box is not None:
                assert field.box.touch(first.place, first.radius).gap > -1e-4


@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), max_size=5))
def test_prey_has_its_full_speed_or_stands(hunters):
    speed = math.hypot(*flight((0.0, 0.0), hunters))
    assert speed == 0.0 or speed == pytest.approx(PREY_SPEED)


@given(st.sampled_from(["still", "random", "away", "gap"]), st.integers(0, 50), st.floats(3.0, 12.0))
@settings(max_examples=30, deadline=None)
def test_walls_hold_prey_and_robots(mind, seed, size):
    world = World(size=size, mind=mind, seed=seed, prey=2)
    field = Field.from_layout(LAYOUTS["hunt"].of_world(world), world)
    for robot in field.robots.values():
        robot.velocity = (0.4, 0.3)
    for _ in range(400):
        field.step(TICK)
    for body in (*field.robots.values(), *field.all_prey):
        assert max(map(abs, body.place)) <= size / 2.0 + 1e-3


def test_escape_strategies_of_prey():
    hunters = [(1.0, 0.0), (0.9, 0.8)]
    assert escape(World(mind="still"), (0.0, 0.0), hunters, 0.0, 0) == (0.0, 0.0)
    assert escape(World(mind="away"), (0.0, 0.0), hunters, 0.0, 0) == pytest.approx((-PREY_SPEED, 0.0))
    assert escape(World(), (0.0, 0.0), hunters, 0.0, 0) == pytest.approx(flight((0.0, 0.0), hunters))
    assert 0.0 in escape(World(prey_moves=4), (0.0, 0.0), hunters, 0.0, 0)
    random = World(mind="random", seed=3)
    velocities = [escape(random, (0.0, 0.0), [], now, 0) for now in (0.5, 0.6, 1.5)]
    assert velocities[0] == velocities[1] != velocities[2]
    assert math.hypot(*velocities[0]) == pytest.approx(PREY_SPEED)


def test_enclosed_prey_is_removed_if_there_are_several():
    around = [(0.35 * math.cos(turn), 0.35 * math.sin(turn)) for turn in (0.0, 1.6, 3.2, 4.8)]
    assert is_enclosed((0.0, 0.0), [(place, RADIUS) for place in around])
    assert not is_enclosed((0.0, 0.0), [(place, RADIUS) for place in around[:2]])
    for places, caught in (([(0.0, 0.0), (9.0, 9.0)], True), ([(0.0, 0.0)], False)):
        robots = dict(enumerate(around))
        field = Field.from_layout(Layout(robots, prey=tuple(places)))
        for _ in range(100):
            field.step(TICK)
        assert field.all_prey[0].caught is caught
    assert PREY_RADIUS < RADIUS + PREY_RADIUS


@pytest.mark.parametrize(
    "text", ["size", "size=x", "mind=clever", "moves=3", "prey=0", "colour=1", "predators=10"]
)
def test_invalid_world_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        World.parse(text)


def test_robot_moving_along_the_axes_reaches_its_goal():
    world = World(moves=4)
    field = Field.from_layout(Layout({1: (0.0, 0.0)}, prey=((5.0, 5.0),)), world)
    robot = Robot(field, 1)
    robot.answer("go 0.7 -0.4 0.5")
    places = []
    for _ in range(400):
        robot.step(TICK)
        field.step(TICK)
        places.append(field.robots[1].place)
    assert math.dist(places[-1], (0.7, -0.4)) < 0.02
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(places)]
    assert all(min(abs(north), abs(east)) < 1e-12 for north, east in steps)


def test_prey_flees_from_one_hunter_and_between_three():
    assert flight((0.0, 0.0), [(1.0, 0.0)]) == pytest.approx((-PREY_SPEED, 0.0))
    assert flight((0.0, 0.0), [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0)]) == pytest.approx((-PREY_SPEED, 0.0))
    assert flight((0.0, 0.0), [(1.5, 0.0)]) == (0.0, 0.0), "a distant hunter must not matter"


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi))
def test_contact_normal_points_into_the_box(north, east, heading):
    box = Box(0.0, 0.0, heading)
    contact = box.touch((north, east), RADIUS)
    assume(contact.gap > 0.002 - RADIUS)
    assert math.hypot(*contact.normal) == pytest.approx(1.0)
    moved = north + 0.001 * contact.normal[0], east + 0.001 * contact.normal[1]
    assert box.touch(moved, RADIUS).gap < contact.gap


# --- the robot's controller -----------------------------------------------------------------------


@given(
    st.text(max_size=30)
    | st.sampled_from(["go 1 nan 1", "go 1 2", "drive 1e999 0", "watchdog x", "?", "stop"])
)
def test_any_request_gets_a_one_line_answer(line):
    robot = Robot(Field({1: Body((0.0, 0.0))}), 1)
    assert "\n" not in robot.answer(line)
    assert robot.answer(line)


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_robot_never_exceeds_its_maximum_speed(north, east):
    robot = Robot(Field({1: Body((0.0, 0.0))}), 1)
    for request in (f"drive {north} {east}", f"go {north} {east} 9"):
        robot.answer(request)
        robot.step(TICK)
        assert math.hypot(*robot.body.velocity) <= MAX_SPEED + 1e-9


def test_watchdog_stops_a_robot_without_requests():
    field = Field({1: Body((0.0, 0.0))})
    robot = Robot(field, 1)
    robot.answer("watchdog 0.5")
    robot.answer("drive 0.1 0")
    for _ in range(200):
        robot.step(TICK)
        field.step(TICK)
    assert field.robots[1].place[0] == pytest.approx(0.05, abs=0.002)


# --- the driver -----------------------------------------------------------------------------------


class Wire:
    """A robot with a connection in memory. `cut` drops requests; `state` replaces the answers to `?`."""

    def __init__(self):
        self.field, self.cut, self.state = Field.from_layout(LAYOUTS["hunt"]), False, None
        self.robot = Robot(self.field, 1)

    async def run(self):
        while True:
            await asyncio.sleep(TICK)
            self.robot.step(TICK)
            self.field.step(TICK)

    async def connect(self, host, port, *, limit):
        self.reader = asyncio.StreamReader(limit)
        return self.reader, self

    def write(self, data):
        if not self.cut:
            line = data.decode().strip()
            answer = self.state if self.state and line == "?" else self.robot.answer(line)
            self.reader.feed_data(f"{answer}\n".encode())

    def close(self):
        pass


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def bench(wire):
    binding = bind(PLUGIN, endpoint="tcp:memory:1", limits={"speed": 0.4, "radius": 5.0})
    return DriverBench(PLUGIN, binding, make=partial(ArenaDriver, connect=wire.connect), fakes=[wire.run])


def test_drive_to_returns_true_at_the_goal(bench, wire):
    async def scenario(robot):
        assert await robot.execute("driveTo", [0.5, -1.0, 5.0]) is True
        assert wire.robot.body.place == pytest.approx((0.5, -1.0), abs=0.011)
        assert bench.values["position"] == pytest.approx([0.5, -1.0], abs=0.011)
        assert bench.values["target"][0] == pytest.approx(1.6, abs=0.2)

    bench.run(scenario)


def test_drive_to_stops_the_robot_when_the_time_is_over(bench, wire):
    async def scenario(robot):
        assert await robot.execute("driveTo", [3.0, -1.2, 1.0]) is False
        assert 0.3 < wire.robot.body.place[0] < 0.5  # after 1 s at 0.4 m/s
        await bench.until(lambda: robot.moving() == "")

    bench.run(scenario)


def test_driver_kicks_and_reports_the_score(bench, wire):
    async def scenario(robot):
        wire.field.ball = Ball((0.0, 5.0))
        assert await robot.execute("kick", [1.0]) is False
        place = wire.robot.body.place
        wire.field.ball = Ball((place[0] + 0.22, place[1]), goals=[2, 1])
        assert await robot.execute("kick", [1.0]) is True
        assert wire.field.ball.speed[0] > 0.9
        await bench.until(lambda: bench.values["match"][1:] == [2, 1])

    bench.run(scenario)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (("driveTo", [math.nan, 0.0, 1.0]), "numbers must be finite"),
        (("driveTo", [4.0, 4.0, 1.0]), "outside the radius of 5 m"),
        (("setVelocity", [0.4, 0.4]), "above its limit of 0.4"),
        (("setVelocity", [math.inf, 0.0]), "numbers must be finite"),
    ],
)
def test_command_beyond_a_limit_is_refused(bench, wire, call, message):
    async def scenario(robot):
        with pytest.raises(DeviceError, match=message):
            await robot.execute(*call)
        assert wire.robot.body.velocity == (0.0, 0.0)

    bench.run(scenario)


def test_motor_fault_in_motion_is_an_error(bench, wire):
    async def scenario(robot):
        asyncio.get_running_loop().call_later(0.5, wire.robot.answer, "wrong 1 1")
        with pytest.raises(DeviceError, match="its motors are off: a fault"):
            await robot.execute("driveTo", [3.0, 0.0, 10.0])
        with pytest.raises(DeviceError, match="its motors are off: a fault"):
            await robot.execute("setVelocity", [0.1, 0.0])

    bench.run(scenario)


def test_loss_and_recovery_of_the_connection_are_logged(bench, wire):
    async def scenario(robot):
        wire.cut = True
        with pytest.raises(DeviceError, match="no answer"):
            await robot.execute("driveTo", [1.0, 0.0, 1.0])
        await bench.until(lambda: any(note.startswith("lost: ") for note in bench.notes))
        assert robot.moving() == "no message"
        wire.cut = False
        await bench.until(lambda: bench.notes[-1] == "it responds again")

    bench.run(scenario)


@pytest.mark.parametrize("state", ["north 1", "what?", "north x east 2", "north nan east 2 moving 0"])
def test_invalid_state_is_an_error(bench, wire, state):
    async def scenario(robot):
        wire.state = state
        with pytest.raises(DeviceError, match="its state is invalid"):
            await robot.make_safe()

    bench.run(scenario)


def test_arena_driver_passes_the_kit():
    plugins = Plugins()
    plugins.add("lfield_arena:PLUGIN")
    desk = Desk(plugins=plugins)
    fake = desk.fake(SIM, "--plane", "hunt")
    results = desk.try_kit(bind(PLUGIN, endpoint=fake.endpoint))
    assert [f"{r.check}: {r.seen}" for r in results if r.outcome == "failed"] == []
