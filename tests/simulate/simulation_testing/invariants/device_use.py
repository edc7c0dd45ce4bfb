"""Observations of the simulated hardware: its owners, and movement without an owner."""

from __future__ import annotations

from collections.abc import Callable

from lfield.simulate.hardware import DeviceCommand, Hardware
from simulation_testing.invariants.breaches import Breaches

#: Seconds for which a device may move after its last command: an action, or the silence and the stop.
MAX_MOVE_TIME = 6.0


class DeviceUse:
    """The devices of a team.

    `made_for` gives the agent and start for which a device was commanded, from the arguments; `newest_at`
    the newest recovery of an agent that had continued before a time. `commanded` is called with each command
    for an agent: the resource, the agent with its start, and the time.
    """

    def __init__(
        self,
        breaches: Breaches,
        made_for: Callable[[tuple[object, ...]], tuple[str, int]],
        newest_at: Callable[[str, float], int],
        commanded: Callable[[str, tuple[str, int], float], None],
    ) -> None:
        self._breaches, self._made_for, self._newest_at = breaches, made_for, newest_at
        self._commanded = commanded
        self._checked: dict[str, int] = {}
        self._actuated: set[tuple[object, ...]] = set()
        self._moves_since: dict[str, float] = {}

    def check(self, name: str, hardware: Hardware, now: float) -> None:
        """Check one device."""
        if len(hardware.owners) > 1:
            self._breaches.add("device", (), f"{name} has {len(hardware.owners)} owners")
        for command in hardware.record[self._checked.get(name, 0) :]:
            self._moves_since[name] = command.at
            if command.what == "setVelocity":
                self._actuates(name, command)
        self._checked[name] = len(hardware.record)
        if not hardware.is_moving:
            self._moves_since[name] = now
        elif now - self._moves_since.get(name, now) > MAX_MOVE_TIME:
            self._breaches.add(
                "device", (), f"{name} moves, and nobody has commanded it for {MAX_MOVE_TIME:g} s"
            )

    def _actuates(self, name: str, given_command: DeviceCommand) -> None:
        agent, generation = self._made_for(given_command.arguments)
        command = (name, generation, *given_command.arguments)
        if command in self._actuated:
            self._breaches.add("I4", (), f"{name} was commanded twice for call {given_command.arguments[:2]}")
        self._actuated.add(command)
        newest = self._newest_at(agent, given_command.at)
        if generation < newest:
            found = f"{name} was commanded for start {generation} of {agent} at {given_command.at:.3f} s"
            self._breaches.add("I1", (), f"{found}; {newest} had gone on")
        if agent:
            self._commanded(name.rpartition(".")[0], (agent, generation), given_command.at)
