"""Properties of the ball and the pitch of examples/23-soccer."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lfield_arena.ball import (
    BALL_RADIUS,
    GOAL,
    LENGTH,
    MAX_KICK_SPEED,
    PAUSE,
    REACH,
    ROLLING_FRICTION,
    WIDTH,
    Ball,
)
from lfield_arena.field import LAYOUTS, RADIUS, Body, Field
from lfield_arena.plane import TICK
from lfield_arena.referee import Referee
from lfield_arena.robot import Robot
from lfield_arena.world import World

COORDINATES = st.tuples(st.floats(-1.9, 1.9), st.floats(-1.4, 1.4))
SPEEDS = st.tuples(st.floats(-MAX_KICK_SPEED, MAX_KICK_SPEED), st.floats(-MAX_KICK_SPEED, MAX_KICK_SPEED))
#: For each robot, its target, and whether the robot always kicks.
COMMANDS = st.lists(st.tuples(COORDINATES, st.booleans()), min_size=6, max_size=6)


def on_pitch(ball):
    """Whether the ball is within the walls, or between the posts of a goal."""
    north, east = abs(ball.place[0]), abs(ball.place[1])
    between = east <= GOAL / 2.0 - BALL_RADIUS + 1e-9
    return east <= WIDTH / 2.0 - BALL_RADIUS + 1e-9 and (
        north <= LENGTH / 2.0 - BALL_RADIUS + 1e-9 or between
    )


@given(COORDINATES, SPEEDS)
def test_free_ball_stays_on_the_pitch_and_comes_to_rest(place, speed):
    ball = Ball(place, speed)
    fast = math.hypot(*speed)
    for _ in range(1 + round(fast / ROLLING_FRICTION / TICK)):
        ball.step(TICK)
        assert on_pitch(ball)
        assert math.hypot(*ball.speed) <= max(0.0, fast - ROLLING_FRICTION * TICK) + 1e-9
        fast = math.hypot(*ball.speed)
    assert fast == pytest.approx(0.0, abs=1e-6)


@given(COORDINATES, SPEEDS, COMMANDS)
@settings(max_examples=40, deadline=None)
def test_ball_leaves_only_through_a_goal_and_never_overlaps_a_robot(place, speed, commands):
    field = Field.from_layout(LAYOUTS["pitch"])
    field.ball.place, field.ball.speed = place, speed
    robots = [Robot(field, number) for number in field.robots]
    for robot, ((north, east), _) in zip(robots, commands, strict=True):
        robot.answer(f"go {north} {east} 0.5")
    overlaps = 0
    for _ in range(300):
        before = sum(field.ball.goals)
        for robot, (_, kicks) in zip(robots, commands, strict=True):
            if kicks:
                robot.answer("kick 2")
            robot.step(TICK)
        field.step(TICK)
        assert on_pitch(field.ball)
        assert (sum(field.ball.goals) > before) == (field.ball.pause == PAUSE)
        gap = min(field.ball.touch(body.place, RADIUS)[0] for body in field.robots.values())
        overlaps = overlaps + 1 if gap < -1e-3 and not field.ball.pause else 0
        assert overlaps < 5, "an overlap must be shorter than 50 ms"


@given(COORDINATES, SPEEDS)
@settings(max_examples=50)
def test_standing_robots_add_no_energy_to_the_ball(place, speed):
    field = Field.from_layout(LAYOUTS["pitch"])
    field.ball.place, field.ball.speed = place, speed
    for _ in range(300):
        fast = math.hypot(*field.ball.speed)
        field.step(TICK)
        assert math.hypot(*field.ball.speed) <= fast + 1e-9


@pytest.mark.parametrize(("sign", "goals"), [(1.0, [1, 0]), (-1.0, [0, 1])])
def test_goal_counts_once_and_the_ball_returns_to_the_middle(sign, goals):
    ball = Ball((1.8 * sign, 0.3), (1.5 * sign, 0.0))
    for _ in range(round(PAUSE / TICK)):
        ball.step(TICK)
    assert (ball.goals, abs(ball.place[0]) > LENGTH / 2.0) == (goals, True)
    for _ in range(100):
        ball.step(TICK)
    assert (ball.goals, ball.place, ball.speed) == (goals, (0.0, 0.0), (0.0, 0.0))


@given(st.floats(-math.pi, math.pi), st.floats(0.0, REACH - 1e-6), st.floats(-1.0, 5.0))
def test_kick_moves_the_ball_away_from_the_robot(bearing, gap, speed):
    distance = RADIUS + BALL_RADIUS + gap
    ball = Ball((distance * math.cos(bearing), distance * math.sin(bearing)))
    assert ball.kick((0.0, 0.0), RADIUS, speed)
    fast = min(MAX_KICK_SPEED, max(0.0, speed))
    assert ball.speed == pytest.approx((fast * math.cos(bearing), fast * math.sin(bearing)))


def test_kick_needs_a_near_ball_in_play():
    body = Body((0.0, 0.0))
    assert Robot(Field({1: body}), 1).answer("kick 1") == "no ball"
    ball = Ball((RADIUS + BALL_RADIUS + REACH + 0.01, 0.0))
    robot = Robot(Field({1: body}, ball=ball), 1)
    assert robot.answer("kick 1") == "no ball"
    ball.place, ball.pause = (0.2, 0.0), 1.0
    assert robot.answer("kick 1") == "no ball"
    ball.pause = 0.0
    assert robot.answer("kick 1") == "ok"
    robot.answer("wrong 1 1")
    assert robot.answer("kick 1") == "its motors are off: a fault"


def test_refereed_match_begins_when_both_teams_are_ready():
    world = World(referee=1)
    field = Field.from_layout(LAYOUTS["pitch"], world)
    referee, robot = Referee(field), Robot(field, 1)
    robot.answer("drive 0.4 0")
    places = []
    for request, answer in (
        ("ready north", "wait"),
        ("ready north", "wait"),
        ("ready south", "ok"),
        ("ready x", "what?"),
    ):
        assert referee.answer(request) == answer
        robot.step(TICK)
        field.step(TICK)
        places.append(field.robots[1].place)
    assert places[0] == places[1] == LAYOUTS["pitch"].robots[1]
    assert places[2] != places[1]
    assert referee.answer("?").startswith("now 0.020000 north_goals 0.0")
