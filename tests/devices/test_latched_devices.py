"""The log line of a device in its safe state has the action that the device does."""

from __future__ import annotations

import pytest

from lfield.clock import SystemClock
from lfield.devices.latched_devices import LatchedDevices
from lfield.devices.scheduling_jitter import HeartbeatJitter, JitterLimit, JitterMonitor
from lfield.driver.binding import DeviceBinding
from lfield.guard.messages import Latched
from lfield.text.log_messages import LogLine

ROVER = DeviceBinding(
    agent="one", field="fc", type="Mavlink", driver="mavlink", endpoint="tcp:h:1", safe_state="land"
)


@pytest.mark.parametrize(
    ("actions", "state", "shown"),
    [
        ({}, "", "land"),
        ({"one.fc": {"land": "hold"}}, "", "hold"),
        ({"one.fc": {"land": "hold"}}, "return", "return"),
        ({"two.fc": {"land": "hold"}}, "", "land"),
    ],
)
def test_action_in_a_safe_state_is_logged(actions, state, shown) -> None:
    lines: list[LogLine] = []
    jitter = HeartbeatJitter(JitterMonitor(JitterLimit(1.0)))
    latched = LatchedDevices({"one.fc": ROVER}, SystemClock(), lines.append, jitter)
    latched.set_actions(actions)
    for confirmed in (False, True):
        latched.on_message(Latched("one.fc", "fog", confirmed, state))
    assert [line.code for line in lines] == ["device-goes-safe", "device-safe"]
    assert [line.template_values["state"] for line in lines] == [shown, shown]
    # Events and commands have the name of the state.
    assert latched.state("one.fc") == (state or "land")
