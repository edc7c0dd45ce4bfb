"""What makes hosts keep what they confirm to a person, each left out; and links beyond the neighbours."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from planted_bugs import Bug, Patch

from lfield.devices.guards import Guards
from lfield.host.core import HostCore
from lfield.host.orders.executed import Executed, Standing
from lfield.host.stopping.stops import Stops
from lfield.host.team import words
from lfield.journal.pages import Paused
from lfield.mobility.core import Mobility
from lfield.mobility.departures import UNREACHABLE
from lfield.mobility.effects import Effect
from lfield.simulate.stories.drawing import crowd, under_orders, wrecked
from lfield.simulate.stories.story import FOR_EVER, Story, plain
from lfield.simulate.weather import Fault
from lfield.wire.orders import HOLDS, Kind


def ordered(seed: int) -> Story:
    """One under orders of a person, of hosts with journals that are often killed."""
    dice = random.Random(f"ordered {seed}")
    means = {kind: dice.uniform(1.5, 4.0) for kind in ("kill", "restart", "guard_kill")}
    story = replace(plain(seed), cast=3, hosts=3, arms=2, calls=FOR_EVER, stay=0.04, means=means)
    story = replace(story, journals=True, lost_after=None, weather=14.0, seconds=14.0)
    return under_orders(story, dice)


def a_stop_is_forgotten_by_a_restart(patch: Patch) -> None:
    patch.setattr(Stops, "stay_stopped", lambda self: None)


def a_pause_is_forgotten_by_a_restart(patch: Patch) -> None:
    patch.setattr(words, "Paused", lambda on, order: Paused(False, order))


def a_stop_bars_nobody(patch: Patch) -> None:
    def bar(self: Guards, reason: str) -> None:
        for guard in self._guards:
            for name in guard.movable:
                guard.make_safe(name, reason)

    patch.setattr(Guards, "bar", bar)


def a_pause_leaves_devices_alone(patch: Patch) -> None:
    async def rest(self: Guards, reason: str) -> dict[str, str]:
        return {name: "" for guard in self._guards for name in guard.movable}

    patch.setattr(Guards, "rest", rest)


def hasty(seed: int) -> Story:
    """One in which the end of a stop is under way on slow links while the next stop comes over quick ones."""
    dice, story = random.Random(f"hasty {seed}"), ordered(seed)
    aimed: list[Fault] = []
    for round in range(3):
        pressed = 2.0 + 7.0 * round + dice.uniform(0.0, 0.5)
        ended = pressed + 1.0
        aimed.append(Fault(pressed, "estop", "h0", "h1", 1.0, 0.0))
        # What the person sends is slow: the end has left when the next stop comes, and has not arrived.
        aimed += [Fault(ended - 0.01, "slow", host, host, 2.0, 0.0) for host in ("h0", "h1")]
        aimed.append(Fault(ended + 2.05, "estop", "h0", "h1", 3.0, 0.0))
    return replace(story, cast=2, hosts=2, means={}, aimed=tuple(aimed), weather=25.0, seconds=25.0)


def an_order_that_comes_late_ends_a_newer_stop(patch: Patch) -> None:
    standing = Executed.standing

    def any_epoch(self: Executed, kind: Kind, id: bytes, epoch: bytes) -> Standing:
        found = standing(self, kind, id, epoch)
        return "new" if found in ("old", "unknown") and kind not in HOLDS else found

    patch.setattr(Executed, "standing", any_epoch)


def a_coordinator_that_was_given_up_continues(patch: Patch) -> None:
    def forget(self: Mobility, agent: str, detail: str) -> tuple[list[int], list[Effect]]:
        doubted = [copy for copy in self._copies.of(agent) if copy.doubt and copy.state == "PREPARED"]
        effects: list[Effect] = []
        for copy in doubted:
            copy.doubt = ""
            effects += self._departures._resume(copy, UNREACHABLE, detail)
        return [copy.generation for copy in doubted], effects

    patch.setattr(Mobility, "forget", forget)


def only_neighbours_are_called(patch: Patch) -> None:
    def wanted(self: HostCore) -> set[str]:
        return {*self.hearsay.wanted(self._clock.monotonic())} - {self.name}

    patch.setattr(HostCore, "wanted", wanted)
    patch.setattr(HostCore, "_reach", lambda self, host: None)


def _bug(plant: Any, why: str, found: str, seed: int, draws: Any = ordered) -> Bug:
    return Bug(plant, why, frozenset(found.split()), seed, draws)


ORDER_BUGS = [
    _bug(
        a_stop_is_forgotten_by_a_restart, "a host that was started again lets programs release", "stop", 201
    ),
    _bug(a_pause_is_forgotten_by_a_restart, "a host that was started again runs its agents", "pause", 1),
    _bug(a_stop_bars_nobody, "a program releases what a person has stopped", "stop", 13),
    _bug(a_pause_leaves_devices_alone, "a device goes on with its last setpoint", "pause", 9),
    _bug(
        an_order_that_comes_late_ends_a_newer_stop,
        "a stop that was pressed after it was given ends by it",
        "stop",
        0,
        hasty,
    ),
    _bug(
        a_coordinator_that_was_given_up_continues,
        "a person has declared it lost, and it runs",
        "forget",
        1,
        wrecked,
    ),
    _bug(
        only_neighbours_are_called,
        "a coordinator never comes to a host with which there is no link",
        "reach",
        1,
        crowd,
    ),
]
