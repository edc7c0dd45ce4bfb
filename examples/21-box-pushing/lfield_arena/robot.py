"""The controller of a robot on the plane: line protocol, wheel control, watchdog. Pure.

Each request and each answer is one line:

    ?                     the state of the robot and of observed objects: names and numbers
    go NORTH EAST SPEED   moves to a position in m, with a speed in m/s, and stops there
    drive NORTH EAST      moves with a velocity in m/s
    kick SPEED            kicks the ball away from the robot, with a speed in m/s; `no ball` if none is near
    stop                  stops the wheels
    watchdog SECONDS      stops the robot after this time without a request; 0 disables the watchdog
    wrong GRIP BROKEN     sets faults: the remaining share of the grip, and 1 if the motors are off
"""

from __future__ import annotations

import math

from lfield_arena.box import Vector
from lfield_arena.field import Body, Field
from lfield_arena.world import along_axes

#: Maximum and minimum speed in m/s; braking time before a goal in s; tolerance of a goal in m.
MAX_SPEED, MIN_SPEED, BRAKING_TIME, GOAL_TOLERANCE = 0.5, 0.1, 0.3, 0.01
#: The number of arguments of each command.
REQUESTS = {"go": 3, "drive": 2, "kick": 1, "stop": 0, "watchdog": 1, "wrong": 2}


class Robot:
    """The controller of one robot on a field."""

    def __init__(self, field: Field, number: int) -> None:
        self._field, self._number = field, number
        self._goal: tuple[Vector, float] | None = None
        self._velocity: Vector = (0.0, 0.0)
        self.watchdog = self._since = 0.0
        self._broken = False

    @property
    def body(self) -> Body:
        """The body of the robot on the plane."""
        return self._field.robots[self._number]

    def place(self) -> tuple[float, float, float]:
        """The position of the robot: metres north, east and up."""
        return *self.body.place, 0.0

    def step(self, seconds: float) -> None:
        """Sets the velocity of the wheels for the next step."""
        self._since += seconds
        if self._broken or 0.0 < self.watchdog < self._since:
            self._stop()
        if self._goal is not None and math.dist(self.body.place, self._goal[0]) < GOAL_TOLERANCE:
            self._stop()
        self.body.velocity = self._target_velocity()

    def _target_velocity(self) -> Vector:
        if self._goal is None:
            return self._velocity
        (north, east), speed = self._goal
        place = self.body.place
        distance = math.dist(place, (north, east))
        direction = along_axes((north - place[0], east - place[1]), self._field.world.moves)
        if self._field.world.moves:
            # Along the axis with the longer distance, at most as far as the goal.
            distance = max(abs(north - place[0]), abs(east - place[1]))
            direction = (
                math.copysign(distance, direction[0]) if direction[0] else 0.0,
                math.copysign(distance, direction[1]) if direction[1] else 0.0,
            )
        factor = min(speed, max(MIN_SPEED, distance / BRAKING_TIME)) / distance
        return direction[0] * factor, direction[1] * factor

    def _stop(self) -> None:
        self._goal, self._velocity = None, (0.0, 0.0)

    def answer(self, line: str) -> str:
        """The answer to a request."""
        command, *arguments = line.split() or [""]
        if command != "wrong":
            self._since = 0.0
        if command == "?":
            return self._state()
        try:
            numbers = [float(text) for text in arguments]
        except ValueError:
            return "what?"
        if len(numbers) != REQUESTS.get(command) or not all(map(math.isfinite, numbers)):
            return "what?"
        if self._broken and command in ("go", "drive", "kick"):
            return "its motors are off: a fault"
        if command == "kick":
            return self._kick(numbers[0])
        self._execute(command, numbers)
        return "ok"

    def _kick(self, speed: float) -> str:
        ball, body = self._field.ball, self.body
        return "ok" if ball is not None and ball.kick(body.place, body.radius, speed) else "no ball"

    def _execute(self, command: str, numbers: list[float]) -> None:
        if command == "wrong":
            self.body.grip, self._broken = min(1.0, max(0.0, numbers[0])), bool(numbers[1])
            return
        if command == "watchdog":
            self.watchdog = max(0.0, numbers[0])
            return
        self._stop()
        if command == "go":
            self._goal = (numbers[0], numbers[1]), min(MAX_SPEED, max(0.0, numbers[2]))
        elif command == "drive":
            excess = max(1.0, math.hypot(*numbers) / MAX_SPEED)
            self._velocity = numbers[0] / excess, numbers[1] / excess

    def _state(self) -> str:
        """The state as a line: `north 0.5 east 1.0 moving 0 ...`."""
        place, targets = self.body.place, self._field.targets
        moving = self._goal is not None or self._velocity != (0.0, 0.0)
        goals = self._field.ball.goals if self._field.ball is not None else [0, 0]
        state: dict[str, float] = {"north": place[0], "east": place[1], "moving": moving}
        state |= {"broken": self._broken, "watchdog": self.watchdog}
        state["targets"] = len(targets)
        for number, target in enumerate(targets):
            names = (f"target{number}_{part}" for part in ("north", "east", "heading"))
            state |= zip(names, target, strict=True)
        state |= {"now": self._field.now, "north_goals": goals[0], "south_goals": goals[1]}
        return " ".join(f"{name} {float(value):.6f}" for name, value in state.items())
