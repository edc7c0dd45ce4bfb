"""The referee of a plane with a ball: kick-off when both teams are ready, time and score. Pure.

Each request and each answer is one line:

    ?              the state: names and numbers
    ready SIDE     the team that plays to the north or south is ready; `ok` after the kick-off, else `wait`
"""

from __future__ import annotations

from lfield_arena.field import Field

SIDES = ("north", "south")
#: The number of the referee on the plane; the numbers of robots start with 1.
REFEREE = 0


class Referee:
    """The referee of a field. Before the kick-off, no robot moves and the match time is 0."""

    def __init__(self, field: Field) -> None:
        self._field = field

    def place(self) -> tuple[float, float, float]:
        """The position of the referee, beside the pitch."""
        return 0.0, -2.0, 0.0

    def step(self, seconds: float) -> None:
        """Advances time. The referee does not move."""

    def answer(self, line: str) -> str:
        """The answer to a request."""
        command, *arguments = line.split() or [""]
        if command == "?":
            return self._state()
        if command == "ready" and arguments and arguments[0] in SIDES:
            self._field.ready.add(arguments[0])
            return "ok" if self._field.is_running else "wait"
        # `wrong` sets the faults of the simulated device.
        return "ok" if command == "wrong" else "what?"

    def _state(self) -> str:
        goals = self._field.ball.goals if self._field.ball is not None else [0, 0]
        state = {"now": self._field.now, "north_goals": goals[0], "south_goals": goals[1]}
        return " ".join(f"{name} {float(value):.6f}" for name, value in state.items())
