"""Checks of arguments in tests of missions. Each raises a MissionTestError with the correct form."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import cast

from lfield.errors import DoubleError, MissionTestError


def seconds(value: object, call: str) -> float:
    """A non-negative time; `call` names the argument."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise MissionTestError(f"{call}: {value!r} is not a time; give seconds of at least 0")
    return float(value)


def action(value: object, call: str) -> Callable[[], None]:
    """An action."""
    if not callable(value):
        raise MissionTestError(
            f"{call}: {value!r} is not a function; give one, as in lambda: team.crash('alpha')"
        )
    found: Callable[[], None] = value
    return found


def line(value: object) -> str:
    """A line of L."""
    if not isinstance(value, str):
        raise MissionTestError(f"when({value!r}, ...): write a line as mission.L:42")
    return value


def check_one_end(duration: object, until: object, *, until_done: bool) -> None:
    """A `run` has one end condition: a time, an event to wait for, or the end of the mission."""
    if [duration is not None, until is not None, until_done].count(True) != 1:
        raise MissionTestError(
            "run() takes one of these: seconds, until=..., until_done=True; as in team.run(2.0)"
        )
    if until is not None and not callable(until) and not (isinstance(until, str) and until):
        raise MissionTestError(
            f"run(until={until!r}): give text of a log line, or a function that becomes true"
        )


def fault_texts(faults: Sequence[object], call: str) -> list[str]:
    """Faults as texts; at least one."""
    found = [fault for fault in faults if isinstance(fault, str)]
    if not found or len(found) < len(faults):
        raise MissionTestError(f"{call}: give faults as texts, as in set('battery=0.2')")
    return found


def initial_faults(fakes: object) -> Mapping[str, Sequence[str]]:
    """Initial faults, by device."""
    for device, faults in _mapping(fakes, "fakes", '{"scout.fc": ["battery=0.3"]}').items():
        if not isinstance(faults, list | tuple) or not all(isinstance(fault, str) for fault in faults):
            raise MissionTestError(
                f"fakes: the faults of {device} are {faults!r}; give a list of texts, as in ['battery=0.3']"
            )
    return cast("Mapping[str, Sequence[str]]", fakes)


def doubles(value: object) -> Mapping[str, object]:
    """Double objects, by resource."""
    found = _mapping(value, "doubles", '{"pump": Pump()}')
    for resource, double in found.items():
        if double is None:
            raise DoubleError(f"the double of {resource} is None: give an object with its portals as methods")
    return found


def _mapping(value: object, name: str, example: str) -> Mapping[str, object]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise MissionTestError(f"{name}={value!r}: give a dict, as in {name}={example}")
    return value


def seed(value: object) -> int:
    """The seed of all random numbers of a run."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise MissionTestError(f"seed={value!r}: give an integer; a run with the same seed is the same")
    return value
