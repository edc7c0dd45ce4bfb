"""The silence after which a device counts as lost, for every installed device type."""

from __future__ import annotations

import pytest

from lfield.clock import ManualClock
from lfield.devices.telemetry_snapshots import SILENCE_LIMIT, Snapshots
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import discover
from lfield.guard.messages import TelemetrySnapshot

TYPES = [(found, name) for found in discover().by_driver.values() for name in found.manifests]


@pytest.mark.parametrize(("installed", "device_type"), TYPES, ids=[name for _, name in TYPES])
def test_silent_device_is_lost_after_the_silence_limit(installed, device_type):
    clock = ManualClock()
    binding = DeviceBinding(
        agent="a",
        field="thing",
        type=device_type,
        driver=installed.plugin.name,
        endpoint="nowhere",
        safe_state=next(iter(installed.manifests[device_type].device.safe_states), ""),
    )
    snapshots = Snapshots(installed, [binding], clock)
    assert snapshots.silent_since("a.thing") is None
    snapshots.on_snapshot(TelemetrySnapshot("a.thing", {}, clock.now))
    last_contact = clock.monotonic()
    clock.advance(SILENCE_LIMIT - 0.1)
    assert snapshots.silent_since("a.thing") is None
    clock.advance(2.2)
    assert snapshots.silent_since("a.thing") == last_contact
