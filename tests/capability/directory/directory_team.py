"""A small team for the tests of the directory: two arms and a rover, each on its own host."""

from __future__ import annotations

from dataclasses import dataclass, field

from lfield.capability.directory.agent_directory import AgentDirectory
from lfield.capability.directory.directory_delta import AttributeSample
from lfield.capability.model import Attribute, LiveAttribute, Provider, Registry
from lfield.clock import ManualClock
from lfield.text.source_text import Source, Span

SPAN = Span(Source("test.yaml", ""), 0, 0)


def live(attribute, device="fc", **changes):
    return LiveAttribute(attribute, device, changes.pop("quantity", attribute), SPAN, **changes)


ATTRIBUTES = {
    "payload": Attribute("payload", "real", SPAN, unit="kg", typical=2.0),
    "battery": Attribute("battery", "real", SPAN, typical=1.0, live=True, max_age=10.0),
    "steps": Attribute("steps", "int", SPAN, live=True, max_age=4.0),
    "armed": Attribute("armed", "boolean", SPAN, live=True),
    "mode": Attribute("mode", "text", SPAN, live=True),
}
PROVIDERS = {
    "Arm": Provider(
        "Arm", {}, SPAN, live={name: live(name) for name in ("steps", "battery", "mode", "armed")}
    ),
    "Rover": Provider("Rover", {}, SPAN, live={"battery": live("battery")}),
    "Shelf": Provider("Shelf", {}, SPAN),
}
REGISTRY = Registry(
    {}, ATTRIBUTES, {}, PROVIDERS, {}, {}, agents={"arm2": {"payload": 1.2}, "rover2": {"battery": 1.0}}
)


@dataclass
class Agent:
    id: str
    type: str
    host: str


AGENTS = [
    Agent("arm1", "Arm", "alpha"),
    Agent("rover1", "Rover", "bravo"),
    Agent("visitor", "Visitor", "alpha"),
    Agent("arm2", "Arm", "bravo"),
    Agent("shelf", "Shelf", "bravo"),
    Agent("rover2", "Rover", "alpha"),
    Agent("arm3", "Arm", "alpha"),
]


@dataclass
class Wires:
    """The links of one host, set by the test."""

    down_since: dict[str, float] = field(default_factory=dict)
    contacts: dict[str, float] = field(default_factory=dict)

    def last_contact(self, host):
        return self.contacts.get(host)


class Seat:
    """A directory with its clock and its links."""

    def __init__(self, here, clock=None, life=1):
        self.clock = clock or ManualClock()
        self.wires = Wires()
        self.directory = AgentDirectory(REGISTRY, AGENTS, here, self.wires, self.clock, life)

    def candidate(self, agent):
        return next(c for c in self.directory.all_candidates() if c.agent == agent)

    def sample(self, value, age=0.0):
        return AttributeSample(value, self.clock.now - age, self.clock.now)

    def receive(self, host):
        self.wires.contacts[host] = self.clock.monotonic()
