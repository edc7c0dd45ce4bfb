"""From telemetry to live attributes, and the troubles that prevent calls of an agent."""

from __future__ import annotations

import asyncio
import math

import pytest

from lfield.capability.directory.directory_delta import UNCHANGED, Unavailability
from lfield.capability.model import Attribute, LiveAttribute
from lfield.clock import ManualClock
from lfield.devices.guard_process import GuardProcess
from lfield.devices.scheduling_jitter import JitterLimit, JitterMonitor
from lfield.devices.telemetry_snapshots import SILENCE_LIMIT, Snapshots
from lfield.driver.plugins import Plugins
from lfield.guard.messages import Latched, TelemetrySnapshot
from lfield.host.directory_updates.agent_sampler import AgentSampler
from lfield.manifest import Observation
from lfield.mission.bindings_file import read_bindings
from lfield.text.source_text import Source, Span

SPAN = Span(Source("test.yaml", ""), 0, 0)
TYPES = {"battery": "real", "north": "real", "steps": "int", "armed": "boolean", "mode": "text"}
ATTRIBUTES = {name: Attribute(name, kind, SPAN, live=True) for name, kind in TYPES.items()}


def live(name, quantity="", **how):
    return LiveAttribute(name, "fc", quantity or name, SPAN, **how)


class Guards:
    """Telemetry and troubles, set by the test."""

    def __init__(self):
        self.values, self.troubles = {}, {}
        self.clock = ManualClock()

    def last(self, device, quantity):
        if (device, quantity) not in self.values:
            return None
        value, age = self.values[device, quantity]
        return Observation(value, self.clock.now - age)

    def unavailability(self, device):
        return self.troubles.get(device)


class Running:
    """An agent of the machine."""

    ended = report = ""


@pytest.fixture
def guards():
    return Guards()


@pytest.fixture
def sampler(guards):
    fields = {"arm": ["fc", "hand"], "gone": []}
    return AgentSampler(ATTRIBUTES, {"arm": Running()}, fields, guards, guards, guards.clock)


@pytest.mark.parametrize(
    ("source", "reported", "value"),
    [
        (live("battery"), 0.5, 0.5),
        (live("battery"), 1, 1.0),
        (live("battery", factor=0.01), 50.0, 0.5),
        (live("battery", factor=1.0, offset=273.15), 20.0, 293.15),
        (live("north", "position", index=0), (3.0, 4.0), 3.0),
        (live("north", "position", index=1, factor=0.001), [3.0, 4000.0], 4.0),
        (live("steps"), 7, 7),
        (live("steps"), 6.9, 7),
        (live("armed"), True, True),
        (live("mode"), "hold", "hold"),
    ],
)
def test_telemetry_is_converted_to_a_value_of_its_attribute(sampler, guards, source, reported, value):
    guards.values["arm.fc", source.quantity] = (reported, 0.25)
    sample = sampler.condition("arm", {source.attribute: source}).samples[source.attribute]
    assert sample.value == pytest.approx(value) if isinstance(value, float) else sample.value == value
    assert type(sample.value) is type(value)
    assert (sample.at, sample.at - sample.when) == (guards.clock.now, 0.25)


def test_an_agent_without_live_attributes_is_unchanged(sampler):
    """The same object is returned: a directory compares it by identity, and skips a team without changes."""
    assert sampler.condition("arm", {}) is UNCHANGED


@pytest.mark.parametrize(
    ("source", "reported", "why"),
    [
        (live("battery", "charge"), None, "fc has not reported charge"),
        (live("battery"), (math.nan, 0.0), "fc reports battery as nan"),
        (live("battery"), (math.inf, 0.0), "fc reports battery as inf"),
        (live("steps"), (1e30, 0.0), "fc reports steps as 1e+30"),
        (live("battery"), ("full", 0.0), "fc reports battery as full"),
        (live("battery"), (True, 0.0), "fc reports battery as True"),
        (live("armed"), (1, 0.0), "fc reports armed as 1"),
        (live("mode"), (1, 0.0), "fc reports mode as 1"),
        (live("north", "position", index=2), ((3.0, 4.0), 0.0), "fc reports no element 2 of position"),
        (live("north", "position", index=0), (3.0, 0.0), "fc reports no element 0 of position"),
    ],
)
def test_an_invalid_value_is_unknown_with_the_reason(sampler, guards, source, reported, why):
    if reported is not None:
        guards.values["arm.fc", source.quantity] = reported
    condition = sampler.condition("arm", {source.attribute: source})
    assert (condition.samples, condition.unknown) == ({}, {source.attribute: why})


def test_an_agent_has_the_troubles_of_its_devices_and_its_own(sampler, guards):
    assert sampler.condition("arm", {}).unavailability is None
    guards.troubles["other.hand"] = Unavailability("not ours")
    assert sampler.condition("arm", {}).unavailability is None
    guards.troubles["arm.hand"] = Unavailability("hand: no message", 1.0)
    assert sampler.condition("arm", {}).unavailability == Unavailability("hand: no message", 1.0)
    sampler._agents["arm"].ended, sampler._agents["arm"].report = "died", "Exception: no\n  at arm"
    assert sampler.condition("arm", {}).unavailability == Unavailability("died of Exception: no")
    assert sampler.condition("gone", {}).unavailability == Unavailability("its host does not run it")


# --- guards ----------------------------------------------------------------------------------------------


@pytest.fixture
def installed():
    found = Plugins()
    found.add("lfield_mavlink:PLUGIN")
    return found


@pytest.fixture
def bound(installed):
    return read_bindings(None, {"sky": {"fc": "Mavlink"}}, installed, simulate=True).devices["sky"]["fc"]


def test_the_last_value_is_returned_at_any_age(installed, bound):
    clock = ManualClock()
    snapshots = Snapshots(installed.by_driver["mavlink"], [bound], clock)
    assert snapshots.last("sky.fc", "battery") is snapshots.last("sky.fc", "age") is None
    reported = clock.now
    snapshots.on_snapshot(
        TelemetrySnapshot("sky.fc", {"battery": Observation(0.5, reported - 0.5)}, reported - 0.25)
    )
    clock.advance(1000.0)
    assert snapshots.last("sky.fc", "battery") == Observation(0.5, reported - 0.5)
    assert snapshots.last("sky.fc", "age") == Observation(pytest.approx(1000.25), clock.now)


def test_a_device_is_silent_after_the_shortest_maximum_age_of_its_values(installed, bound):
    clock = ManualClock()
    kind = installed.by_driver["mavlink"]
    snapshots = Snapshots(kind, [bound], clock)
    clock.advance(1000.0)
    assert snapshots.silent_since("sky.fc") is None
    snapshots.on_snapshot(TelemetrySnapshot("sky.fc", {}, clock.now))
    received_at = clock.now
    quickest = min(quantity.max_age for quantity in kind.manifests["Mavlink"].device.telemetry)
    clock.advance(max(quickest, SILENCE_LIMIT) - 0.1)
    assert snapshots.silent_since("sky.fc") is None
    clock.advance(0.2)
    assert snapshots.silent_since("sky.fc") == received_at


def test_a_guard_tells_why_its_device_cannot_be_called(installed, bound):
    async def scenario():
        clock = ManualClock()
        guard = GuardProcess(
            installed.by_driver["mavlink"],
            [bound],
            clock,
            print,
            JitterMonitor(JitterLimit(0.2)),
            lambda: True,
        )
        assert guard.unavailability("sky.fc") == Unavailability("fc: its guard has died and is restarting")
        guard._ready = True
        assert guard.unavailability("sky.fc") is None
        guard._receive(Latched("sky.fc", "the host was silent for over 200 ms", True))
        assert guard.unavailability("sky.fc") == Unavailability(
            "fc: in its safe state land: the host was silent for over 200 ms"
        )
        guard.latched_devices.latched.clear()
        guard.snapshots.on_snapshot(TelemetrySnapshot("sky.fc", {}, clock.now))
        clock.advance(1000.0)
        problem = guard.unavailability("sky.fc")
        assert problem.sentence(clock.now) == "fc: no message for 1000 s"

    asyncio.run(scenario())
