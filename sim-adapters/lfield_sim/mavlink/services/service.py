"""The interface of services of the simulated device: missions, fences, parameters, files, each in its own
file.

A service belongs to one vehicle and handles messages, not packets. Four tables define what it handles:

- `handles`: message id -> handler. Called with the message (addressed to this vehicle or to all); returns
  the messages that answer it, which are sent to the requesting peer only.
- `commands`: MAV_CMD -> handler. Called with the `MavCommand`; returns the result (`DelayedResult`: a
  later one, None: silence) and messages that follow the acknowledgement. A command of a service has
  priority over one of `command_handlers.py`.
- `messages`: message id -> builder. Messages that can be requested by REQUEST_MESSAGE (512) and
  SET_MESSAGE_INTERVAL (511) and, for PX4, are streamed.
- `requests`: message id -> the answer to REQUEST_MESSAGE instead: several messages, none (the request is
  accepted), or None, which refuses it.

`advance(now)` is called after every step of the model (`now` is `autopilot.now`, in seconds, which continues
over a reboot); its messages are sent to every peer. Long answers (a parameter list, a burst read) are sent
there, some per step.
Handlers get foreign values: they never raise, and their stored data is bounded. `reboot` discards the data
that the real autopilot would discard.

The interface of the autopilot to services (`lfield_sim.autopilot.autopilot`):

- `parameters`: name -> float; after a change call `apply_parameters()`. The defaults of the
  autopilot are `autopilot.kind.parameters` (`autopilot.stacks`). `flavour.name` is `ardupilot`
  or `px4`, `kind.name` `copter` or `rover`.
- `mission`: an `autopilot.plans.Mission`. Set `mission.items` (a list of `MissionItem`: MAV_CMD, seven
  values, and the place in the local frame, or None), then `autopilot.start_mission(first)` enters the
  mission mode. `mission.current` is the index that is being flown, `mission.pop_reached()` returns the
  indexes reached since the last call. `mission.jump(index)` sets the current one.
- `fence`: an object with `breached(place) -> int`: a FENCE_BREACH type (0 none, 1 floor, 2 ceiling, 3
  boundary) for a place in the local frame. It contains uploaded polygons and circles only. The autopilot
  itself handles the fences that are parameters (FENCE_RADIUS, FENCE_ALT_MAX, GF_MAX_HOR_DIST,
  GF_MAX_VER_DIST), whether fences are on (FENCE_ENABLE, GF_ACTION), and the effect of a breach.
- `say(text)`: a STATUSTEXT. `armed`, `mode`, `vehicle.place`, `home`, `battery.charge`, `flavour`.

Places: `GeoOrigin.at(north, east)` and `GeoOrigin.local(latitude, longitude)` (1e-7 degrees).

Mission items that are not flown (speed, servo, camera) are executed as the commands of that number. A
result is an `autopilot.flavours.MavResult`. The severity of a text is in `autopilot.stacks.text_severity`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand

Handler = Callable[[Any], list[Any]]
CommandHandler = Callable[[MavCommand], CommandAnswer]
MessageBuilder = Callable[[], Any]
RequestHandler = Callable[[], list[Any] | None]


class VehicleService:
    """One service of one vehicle; empty by default. Subclasses fill the tables in `__init__`."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        self.autopilot, self.place = autopilot, place
        self.handles: Mapping[int, Handler] = {}
        self.commands: Mapping[int, CommandHandler] = {}
        self.messages: Mapping[int, MessageBuilder] = {}
        self.requests: Mapping[int, RequestHandler] = {}

    def advance(self, now: float) -> list[Any]:
        """Messages for every peer, after a step of the model."""
        return []

    def reboot(self) -> None:
        """Resets volatile state when the autopilot restarts."""
