"""How the agents of the team are: this host looks at its own, tells the others, and hears from them.

Every host looks at its agents once in LOOK_EVERY seconds and tells the others what has changed, in one
message for all agents. A host that is linked anew is told everything once. In a program that names no
capability of a registry nothing of all this happens.
"""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

from lfield.capability.directory.directory import Directory
from lfield.capability.directory.news import News
from lfield.capability.model import Registry
from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.errors import WireError
from lfield.host.reports import Reports
from lfield.host.sampling import Sampler
from lfield.mission.mission import Mission
from lfield.net.peers import Peers
from lfield.vm.machine import Machine
from lfield.wire.messages import Hello, Report

#: The registry of a mission that asks for no capability.
NO_REGISTRY = Registry({}, {}, {}, {}, {}, {})

#: Seconds between two looks at the devices of this host for the others' sake.
LOOK_EVERY = 1.0


class Station(Protocol):
    """The host that reports."""

    name: str
    incarnation: int
    machine: Machine
    peers: Peers
    guards: Guards
    clock: Clock


class Reporting:
    """Keeps the `directory` of a host up to date. Only agents that the `registry` knows are in it."""

    def __init__(self, station: Station, mission: Mission) -> None:
        self.registry = registry = mission.registry or NO_REGISTRY
        agents = mission.team.deployed
        self._station, self._clock = station, station.clock
        self.directory = Directory(
            registry, agents, station.name, station.peers, station.clock, station.incarnation
        )
        self._reports = Reports(registry, agents)
        self._sampler = Sampler(
            registry.attributes, station.machine.agents, mission.needed, station.guards, station.clock
        )
        self._timer: asyncio.TimerHandle | None = None

    def open(self) -> None:
        """Begin to look at this host's agents, if there are any to tell of."""
        if self.directory.own_agents:
            self._tell_changes()

    def stop(self) -> None:
        """Tell nothing more."""
        if self._timer:
            self._timer.cancel()

    def linked(self, hello: Hello) -> None:
        """A host can be talked to: it is told everything, since it may have been away."""
        self.directory.linked(hello.host, hello.incarnation)
        news = self.directory.everything()
        if news is not None:
            self._station.peers.send(hello.host, self._report(news))

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        self.directory.unlinked(host)

    def received(self, host: str, report: Report) -> None:
        """A host tells how its agents are. What it cannot know is left out, and told to the log once."""
        try:
            self.directory.take(host, self._reports.read(host, report, self._clock.monotonic()))
        except WireError as error:
            self._station.peers.complain(f"ignored a report: {error}")

    def _tell_changes(self) -> None:
        self.look()
        news = self.directory.news()
        if news is not None:
            report = self._report(news)
            for host in self._station.peers.incarnations:
                self._station.peers.send(host, report)
        self._timer = asyncio.get_running_loop().call_later(LOOK_EVERY, self._tell_changes)

    def look(self) -> None:
        """Bring what the directory knows of this host's agents up to date."""
        for agent in self.directory.own_agents:
            self.directory.own(agent, self._sampler.condition(agent, self.directory.live(agent)))

    def _report(self, news: News) -> Report:
        return self._reports.write(news, self._clock.monotonic())

    def status(self) -> dict[str, Any]:
        """For each agent, why it cannot be called, or '', and its live attributes.

        `facts` has value and age in seconds of each that is known, `unknown` why the others are not.
        """
        self.look()
        return {
            candidate.agent: {
                "refusal": candidate.refusal,
                "facts": {
                    name: [candidate.facts[name].value, round(candidate.facts[name].age, 3)]
                    for name in self.directory.live(candidate.agent)
                    if name in candidate.facts
                },
                "unknown": dict(candidate.unknown),
            }
            for candidate in self.directory.everybody()
        }
