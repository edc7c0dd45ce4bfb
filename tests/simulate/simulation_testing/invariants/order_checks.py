"""Checks that hosts keep the orders that they confirm: `lfield estop`, `pause`, `forget` (operations.md).

A host that has confirmed a stop commands no device until the stop is lifted, also after restarts; a paused
host also runs no agent until the mission is resumed. Every confirmed device stays at rest. A host without a
journal loses both with its process, and so does a host that has reported a stop as not stored. A coordinator
that was declared lost does not continue on hosts that have confirmed it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lfield.mission.mission import Mission
from lfield.simulate.hardware import Hardware
from lfield.simulate.host_fleet import HostRun
from lfield.vm.agent import Agent
from lfield.wire.observer_messages import EmergencyStopResult
from simulation_testing.invariants.breaches import Breaches
from simulation_testing.simulated_operator import Hold


@dataclass(frozen=True, slots=True)
class _Held:
    """A confirmed hold of a host: its true time, its devices, and whether a restart ends it."""

    since: float
    devices: frozenset[str]
    volatile: bool


class OrderChecks:
    """The orders in force. `keeps` tells whether hosts have journals, `now` is true time in seconds."""

    def __init__(self, breaches: Breaches, now: Callable[[], float], keeps: Callable[[], bool]) -> None:
        self._breaches, self._now, self._keeps = breaches, now, keeps
        self._held: dict[tuple[Hold, str], _Held] = {}
        self._given_up: dict[tuple[str, str], int] = {}
        #: True if an operator recovers the coordinators of a lost host, false if they are declared lost.
        self.acted = False
        #: The read position in the record of each device.
        self._read: dict[str, int] = {}

    # --- answers of hosts -----------------------------------------------------------------------------

    def on_confirmed(self, hold: Hold, host: str, answer: EmergencyStopResult) -> None:
        """A host has confirmed that it is stopped, or paused."""
        devices = frozenset(device for device, problem in answer.devices.items() if not problem)
        volatile = bool(answer.trouble) or not self._keeps()
        self._held[hold, host] = _Held(self._now(), devices, volatile)

    def on_lifting(self, hold: Hold) -> None:
        """From now on a host may receive the end of the hold."""
        self._held = {key: held for key, held in self._held.items() if key[0] != hold}

    def on_given_up(self, agent: str, starts: Mapping[str, int]) -> None:
        """These hosts have confirmed the loss of a coordinator, up to these starts."""
        for host, start in starts.items():
            self._given_up[host, agent] = max(start, self._given_up.get((host, agent), 0))

    def on_recovery_by_operator(self) -> None:
        """A host is lost, and the operator recovers its coordinators from copies, or declares them lost."""
        self.acted = True

    def is_given_up(self, agent: str, start: int) -> bool:
        """Whether an operator has declared this start of a coordinator lost."""
        return any(name == agent and start <= last for (_, name), last in self._given_up.items())

    # --- lives of hosts -------------------------------------------------------------------------------

    def on_host_start(self, host: str) -> None:
        """The process of a host begins."""
        volatile = [key for key, held in self._held.items() if key[1] == host and held.volatile]
        for key in volatile:
            del self._held[key]

    def on_disk_lost(self, host: str) -> None:
        """A host has a new disk without records."""
        self._held = {key: held for key, held in self._held.items() if key[1] != host}
        self._given_up = {key: start for key, start in self._given_up.items() if key[0] != host}

    # --- observations ---------------------------------------------------------------------------------

    def on_computed(self, life: HostRun) -> None:
        """The machine of a host has run an agent."""
        host = life.core.name
        if ("pause", host) in self._held:
            self._breaches.add("pause", (host,), "an agent runs, and its host has confirmed a pause")

    def on_running(self, life: HostRun, agent: Agent) -> None:
        """A coordinator can run on a host."""
        host = life.core.name
        if agent.generation <= self._given_up.get((host, agent.id), 0):
            found = f"start {agent.generation} of {agent.id} can run, and was given up by lfield forget"
            self._breaches.add("forget", (host,), found)

    def check(self, mission: Mission, name: str, hardware: Hardware) -> None:
        """Check a device of the mission, by its name."""
        host = _host_of(mission, name)
        since = self._read.get(name, 0)
        self._read[name] = len(hardware.record)
        for hold in ("stop", "pause"):
            held = self._held.get((hold, host))
            if held is None or name not in held.devices:
                continue
            for command in hardware.record[since:]:
                if command.at > held.since and not command.safe:
                    order = f"{command.what} at {command.at:.3f} s"
                    found = f"{name} is commanded to {order}, after a confirmed {hold}"
                    self._breaches.add(hold, (host,), found)
            if hardware.is_moving and not hardware.record[-1].safe:
                self._breaches.add(hold, (host,), f"{name} moves after a confirmed {hold}")


def _host_of(mission: Mission, device: str) -> str:
    """The host of a device."""
    agent = next(found.agent for found in mission.bindings.all if found.name == device)
    return next(mission.team.hosts[member.host] for member in mission.team.members if member.id == agent)
